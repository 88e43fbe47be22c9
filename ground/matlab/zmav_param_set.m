function value = zmav_param_set(z, vehicle, name, value)
%ZMAV_PARAM_SET  Set a parameter; it is read back from the autopilot before this returns.
%   VALUE = ZMAV_PARAM_SET(Z, VEHICLE, NAME, VALUE) returns the value as it was read back.
%
%   Example:
%       zmav_param_set(z, 'quad1', 'RTL_ALT', 2500);
%
%   See also ZMAV_PARAM_GET.

    changed = zmav_do(z, vehicle, 'param_set', 'name', name, 'value', value);
    value = changed.value;
end
