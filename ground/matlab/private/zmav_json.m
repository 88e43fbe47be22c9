function text = zmav_json(value)
%ZMAV_JSON  Value as JSON; numbers with all their digits, which jsonencode cuts at fifteen or fewer.
    if isnumeric(value) && isreal(value) && ~isempty(value) && (isvector(value) || isscalar(value))
        parts = cell(1, numel(value));
        for k = 1:numel(value)
            if isinteger(value)
                parts{k} = sprintf('%d', value(k));
            elseif isfinite(value(k))
                parts{k} = sprintf('%.17g', value(k));
            else
                parts{k} = 'null';
            end
        end
        text = strjoin(parts, ',');
        if ~isscalar(value)
            text = ['[' text ']'];
        end
    else
        text = jsonencode(value);
    end
end
