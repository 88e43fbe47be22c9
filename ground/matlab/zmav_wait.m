function state = zmav_wait(z, vehicle, condition, timeout)
%ZMAV_WAIT  Wait until something holds for a vehicle's state, and return that state.
%   STATE = ZMAV_WAIT(Z, VEHICLE, CONDITION) calls CONDITION, a function of the state (see ZMAV_GET), ten times a second
%   until it is true; for 60 s at most, or as ZMAV_WAIT(Z, VEHICLE, CONDITION, TIMEOUT) says. A CONDITION that needs a
%   part the vehicle has not said yet ([]) counts as false.
%
%   Errors: 'zmav:timed_out', with what the vehicle said last; 'zmav:no_such_vehicle'.
%
%   Example:
%       zmav_wait(z, 'quad1', @(s) -s.local(3) > 8);
%
%   See also ZMAV_GET.

    if nargin < 4
        timeout = 60;
    end
    if ~isa(condition, 'function_handle')
        error('zmav:bad_input', 'condition: expected a function of the state, like @(s) s.armed');
    end
    begun = tic;
    while true
        state = zmav_get(z, vehicle);
        if holds(condition, state)
            return
        end
        if toc(begun) > timeout
            error('zmav:timed_out', '%s within %g s: %s did not come true; mode %s, armed %d, local [%s]', ...
                state.name, timeout, func2str(condition), text(state.mode), isequal(state.armed, true), ...
                sprintf('%.2f ', state.local));
        end
        pause(0.1);
    end
end

function yes = holds(condition, state)
    try
        answer = condition(state);
        yes = ~isempty(answer) && all(answer(:));
    catch problem
        % A part that is not there yet, and nothing else, may be waited for: s.local(3) or s.position.alt_rel of [].
        missing = 'out.?of.?bound|index.*exceed|badsubscript|cannot be indexed with \.|dot indexing|structRefFromNonStruct';
        if isempty(regexpi([problem.identifier ' ' problem.message], missing, 'once'))
            rethrow(problem);
        end
        yes = false;
    end
end

function value = text(value)
    if isempty(value)
        value = 'unknown';
    end
end
