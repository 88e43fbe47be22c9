function zmav_rtl(z, vehicle)
%ZMAV_RTL  Return to launch.
%   ZMAV_RTL(Z, VEHICLE) is open to every operator, no matter who holds the lease.
%
%   Example:
%       zmav_rtl(z, 'quad1');
%
%   See also ZMAV_LAND, ZMAV_HOLD.

    zmav_do(z, vehicle, 'rtl');
end
