function [sys, comp] = zmav_system(z, vehicle)
%ZMAV_SYSTEM  System and component id of a vehicle's autopilot; [SYS COMP] is taken as it is, and SYS as [SYS 1].
    if isnumeric(vehicle)
        ids = [double(vehicle(:)'), 1];
        if isempty(vehicle) || numel(vehicle) > 2 || any(ids < 0) || any(ids > 255) || any(ids ~= fix(ids))
            error('zmav:bad_input', 'vehicle: expected a name, or [SYS COMP] of 0 to 255');
        end
        sys = ids(1);
        comp = ids(2);
        return
    end
    state = zmav_get(z, zmav_vehicle_name(vehicle));
    if isempty(state.sysid)
        error('zmav:stale', '%s: its autopilot was not heard yet', state.name);
    end
    sys = state.sysid;
    comp = state.compid;
end
