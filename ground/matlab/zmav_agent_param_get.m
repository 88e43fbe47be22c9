function [value, about] = zmav_agent_param_get(z, vehicle, agent, name)
%ZMAV_AGENT_PARAM_GET  A parameter of an agent, or all of them.
%   VALUE = ZMAV_AGENT_PARAM_GET(Z, VEHICLE, AGENT, NAME) is a number.
%   [VALUE, ABOUT] = ... also gives a structure with value, default, low, high, unit and doc.
%   PARAMS = ZMAV_AGENT_PARAM_GET(Z, VEHICLE, AGENT) is a row of structures with name, value, default, low, high, unit
%   and doc, one for every parameter; names may hold dots, as in position.kp.
%
%   Errors: 'zmav:not_found' where there is no such agent or parameter.
%
%   Example:
%       [kp, about] = zmav_agent_param_get(z, 'hex1', 'ev1', 'position.kp');
%       fprintf('%g %s, at most %g\n', kp, about.unit, about.high);
%
%   See also ZMAV_AGENT_PARAM_SET, ZMAV_AGENT_DO.

    key = [zmav_vehicle_name(vehicle) '/agent/' zmav_agent_name(agent) '/param/'];
    if nargin > 3
        name = zmav_char(name);
        if ~ischar(name) || isempty(name) || any(ismember(name, '*/'))
            error('zmav:bad_input', 'name: expected a parameter''s name like kp');
        end
        about = zmav_get(z, [key name]);
        value = about.value;
        return
    end
    answers = zmav_get(z, [key '*']);
    if isempty(answers)
        error('zmav:not_found', 'no agent %s answers for %s', zmav_agent_name(agent), zmav_vehicle_name(vehicle));
    end
    value = struct('name', {}, 'value', {}, 'default', {}, 'low', {}, 'high', {}, 'unit', {}, 'doc', {});
    for k = 1:numel(answers)
        each = answers(k).value;
        each.name = answers(k).key(find(answers(k).key == '/', 1, 'last') + 1:end);
        value(k) = orderfields(each, {'name', 'value', 'default', 'low', 'high', 'unit', 'doc'});
    end
    about = value;
end
