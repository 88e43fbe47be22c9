function zmav_send(z, vehicle, message, varargin)
%ZMAV_SEND  Send one MAVLink message to a vehicle.
%   ZMAV_SEND(Z, VEHICLE, MESSAGE, 'field', value, ...) or with one structure of fields, in MAVLink's own units. VEHICLE
%   is a name, or [SYS COMP]. Every field has to be given, except target_system and target_component (the vehicle's)
%   and MAVLink 2 extensions; enumerated fields take a number or a name; arrays are vectors.
%
%   It is sent once, and nothing says that it arrived: for orders ZMAV_DO is better. Errors: 'zmav:bad_input' with the
%   names of the fields that are missing or wrong, 'zmav:forbidden', 'zmav:no_such_vehicle'.
%
%   Example:
%       zmav_send(z, 'quad1', 'MANUAL_CONTROL', 'target', 1, 'x', 0, 'y', 0, 'z', 500, 'r', 0, 'buttons', 0);
%
%   See also ZMAV_DO, ZMAV_SETPOINT.

    [sys, comp] = zmav_system(z, vehicle);
    params = zmav_arguments(varargin, @plain);
    zmav_http(z, 'get', sprintf('/send/%d/%d/%s', sys, comp, zmav_encode(message)), params);
end

function text = plain(value)
    % Text as it is, numbers as they are, arrays with commas between.
    if ischar(value)
        text = value;
    else
        text = regexprep(zmav_json(double(value)), '[\[\]]', '');
    end
end
