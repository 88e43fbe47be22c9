function said = zmav_setpoint(z, vehicle, varargin)
%ZMAV_SETPOINT  One point of an outer-loop command stream; call it at 5 to 10 Hz, and at least once a second.
%   ZMAV_SETPOINT(Z, VEHICLE, [N E D]) and ZMAV_SETPOINT(Z, VEHICLE, [N E D], YAW): metres north, east, down about the
%   fleet's origin; YAW in radians clockwise from north.
%   ZMAV_SETPOINT(Z, VEHICLE, 'name', value, ...): pos; vel (m/s) and acc (m/s^2), each north, east, down; yaw;
%   yaw_rate (rad/s); or lat_deg, lon_deg and alt_rel or alt_amsl; valid (s for which it is flown, 1 unless given).
%   SAID = ... has the fields lease (an order given with 'lease', SAID.lease passes beside the stream), sent, and
%   setpoints: the vehicle's count of what became of them.
%
%   The first call takes the vehicle's lease, which the gateway holds while the calls go on. When they stop, the vehicle
%   holds its position by itself within two seconds. 'zmav:not_holder' says who else has the vehicle, or what took it.
%
%   Example:
%       for k = 1:100
%           zmav_setpoint(z, 'quad1', [0.2 * k, 0, -10]);
%           pause(0.1);
%       end
%       zmav_release(z, 'quad1');
%
%   See also ZMAV_RELEASE, ZMAV_FOLLOW, ZMAV_GOTO.

    if ~isempty(varargin) && isnumeric(varargin{1})
        if numel(varargin{1}) ~= 3 || numel(varargin) > 2
            error('zmav:bad_input', 'setpoint: expected [N E D] in metres, and perhaps a yaw in radians');
        end
        varargin = [{'pos'}, varargin(1), repmat({'yaw'}, 1, numel(varargin) - 1), varargin(2:end)];
    end
    vehicle = zmav_vehicle_name(vehicle);
    said = zmav_http(z, 'post', zmav_stream_path(z, 'setpoint', vehicle), zmav_arguments(varargin));
    z.held(['lease ' vehicle]) = struct('kind', 'lease', 'vehicle', vehicle);
end
