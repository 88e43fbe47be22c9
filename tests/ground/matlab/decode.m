% Frames that Python wrote, one after another, against what it says they are.
id = fopen(getenv('FRAMES'));
bytes = fread(id, Inf, '*uint8');
fclose(id);
expected = jsondecode(fileread(getenv('EXPECTED')));
if isstruct(expected)
    expected = num2cell(expected);
end

[frames, rest, skipped] = zmav_decode(bytes);
assert(numel(frames), numel(expected));
assert(numel(rest), str2double(getenv('REST')));
assert(skipped, str2double(getenv('SKIPPED')));
for k = 1:numel(frames)
    frame = frames(k);
    want = expected{k};
    for name = {'version', 'sys', 'comp', 'seq', 'msgid', 'name', 'signed', 'checked'}
        assert(double(frame.(name{1})), double(want.(name{1})));
    end
    fields = zmav_fields(frame);
    if ~frame.checked
        assert(isempty(fields));
        continue
    end
    names = fieldnames(want.fields);
    assert(sort(fieldnames(fields)), sort(names));
    for n = 1:numel(names)
        value = fields.(names{n});
        wanted = want.fields.(names{n});
        if ischar(value)
            assert(value, wanted);
        elseif isinteger(value)  % 64 bits come as text, as JSON's numbers have 53
            assert(sprintf('%lu', value), wanted);
        else
            wanted(wanted == 1e300) = NaN;
            assert(reshape(value, [], 1), reshape(wanted, [], 1), -1e-7);
        end
    end
end

% In pieces: what is left of one is put before the next.
count = 0;
rest = zeros(1, 0, 'uint8');
for at = 1:7:numel(bytes)
    [some, rest] = zmav_decode([rest, bytes(at:min(end, at + 6))']);
    count = count + numel(some);
end
assert(count, numel(frames));
assert(isempty(zmav_decode([])));
