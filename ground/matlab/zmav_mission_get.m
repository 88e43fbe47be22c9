function items = zmav_mission_get(z, vehicle, kind)
%ZMAV_MISSION_GET  A vehicle's mission, geofence or rally points, from its cache.
%   ITEMS = ZMAV_MISSION_GET(Z, VEHICLE) and ZMAV_MISSION_GET(Z, VEHICLE, 'fence') or 'rally': a row of structures with
%   the fields of ZMAV_MISSION_ITEM.
%
%   Example:
%       items = zmav_mission_get(z, 'quad1');
%       plot([items.y], [items.x]);
%
%   See also ZMAV_MISSION_UPLOAD.

    if nargin < 3
        kind = 'mission';
    end
    plan = zmav_get(z, [zmav_vehicle_name(vehicle) '/mission/' zmav_char(kind)], 10);
    items = zmav_mission_item('NAV_WAYPOINT', 0, 0, 0);
    items = items([]);
    for k = 1:numel(plan.items)
        if iscell(plan.items)
            given = plan.items{k};
        else
            given = plan.items(k);
        end
        item = zmav_mission_item(given.command, 0, 0, 0);
        for name = fieldnames(item)'
            if isfield(given, name{1})
                item.(name{1}) = given.(name{1});
            end
        end
        item.params = reshape(item.params, 1, []);
        items(end + 1) = item; %#ok<AGROW>
    end
    items = reshape(items, 1, []);
end
