function zmav_land(z, vehicle)
%ZMAV_LAND  Land where it is.
%   ZMAV_LAND(Z, VEHICLE) returns when the autopilot lands: wait for the ground with ZMAV_WAIT. Open to every operator,
%   no matter who holds the lease.
%
%   Example:
%       zmav_land(z, 'quad1');
%       zmav_wait(z, 'quad1', @(s) ~s.armed, 120);
%
%   See also ZMAV_RTL, ZMAV_HOLD, ZMAV_WAIT.

    zmav_do(z, vehicle, 'land');
end
