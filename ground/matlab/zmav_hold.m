function zmav_hold(z, vehicle)
%ZMAV_HOLD  Stop where it is, and stay.
%   ZMAV_HOLD(Z, VEHICLE) is open to every operator, and ends a stream of setpoints and the lease behind it.
%
%   Example:
%       zmav_hold(z, 'quad1');
%
%   See also ZMAV_LAND, ZMAV_RELEASE.

    zmav_do(z, vehicle, 'hold');
end
