function fields = zmav_fields(frame)
%ZMAV_FIELDS  The fields of a frame of ZMAV_DECODE, as a structure, in MAVLink's own units.
%   FIELDS = ZMAV_FIELDS(FRAME): numbers are double (64-bit integers stay what they are), arrays rows, texts without
%   their padding, enumerated fields numbers. [] for a message that the toolbox does not know.
%
%   Example:
%       frames = zmav_decode(bytes);
%       attitude = zmav_fields(frames(find(strcmp({frames.name}, 'ATTITUDE'), 1)));
%
%   See also ZMAV_DECODE, ZMAV_LAST.

    fields = [];
    layout = zmav_layout(frame.msgid);
    if isempty(layout)
        return
    end
    payload = frame.payload;
    payload(end + 1:layout.size) = 0;  % MAVLink 1 has no extensions
    fields = struct();
    for field = layout.fields
        fields.(field.name) = value(payload, field);
    end
end

function value = value(payload, field)
    if strcmp(field.type, 'char')
        value = char(payload(field.at + 1:field.at + field.count));
        value = value(1:find([value char(0)] == 0, 1) - 1);
        return
    end
    sizes = struct('int8', 1, 'uint8', 1, 'int16', 2, 'uint16', 2, 'int32', 4, 'uint32', 4, 'int64', 8, ...
        'uint64', 8, 'single', 4, 'double', 8);
    bytes = payload(field.at + 1:field.at + field.count * sizes.(field.type));
    value = typecast(bytes, field.type);  % every machine that runs MATLAB is little-endian, as MAVLink is
    if isempty(strfind(field.type, '64')) %#ok<STREMP>
        value = double(value);
    end
end
