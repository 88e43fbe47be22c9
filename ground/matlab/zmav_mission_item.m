function item = zmav_mission_item(command, x, y, height, varargin)
%ZMAV_MISSION_ITEM  One item of a mission.
%   ITEM = ZMAV_MISSION_ITEM(COMMAND, LAT, LON, HEIGHT) with degrees WGS84 and metres above home. COMMAND is a MAV_CMD's
%   name, such as 'NAV_WAYPOINT', 'NAV_TAKEOFF', 'NAV_LAND', 'DO_CHANGE_SPEED'.
%   Options behind it: 'params' (param1 to param4; NaN where there is none), 'frame' (a MAV_FRAME's name),
%   'autocontinue'.
%
%   Example:
%       item = zmav_mission_item('NAV_WAYPOINT', -35.3632, 149.1652, 20, 'params', [5 0 0 NaN]);
%
%   See also ZMAV_MISSION_UPLOAD.

    given = zmav_options(varargin, struct( ...
        'frame', 'MAV_FRAME_GLOBAL_RELATIVE_ALT', 'params', [], 'autocontinue', true));
    command = zmav_char(command);
    if isempty(regexp(command, '^MAV_CMD_', 'once'))
        command = ['MAV_CMD_' command];
    end
    item = struct('command', command, 'frame', given.frame, 'x', x, 'y', y, 'z', height, ...
        'autocontinue', logical(given.autocontinue), 'params', given.params);
end
