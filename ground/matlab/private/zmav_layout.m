function layout = zmav_layout(msgid)
%ZMAV_LAYOUT  How a message is laid out: a structure with name, crc_extra, size and fields; [] for one not known.
%   It reads messages.txt beside it, which messages.py in the folder above makes from the dialect.
    persistent known
    if isempty(known)
        known = containers.Map('KeyType', 'double', 'ValueType', 'any');
        folder = fileparts(mfilename('fullpath'));
        lines = regexp(strtrim(fileread(fullfile(folder, 'messages.txt'))), '\r?\n', 'split');
        for k = 1:numel(lines)
            id = str2double(strtok(lines{k}, ' '));
            known(id) = lines{k};  % taken apart when first needed
        end
    end
    layout = [];
    if ~isKey(known, msgid)
        return
    end
    layout = known(msgid);
    if ischar(layout)
        layout = parse(layout);
        known(msgid) = layout;
    end
end

function layout = parse(line)
    parts = regexp(line, ' ', 'split');
    layout = struct('name', parts{2}, 'crc_extra', str2double(parts{3}), 'size', 0, 'fields', []);
    sizes = struct('char', 1, 'int8', 1, 'uint8', 1, 'int16', 2, 'uint16', 2, 'int32', 4, 'uint32', 4, ...
        'int64', 8, 'uint64', 8, 'single', 4, 'double', 8);
    for k = 4:numel(parts)
        part = regexp(parts{k}, ':', 'split');
        count = str2double(part{3});
        field = struct('name', matlab.lang.makeValidName(part{1}), 'type', part{2}, 'count', count, 'at', layout.size);
        layout.fields = [layout.fields, field];
        layout.size = layout.size + count * sizes.(part{2});
    end
end
