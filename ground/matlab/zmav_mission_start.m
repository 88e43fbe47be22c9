function zmav_mission_start(z, vehicle, first)
%ZMAV_MISSION_START  Fly the mission, from its beginning or from item FIRST on (0 is the first).
%   ZMAV_MISSION_START(Z, VEHICLE) and ZMAV_MISSION_START(Z, VEHICLE, FIRST)
%
%   Example:
%       zmav_mission_start(z, 'quad1');
%
%   See also ZMAV_MISSION_UPLOAD.

    if nargin < 3
        zmav_do(z, vehicle, 'mission_start');
    else
        zmav_do(z, vehicle, 'mission_start', 'first', first);
    end
end
