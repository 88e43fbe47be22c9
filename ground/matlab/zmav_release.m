function zmav_release(z, vehicle)
%ZMAV_RELEASE  End a stream of setpoints: the lease is given back, and the vehicle holds.
%   ZMAV_RELEASE(Z, VEHICLE) does nothing where the stream is over already.
%
%   Example:
%       zmav_release(z, 'quad1');
%
%   See also ZMAV_SETPOINT.

    vehicle = zmav_vehicle_name(vehicle);
    if isKey(z.held, ['lease ' vehicle])
        remove(z.held, ['lease ' vehicle]);
    end
    try
        zmav_http(z, 'get', zmav_stream_path(z, 'release', vehicle));
    catch problem
        if ~strcmp(problem.identifier, 'zmav:not_holder')  % it is over already
            rethrow(problem);
        end
    end
end
