function value = zmav_param_get(z, vehicle, name)
%ZMAV_PARAM_GET  A parameter, or all of them, from the vehicle's cache.
%   VALUE = ZMAV_PARAM_GET(Z, VEHICLE, NAME) is a number.
%   VALUES = ZMAV_PARAM_GET(Z, VEHICLE) is a structure with a field for every parameter.
%
%   Example:
%       height = zmav_param_get(z, 'quad1', 'RTL_ALT');      % cm, on ArduCopter
%
%   See also ZMAV_PARAM_SET.

    vehicle = zmav_vehicle_name(vehicle);
    if nargin > 2
        param = zmav_get(z, [vehicle '/param/' zmav_char(name)]);
        value = param.value;
        return
    end
    table = zmav_get(z, [vehicle '/param'], 10);
    value = struct();
    for param = table.params(:)'
        value.(matlab.lang.makeValidName(param.name)) = param.value;
    end
end
