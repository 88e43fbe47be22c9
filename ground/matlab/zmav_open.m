function z = zmav_open(url, varargin)
%ZMAV_OPEN  Begin to use a fleet through its HTTP gateway ('zmav http').
%   Z = ZMAV_OPEN() uses the gateway at http://127.0.0.1:8088.
%   Z = ZMAV_OPEN(URL) uses the one at URL.
%   Z = ZMAV_OPEN(URL, 'Token', T) shows the token T with every request; the default is the environment variable
%   ZMAV_HTTP_TOKEN. ..., 'As', NAME streams setpoints under that name; without one, of all scripts on this computer only
%   one can stream to a vehicle at a time. ..., 'Timeout', S gives up an answer after S seconds (MATLAB only: Octave's urlread waits).
%
%   Z is a structure that every other function takes first. Use zmav_close when done: it gives back what was taken.
%
%   Errors: 'zmav:unreachable' where no gateway answers, 'zmav:token' where it does not know the token.
%
%   Example:
%       z = zmav_open();
%       for vehicle = zmav_vehicles(z)
%           fprintf('%s: %s\n', vehicle.name, vehicle.mode);
%       end
%       zmav_close(z);
%
%   See also ZMAV_CLOSE, ZMAV_VEHICLES, ZMAV_SQUARE.

    if nargin < 1 || isempty(url)
        url = 'http://127.0.0.1:8088';
    end
    url = zmav_char(url);
    given = zmav_options(varargin, struct('Token', getenv('ZMAV_HTTP_TOKEN'), 'As', '', 'Timeout', 330));
    if ~ischar(url) || isempty(regexp(url, '^https?://[^/]', 'once'))
        error('zmav:bad_input', 'url: expected something like http://127.0.0.1:8088');
    end
    if ~isempty(given.As)
        zmav_vehicle_name(given.As);
    end
    z = struct('url', regexprep(url, '/+$', ''), 'token', given.Token, 'as', given.As, 'timeout', given.Timeout);
    z.held = containers.Map();  % a handle: every copy of Z sees what was taken through one of them
    zmav_http(z, 'get', '/vehicles');
end
