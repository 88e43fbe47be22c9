function [value, t] = zmav_get(z, key, timeout)
%ZMAV_GET  The state of a vehicle, or whatever else the key space holds.
%   STATE = ZMAV_GET(Z, 'quad1') is what the vehicle quad1 says of itself: mode, armed, ready, position (lat_deg,
%   lon_deg, alt_amsl, alt_rel), local (m north, east, down about the fleet's origin), velocity (m/s, north, east,
%   down), attitude (roll, pitch, yaw in radians), battery, gps, lease ... A part never heard of is [].
%   VALUE = ZMAV_GET(Z, 'quad1/param/RTL_ALT'), 'quad1/mission/mission', 'quad1/msg/ATTITUDE', 'quad1/ATTITUDE',
%   'quad1/link/autopilot' or a whole key 'zmav/FLEET/...' is what is there.
%   ANSWERS = ZMAV_GET(Z, 'quad*/state'), with a star, is a row of structures with fields key, t and value.
%   [VALUE, T] also gives the UTC seconds at which it was said.
%   ZMAV_GET(Z, KEY, S) waits for answers for S seconds at most (default 2).
%
%   Vectors are columns. Errors: 'zmav:not_found' where nobody answers, and the gateway's own.
%
%   Example:
%       state = zmav_get(z, 'quad1');
%       fprintf('%.1f m north, %.1f m up\n', state.local(1), -state.local(3));
%
%   See also ZMAV_VEHICLES, ZMAV_LAST, ZMAV_WAIT.

    params = {};
    if nargin > 2
        params = {'timeout', sprintf('%g', timeout)};
    end
    if isstruct(key)
        key = zmav_vehicle_name(key);
    end
    key = zmav_char(key);
    parts = regexp(key, '/', 'split');
    for k = 1:numel(parts)
        parts{k} = zmav_encode(parts{k});
    end
    body = zmav_http(z, 'get', ['/keys/' strjoin(parts, '/')], params);
    answers = rows(body);
    if any(key == '*')
        value = answers;
        t = [answers.t];
        return
    end
    if isempty(answers)
        error('zmav:not_found', 'nobody answers for %s', key);
    elseif numel(answers) > 1
        error('zmav:ambiguous', '%s has several answers: %s', key, strjoin({answers.key}, ', '));
    elseif ~isempty(answers.error)
        error(['zmav:' answers.error.kind], '%s', answers.error.text);
    end
    value = answers.value;
    t = answers.t;
end

function answers = rows(body)
    % jsondecode makes an array of structures, or a cell where their fields differ, or [] of nothing.
    if isstruct(body)
        body = num2cell(body(:)');
    elseif isempty(body)
        body = {};
    end
    answers = struct('key', {}, 't', {}, 'value', {}, 'error', {});
    for k = 1:numel(body)
        each = struct('key', body{k}.key, 't', [], 'value', [], 'error', []);
        for name = {'t', 'value', 'error'}
            if isfield(body{k}, name{1})
                each.(name{1}) = body{k}.(name{1});
            end
        end
        answers(end + 1) = each; %#ok<AGROW>
    end
end
