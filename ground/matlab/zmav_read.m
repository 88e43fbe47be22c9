function messages = zmav_read(stream, timeout)
%ZMAV_READ  The messages that have come on a stream, oldest first.
%   MESSAGES = ZMAV_READ(STREAM, TIMEOUT) waits for the first one for TIMEOUT seconds at most (default 1), and returns it
%   with whatever else has come: a row of structures as ZMAV_DECODE makes them, with fields besides: the message's
%   fields in MAVLink's own units ([] for a message that the toolbox does not know). Empty where nothing came.
%
%   Example:
%       for message = zmav_read(stream, 1)
%           fprintf('%s from %d\n', message.name, message.sys);
%       end
%
%   See also ZMAV_STREAM, ZMAV_DECODE.

    if nargin < 2
        timeout = 1;
    end
    if strcmp(stream.kind, 'poll')
        messages = poll(stream, timeout);
        return
    end
    datagrams = zmav_socket('receive', stream.kind, stream.socket, timeout);
    messages = struct('version', {}, 'sys', {}, 'comp', {}, 'seq', {}, 'msgid', {}, 'name', {}, 'payload', {}, ...
        'signed', {}, 'checked', {}, 'fields', {});
    for k = 1:numel(datagrams)
        for frame = zmav_decode(datagrams{k})
            frame.fields = zmav_fields(frame);
            messages(end + 1) = frame; %#ok<AGROW>
        end
    end
    messages = reshape(messages, 1, []);
end

function messages = poll(stream, timeout)
    begun = tic;
    while true
        messages = struct('name', {}, 'sys', {}, 'comp', {}, 'fields', {});
        for name = stream.names
            try
                [fields, age] = zmav_last(stream.z, [stream.sys, stream.comp], name{1});
            catch problem
                if ~strcmp(problem.identifier, 'zmav:not_found')
                    rethrow(problem);
                end
                continue
            end
            came = now * 86400 - age;
            if ~isKey(stream.seen, name{1}) || came - stream.seen(name{1}) > 0.02  % s: the same one, else
                stream.seen(name{1}) = came;
                messages(end + 1) = struct('name', name{1}, 'sys', stream.sys, 'comp', stream.comp, ...
                    'fields', fields); %#ok<AGROW>
            end
        end
        if ~isempty(messages) || toc(begun) >= timeout
            return
        end
        pause(0.05);
    end
end
