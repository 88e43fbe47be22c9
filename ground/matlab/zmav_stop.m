function zmav_stop(z, stream)
%ZMAV_STOP  End a stream of messages.
%   ZMAV_STOP(Z, STREAM)
%
%   Example:
%       zmav_stop(z, stream);
%
%   See also ZMAV_STREAM.

    if strcmp(stream.kind, 'poll')
        return
    end
    name = sprintf('stream %d', stream.port);
    if isKey(z.held, name)
        remove(z.held, name);
    end
    zmav_socket('close', stream.kind, stream.socket);
    try
        zmav_http(z, 'get', sprintf('/stop/%d/%d', stream.sys, stream.comp), {'port', sprintf('%d', stream.port)});
    catch problem
        if ~strcmp(problem.identifier, 'zmav:not_found')  % it is over already
            rethrow(problem);
        end
    end
end
