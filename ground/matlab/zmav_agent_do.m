function result = zmav_agent_do(z, vehicle, agent, verb, varargin)
%ZMAV_AGENT_DO  Give an order to an agent that runs for a vehicle, such as a controller, and wait until it is done.
%   RESULT = ZMAV_AGENT_DO(Z, VEHICLE, AGENT, VERB, 'name', value, ...) or with one structure of arguments. AGENT is the
%   name with which 'zmav agent run' was started. Every agent knows set and params; a controller engage, release, goto,
%   sticks, hold, inject. The agent judges the arguments: vectors are [x y z], metres north, east, down, angles radians.
%   RESULT is what the order brought: a structure, without fields for most.
%
%   Errors carry the agent's words: 'zmav:refused', 'zmav:bad_input', 'zmav:timed_out' where no such agent runs.
%
%   Example:
%       zmav_agent_do(z, 'hex1', 'ev1', 'engage');
%       zmav_agent_do(z, 'hex1', 'ev1', 'goto', 'pos', [5 3 -12], 'yaw', pi / 2, 'speed', 3);
%       zmav_agent_do(z, 'hex1', 'ev1', 'release');
%
%   See also ZMAV_AGENT_PARAM_SET, ZMAV_AGENT_PARAM_GET, ZMAV_DO.

    verb = zmav_char(verb);
    if ~ischar(verb) || isempty(regexp(verb, '^[a-z0-9_-]+$', 'once'))
        error('zmav:bad_input', 'verb: expected a word like engage');
    end
    vehicle = zmav_vehicle_name(vehicle);
    params = zmav_arguments(varargin);
    if isempty(params)
        params = {'lease', '""'};  % none: some releases of urlread post nothing where there is nothing to post
    end
    outcome = zmav_http(z, 'post', ['/agent/' vehicle '/' zmav_agent_name(agent) '/' verb], params);
    result = outcome.result;
    if isempty(result)
        result = struct();
    end
end
