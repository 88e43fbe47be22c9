function zmav_mission_upload(z, vehicle, items, kind)
%ZMAV_MISSION_UPLOAD  Replace a vehicle's mission, geofence or rally points.
%   ZMAV_MISSION_UPLOAD(Z, VEHICLE, ITEMS) with a vector of structures as ZMAV_MISSION_ITEM makes them.
%   ZMAV_MISSION_UPLOAD(Z, VEHICLE, ITEMS, 'fence') or 'rally'. An upload that fails leaves the old plan in force.
%
%   Example:
%       up = zmav_mission_item('NAV_TAKEOFF', 0, 0, 10);
%       to = zmav_mission_item('NAV_WAYPOINT', -35.3628, 149.1652, 10);
%       zmav_mission_upload(z, 'quad1', [up to]);
%       zmav_arm(z, 'quad1');
%       zmav_mission_start(z, 'quad1');
%
%   See also ZMAV_MISSION_ITEM, ZMAV_MISSION_GET, ZMAV_MISSION_START, ZMAV_MISSION_CLEAR.

    if nargin < 4
        kind = 'mission';
    end
    parts = cell(1, numel(items));
    for k = 1:numel(items)
        parts{k} = one(items(k));
    end
    list = ['[' strjoin(parts, ',') ']'];
    params = {'kind', zmav_json(zmav_char(kind)), 'items', list};
    zmav_http(z, 'post', ['/do/' zmav_vehicle_name(vehicle) '/mission_upload'], params);
end

function text = one(item)
    % Field by field: degrees with all their digits, and params a list whatever its length.
    parts = {};
    for name = fieldnames(item)'
        value = item.(name{1});
        if strcmp(name{1}, 'params')
            text = zmav_list(value);
        else
            text = zmav_json(value);
        end
        parts{end + 1} = ['"' name{1} '":' text]; %#ok<AGROW>
    end
    text = ['{' strjoin(parts, ',') '}'];
end
