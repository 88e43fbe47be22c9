function values = zmav_options(given, values)
%ZMAV_OPTIONS  A structure of defaults, with what {'Name', value, ...} says instead; names in any case.
    if mod(numel(given), 2) ~= 0
        error('zmav:bad_input', 'expected pairs of a name and a value');
    end
    given = cellfun(@zmav_char, given, 'UniformOutput', false);
    names = fieldnames(values);
    for k = 1:2:numel(given)
        at = ischar(given{k}) && any(strcmpi(given{k}, names));
        if ~at
            error('zmav:bad_input', 'option %d: expected one of: %s', k, strjoin(names', ', '));
        end
        values.(names{strcmpi(given{k}, names)}) = given{k + 1};
    end
end
