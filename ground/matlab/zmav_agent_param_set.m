function [value, before] = zmav_agent_param_set(z, vehicle, agent, name, value)
%ZMAV_AGENT_PARAM_SET  Change a parameter of an agent while it runs, within its bounds.
%   VALUE = ZMAV_AGENT_PARAM_SET(Z, VEHICLE, AGENT, NAME, VALUE) returns the value that it has now.
%   [VALUE, BEFORE] = ... also what it was. One that is out of bounds is refused, 'zmav:bad_input', and says the bounds.
%
%   Example:
%       zmav_agent_param_set(z, 'hex1', 'my_controller', 'kp', 7.5);
%
%   See also ZMAV_AGENT_PARAM_GET, ZMAV_AGENT_DO.

    changed = zmav_agent_do(z, vehicle, agent, 'set', 'name', name, 'value', value);
    value = changed.value;
    before = changed.before;
end
