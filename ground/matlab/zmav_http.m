function body = zmav_http(z, method, path, params)
%ZMAV_HTTP  Ask the gateway, and return what it answers: all other functions go through here.
%   BODY = ZMAV_HTTP(Z, 'get', PATH, PARAMS) and ZMAV_HTTP(Z, 'post', PATH, PARAMS). PATH begins with a slash and is
%   percent-encoded already; PARAMS is a cell row {NAME, TEXT, ...}. BODY is the decoded JSON, or text.
%
%   urlread of MATLAB and of Octave both hide the text of an answer that is an error. The gateway is therefore asked
%   with envelope=1: it answers {"ok", "status", "body"}, and always with status 200.
%
%   Errors: 'zmav:unreachable'; 'zmav:KIND' with the gateway's words, where KIND is refused, forbidden, no_such_vehicle,
%   timed_out, not_holder, bad_input ... as in docs/matlab.md; 'zmav:http' for an answer that is not the gateway's.
%
%   Example:
%       text = zmav_http(z, 'get', '/metrics');
%
%   See also ZMAV_GET, ZMAV_DO.

    if nargin < 4
        params = {};
    end
    mark = '?';
    if any(path == '?')
        mark = '&';
    end
    address = [z.url path mark 'envelope=1'];
    if ~isempty(z.token)
        address = [address '&token=' zmav_encode(z.token)];
    end
    if strcmp(method, 'get')
        for k = 1:2:numel(params)
            address = [address '&' zmav_encode(params{k}) '=' zmav_encode(params{k + 1})]; %#ok<AGROW>
        end
        params = {};
    end
    [text, ok] = fetch(z, address, method, params);
    if ~ok
        error('zmav:unreachable', 'no answer from %s%s: is ''zmav http'' running there?', z.url, path);
    end
    try
        answer = jsondecode(text);
        known = isstruct(answer) && isfield(answer, 'ok') && isfield(answer, 'status');
    catch
        known = false;
    end
    if ~known
        error('zmav:http', '%s%s did not answer as a zmav gateway does: %s', z.url, path, text(1:min(end, 80)));
    end
    body = answer.body;
    if ~answer.ok
        [kind, words] = reason(answer);
        error(['zmav:' kind], '%s', words);
    end
end

function [text, ok] = fetch(z, address, method, params)
    if exist('OCTAVE_VERSION', 'builtin')
        [text, ok] = urlread(address, method, params); %#ok<URLRD>
    elseif isempty(params)
        [text, ok] = urlread(address, 'Timeout', z.timeout, 'Charset', 'UTF-8'); %#ok<URLRD>
    else
        [text, ok] = urlread(address, method, params, 'Timeout', z.timeout, 'Charset', 'UTF-8'); %#ok<URLRD>
    end
end

function [kind, words] = reason(answer)
    kind = 'http';
    body = answer.body;
    if isstruct(body) && isfield(body, 'error')
        kind = body.error.kind;
        words = body.error.text;
    elseif ischar(body)
        words = strtrim(body);
        kinds = {400, 'bad_input'; 401, 'token'; 403, 'forbidden'; 404, 'not_found'; 409, 'refused'; 504, 'timed_out'};
        at = find([kinds{:, 1}] == answer.status);
        if ~isempty(at)
            kind = kinds{at, 2};
        end
    else
        words = sprintf('the gateway answered with status %d', answer.status);
    end
end
