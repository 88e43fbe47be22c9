% Every file of the toolbox can be read by Octave, says what it is for, and is listed in Contents.m.
folder = getenv('TOOLBOX');
contents = fileread(fullfile(folder, 'Contents.m'));
files = dir(fullfile(folder, '*.m'));
assert(numel(files) > 30);
for k = 1:numel(files)
    [~, name] = fileparts(files(k).name);
    path = fullfile(folder, files(k).name);
    __parse_file__(path);
    if strcmp(name, 'Contents')
        continue
    end
    assert(~isempty(regexp(contents, ['\n%   ' name ' '], 'once')) || strcmp(name, 'ZmavBlock'), [name ' is not in Contents.m']);
    lines = regexp(fileread(path), '\r?\n', 'split');
    assert(~isempty(regexp(lines{1}, ['^(function|classdef) .*\<' name '\>'], 'once')), [name ': ' lines{1}]);
    first = ['%' upper(name) '  '];
    assert(strncmp(lines{2}, first, numel(first)), [name ': ' lines{2}]);
    text = strjoin(lines, "\n");
    if any(strcmp(name, {'zmav_sfun', 'ZmavBlock'}))
        continue  % they are not called by hand
    end
    assert(~isempty(strfind(text, 'Example')), [name ' has no example']);
    assert(~isempty(strfind(text, 'See also')), [name ' names nothing else']);
end
