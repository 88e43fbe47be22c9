function params = zmav_arguments(given, write)
%ZMAV_ARGUMENTS  {'name', value, ...}, or one structure, as {'name', TEXT, ...} for a form or a query.
%   WRITE makes the text of a value; without one it is JSON.
    given = cellfun(@zmav_char, given, 'UniformOutput', false);
    if numel(given) == 1 && isstruct(given{1})
        names = fieldnames(given{1})';
        values = struct2cell(given{1})';
    elseif mod(numel(given), 2) == 0 && iscellstr(given(1:2:end))
        names = given(1:2:end);
        values = given(2:2:end);
    else
        error('zmav:bad_input', 'expected pairs of a name and a value, or one structure');
    end
    if nargin < 2
        write = @zmav_json;
    end
    params = cell(1, 2 * numel(names));
    params(1:2:end) = names;
    for k = 1:numel(names)
        params{2 * k} = write(values{k});
    end
end
