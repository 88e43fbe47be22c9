function [frames, rest, skipped] = zmav_decode(bytes)
%ZMAV_DECODE  MAVLink 1 and 2 frames out of bytes.
%   FRAMES = ZMAV_DECODE(BYTES) is a row of structures with the fields version (1 or 2), sys, comp, seq, msgid, name
%   ('' for a message the toolbox does not know), payload (uint8 row; zeros that MAVLink 2 left out at its end are put
%   back where the message is known), signed, and checked: the checksum was right, which can only be told for a known
%   message. A frame of a known message whose checksum is wrong is skipped, and so is one of an unknown message that no
%   other frame follows, unless BYTES end with it. Signatures are not verified here.
%   [FRAMES, REST, SKIPPED] also returns the beginning of a frame at the end of BYTES, to be put before the next ones,
%   and how many bytes were no frame.
%
%   Frames: https://mavlink.io/en/guide/serialization.html
%
%   Example:
%       id = fopen('flight.tlog'); bytes = fread(id, Inf, '*uint8'); fclose(id);
%       frames = zmav_decode(bytes);
%       disp(unique({frames.name}));
%
%   See also ZMAV_FIELDS, ZMAV_READ.

    bytes = reshape(uint8(bytes), 1, []);
    found = {};
    skipped = 0;
    at = 1;
    last = numel(bytes);
    rest = zeros(1, 0, 'uint8');
    for start = find(bytes == 253 | bytes == 254)
        if start < at  % within the frame before
            continue
        end
        skipped = skipped + start - at;
        at = start;
        [frame, size] = one(bytes, at, last);
        if size == 0  % the rest of it is still to come
            rest = bytes(at:last);
            at = last + 1;
        elseif isempty(frame)
            skipped = skipped + 1;
            at = at + 1;
        else
            found{end + 1} = frame; %#ok<AGROW>
            at = at + size;
        end
    end
    skipped = skipped + last + 1 - at;
    frames = struct('version', {}, 'sys', {}, 'comp', {}, 'seq', {}, 'msgid', {}, 'name', {}, 'payload', {}, ...
        'signed', {}, 'checked', {});
    frames = reshape([frames, found{:}], 1, []);
end

function [frame, size] = one(bytes, at, last)
    frame = [];
    size = 0;
    version = 1 + (bytes(at) == 253);
    header = 6 + 4 * (version == 2);
    if at + header - 1 > last
        return
    end
    count = double(bytes(at + 1));
    signed = version == 2 && bitand(bytes(at + 2), 1) ~= 0;
    if version == 2 && bitand(bytes(at + 2), 254) ~= 0  % flags that change the format in a way not known here
        size = 1;
        return
    end
    size = header + count + 2 + 13 * signed;
    if at + size - 1 > last
        size = 0;
        return
    end
    head = double(bytes(at:at + header - 1));
    if version == 2
        part = head([5 6 7]);
        msgid = head(8) + 256 * head(9) + 65536 * head(10);
    else
        part = head([3 4 5]);
        msgid = head(6);
    end
    payload = bytes(at + header:at + header + count - 1);
    layout = zmav_layout(msgid);
    name = '';
    checked = false;
    if ~isempty(layout)
        sum = double(bytes(at + header + count)) + 256 * double(bytes(at + header + count + 1));
        if zmav_checksum([bytes(at + 1:at + header + count - 1), uint8(layout.crc_extra)]) ~= sum
            return
        end
        name = layout.name;
        checked = true;
        if version == 2
            payload(end + 1:layout.size) = 0;
        end
    elseif ~followed(bytes, at + size, last)
        return
    end
    frame = struct('version', version, 'sys', part(2), 'comp', part(3), 'seq', part(1), 'msgid', msgid, ...
        'name', name, 'payload', payload, 'signed', signed, 'checked', checked);
end

function yes = followed(bytes, at, last)
    % No checksum vouches for an unknown message: what comes next must do, at once or behind the time stamp of a .tlog.
    next = [at, at + 8];
    next = next(next <= last);
    yes = at > last || any(bytes(next) == 253 | bytes(next) == 254);
end
