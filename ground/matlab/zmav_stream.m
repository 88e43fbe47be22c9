function stream = zmav_stream(z, vehicle, varargin)
%ZMAV_STREAM  Have a vehicle's MAVLink messages sent here by UDP, as they come.
%   STREAM = ZMAV_STREAM(Z, VEHICLE) with a name (all its components), or [SYS COMP]; COMP 0: all components.
%   ZMAV_STREAM(..., 'Messages', {'ATTITUDE', ...}) has only these, and has the vehicle send them. ..., 'Hz', F at most F
%   of each a second.
%   ZMAV_STREAM(..., 'Transport', 'java' | 'udpport' | 'poll'): base MATLAB receives UDP by Java or, since R2020b, by
%   udpport. Octave receives it where it has Java (usejava('jvm')); without, ZMAV_READ asks the gateway for the last
%   message of each of 'Messages' ('poll'), so that some may be missed. 'auto' (default) takes what there is.
%
%   Errors: 'zmav:not_found' where there is no such system, 'zmav:bad_input'.
%
%   Example:
%       stream = zmav_stream(z, 'quad1', 'Messages', {'ATTITUDE'}, 'Hz', 20);
%       message = zmav_read(stream, 2);
%       disp(message(end).fields.roll);
%       zmav_stop(z, stream);
%
%   See also ZMAV_READ, ZMAV_STOP, ZMAV_DECODE, ZMAV_LAST.

    given = zmav_options(varargin, struct('Messages', {{}}, 'Hz', [], 'Transport', 'auto'));
    names = cellstr(given.Messages);
    names = names(~cellfun(@isempty, names));
    [sys, comp] = zmav_system(z, vehicle);
    if ~isnumeric(vehicle)
        comp = 0;
    end
    kind = given.Transport;
    if strcmp(kind, 'auto')
        kind = transport();
    end
    stream = struct('kind', kind, 'sys', sys, 'comp', comp, 'names', {reshape(names, 1, [])}, 'port', 0, ...
        'socket', [], 'z', z);
    if strcmp(kind, 'poll')
        if isempty(names)
            error('zmav:bad_input', 'Messages: say which, as there is no UDP here to receive all of them by');
        end
        stream.seen = containers.Map();
        return
    end
    params = {};
    if ~isempty(names)
        params = [params, {'msg', strjoin(stream.names, ',')}];
    end
    if ~isempty(given.Hz)
        params = [params, {'hz', sprintf('%.17g', given.Hz)}];
    end
    [stream.socket, stream.port] = zmav_socket('open', kind);
    try
        zmav_http(z, 'get', sprintf('/stream/%d/%d', sys, comp), [params, {'port', sprintf('%d', stream.port)}]);
    catch problem
        zmav_socket('close', kind, stream.socket);
        rethrow(problem);
    end
    z.held(sprintf('stream %d', stream.port)) = struct('kind', 'stream', 'stream', stream);
end

function kind = transport()
    if usejava('jvm')
        kind = 'java';
    elseif ~isempty(which('udpport'))
        kind = 'udpport';
    else
        kind = 'poll';
        if exist('OCTAVE_VERSION', 'builtin')  % it starts Java when it is first used
            try
                javaMethod('currentTimeMillis', 'java.lang.System');
                kind = 'java';
            catch
                return
            end
        end
    end
end
