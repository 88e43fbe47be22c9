function result = zmav_do(z, vehicle, verb, varargin)
%ZMAV_DO  Give a vehicle an order, and wait until it is done.
%   RESULT = ZMAV_DO(Z, VEHICLE, VERB, 'name', value, ...) or with one structure of arguments. The verbs and what they
%   take are those of 'zmav do --help': arm, takeoff, goto, set_mode, command, param_set, mission_start ... The vehicle
%   retries by itself, and an order is done once. One that moves it ends a stream of ZMAV_SETPOINT through Z. RESULT is
%   what the order brought: a structure, without fields for most.
%
%   Errors carry the vehicle's words: 'zmav:refused', 'zmav:timed_out', 'zmav:not_holder' (another agent has the lease),
%   'zmav:unsupported', 'zmav:no_such_vehicle', 'zmav:bad_input'.
%
%   Example:
%       zmav_do(z, 'quad1', 'command', 'command', 'DO_CHANGE_SPEED', 'params', struct('Speed', 5));
%
%   See also ZMAV_ARM, ZMAV_GOTO, ZMAV_MODE.

    verb = zmav_char(verb);
    if ~ischar(verb) || isempty(regexp(verb, '^[a-z_]+$', 'once'))
        error('zmav:bad_input', 'verb: expected a word like takeoff; ''zmav do --help'' lists them');
    end
    vehicle = zmav_vehicle_name(vehicle);
    params = zmav_arguments(varargin);
    moving = {'arm', 'takeoff', 'goto', 'set_mode', 'command', 'mission_start', 'mission_current'};
    if any(strcmp(verb, moving)) && isKey(z.held, ['lease ' vehicle]) && ~any(strcmp(params(1:2:end), 'lease'))
        zmav_release(z, vehicle);  % it would be refused while our own stream has the vehicle
    end
    if isempty(params)
        params = {'lease', '""'};  % none: some releases of urlread post nothing where there is nothing to post
    end
    outcome = zmav_http(z, 'post', ['/do/' vehicle '/' verb], params);
    result = outcome.result;
    if isempty(result)
        result = struct();
    end
end
