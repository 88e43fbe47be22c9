function names = zmav_message_fields(message)
%ZMAV_MESSAGE_FIELDS  The names of a message's fields, in the payload's order; an error for a message not known.
    folder = fileparts(mfilename('fullpath'));
    line = regexp(fileread(fullfile(folder, 'messages.txt')), ...
        ['^(\d+) ' regexptranslate('escape', message) ' .*$'], 'tokens', 'once', 'lineanchors', 'dotexceptnewline');
    if isempty(line)
        error('zmav:bad_input', 'no message is called %s', message);
    end
    layout = zmav_layout(str2double(line{1}));
    names = {layout.fields.name};
end
