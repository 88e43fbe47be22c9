function text = zmav_list(values)
%ZMAV_LIST  Numbers as a JSON list, also where there is one or none.
    text = zmav_json([values(:)' 0 0]);
    text = regexprep(text, ',?0,0\]$', ']');
end
