function text = zmav_encode(text)
%ZMAV_ENCODE  Percent-encode text for an address (RFC 3986): UTF-8, everything but letters, digits and -._~
    bytes = unicode2native(zmav_char(text), 'UTF-8');
    parts = cell(1, numel(bytes));
    for k = 1:numel(bytes)
        if any(bytes(k) == 'abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-._~')
            parts{k} = char(bytes(k));
        else
            parts{k} = sprintf('%%%02X', bytes(k));
        end
    end
    text = [parts{:}];
    if isempty(text)
        text = '';
    end
end
