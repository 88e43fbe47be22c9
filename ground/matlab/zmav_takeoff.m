function zmav_takeoff(z, vehicle, height)
%ZMAV_TAKEOFF  Climb to a height in metres above home, and wait until it is reached.
%   ZMAV_TAKEOFF(Z, VEHICLE, HEIGHT); the vehicle must be armed.
%
%   Example:
%       zmav_arm(z, 'quad1');
%       zmav_takeoff(z, 'quad1', 10);
%
%   See also ZMAV_GOTO, ZMAV_LAND.

    zmav_do(z, vehicle, 'takeoff', 'alt_rel', height);
end
