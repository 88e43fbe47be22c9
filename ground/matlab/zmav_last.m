function [fields, age] = zmav_last(z, vehicle, message)
%ZMAV_LAST  The fields of the last MAVLink message of a kind.
%   FIELDS = ZMAV_LAST(Z, VEHICLE, MESSAGE) is a structure with the message's fields, in MAVLink's own units. VEHICLE is
%   a name, or [SYS COMP]; MESSAGE a name like 'ATTITUDE'. Enumerated fields are names ('MAV_TYPE_QUADROTOR').
%   [FIELDS, AGE] also gives the seconds since it came.
%
%   Errors: 'zmav:not_found' where no such message came; 'zmav:no_such_vehicle'.
%
%   Example:
%       attitude = zmav_last(z, 'quad1', 'ATTITUDE');
%       fprintf('roll %.1f deg\n', attitude.roll * 180 / pi);
%
%   See also ZMAV_STREAM, ZMAV_GET.

    [sys, comp] = zmav_system(z, vehicle);
    text = zmav_http(z, 'get', sprintf('/last/%d/%d/%s', sys, comp, zmav_encode(message)));
    lines = regexp(strtrim(text), '\r?\n', 'split');
    fields = struct();
    age = NaN;
    for k = 1:numel(lines)
        [name, rest] = strtok(lines{k}, ' ');
        value = number(rest(2:end));
        if k == 1
            age = value;
        else
            fields.(matlab.lang.makeValidName(name)) = value;
        end
    end
end

function value = number(text)
    % A number, a row of numbers, or text that is none.
    numeric = '[-+]?(\d+\.?\d*([eE][-+]?\d+)?|nan|inf)';
    if isempty(regexpi(text, ['^' numeric '([ ,]+' numeric ')*$'], 'once'))
        value = text;
    else
        value = str2double(regexp(text, '[ ,]+', 'split'));
    end
end
