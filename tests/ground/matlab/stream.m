% A stream of messages, by whatever there is to receive it.
z = zmav_open(getenv('URL'));
kind = getenv('TRANSPORT');
stream = zmav_stream(z, 'quad1', 'Messages', {'ATTITUDE', 'HEARTBEAT'}, 'Hz', 20, 'Transport', kind);
seen = {};
begun = tic;
while numel(unique(seen)) < 2 && toc(begun) < 60
    for message = zmav_read(stream, 5)
        seen{end + 1} = message.name;
        assert(message.sys, 1);
        if strcmp(message.name, 'ATTITUDE')
            assert(abs(message.fields.roll) < 0.2);
            assert(message.fields.time_boot_ms > 0);
        end
    end
end
assert(unique(seen), {'ATTITUDE', 'HEARTBEAT'});
zmav_stop(z, stream);
assert(isempty(keys(z.held)));

% All of a system's messages; closing ends what is still open.
if ~strcmp(kind, 'poll')
    stream = zmav_stream(z, [1 0], 'Transport', kind);
    message = zmav_read(stream, 10);
    assert(message(1).checked);
    refused('zmav:not_found', 'system id 9', @() zmav_stream(z, [9 0], 'Transport', kind));
    zmav_close(z);
    assert(isempty(keys(z.held)));
end
refused('zmav:bad_input', 'Messages', @() zmav_stream(z, 'quad1', 'Transport', 'poll'));
refused('zmav:bad_input', 'udpport', @() zmav_stream(z, 'quad1', 'Transport', 'pigeon'));
