function zmav_mission_clear(z, vehicle, kind)
%ZMAV_MISSION_CLEAR  Clear a vehicle's mission, geofence ('fence') or rally points ('rally').
%   ZMAV_MISSION_CLEAR(Z, VEHICLE) and ZMAV_MISSION_CLEAR(Z, VEHICLE, KIND)
%
%   Example:
%       zmav_mission_clear(z, 'quad1');
%
%   See also ZMAV_MISSION_UPLOAD.

    if nargin < 3
        kind = 'mission';
    end
    zmav_do(z, vehicle, 'mission_clear', 'kind', kind);
end
