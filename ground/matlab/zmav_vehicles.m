function vehicles = zmav_vehicles(z)
%ZMAV_VEHICLES  Who is there: a row of structures, one a vehicle, by name.
%   VEHICLES = ZMAV_VEHICLES(Z) holds for each vehicle the fields name, fleet, sysid, compid, autopilot, kind, mode,
%   armed, connected (its autopilot is heard) and state (everything it says of itself, as ZMAV_GET returns it).
%
%   Example:
%       vehicles = zmav_vehicles(z);
%       disp({vehicles.name; vehicles.mode}');
%
%   See also ZMAV_GET.

    answers = zmav_get(z, '*/state');
    names = {'name', 'fleet', 'sysid', 'compid', 'autopilot', 'kind', 'mode', 'armed', 'connected', 'state'};
    vehicles = cell2struct(cell(numel(names), 0), names, 1)';
    for k = 1:numel(answers)
        state = answers(k).value;
        if ~isstruct(state)
            continue
        end
        vehicle = struct();
        for name = names(1:end - 1)
            vehicle.(name{1}) = state.(name{1});
        end
        vehicle.state = state;
        vehicles(end + 1) = vehicle; %#ok<AGROW>
    end
    [~, order] = sort({vehicles.name});
    vehicles = reshape(vehicles(order), 1, []);
end
