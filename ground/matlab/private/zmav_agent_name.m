function name = zmav_agent_name(name)
%ZMAV_AGENT_NAME  The name of an agent, as it may stand in a key.
    name = zmav_char(name);
    if ~ischar(name) || isempty(regexp(name, '^[a-z0-9_-]+$', 'once'))
        error('zmav:bad_input', 'agent: expected a name like ev1 (lower-case letters, digits, - and _)');
    end
end
