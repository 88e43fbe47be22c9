function name = zmav_vehicle_name(name)
%ZMAV_VEHICLE_NAME  The name of a vehicle, given as text or as a structure with a field name (of zmav_vehicles).
    if isstruct(name) && isscalar(name) && isfield(name, 'name')
        name = name.name;
    end
    name = zmav_char(name);
    if ~ischar(name) || isempty(regexp(name, '^[a-z0-9_-]+$', 'once'))
        error('zmav:bad_input', 'vehicle: expected a name like quad1 (lower-case letters, digits, - and _)');
    end
end
