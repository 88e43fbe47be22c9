function zmav_disarm(z, vehicle)
%ZMAV_DISARM  Disarm a vehicle that is on the ground.
%   ZMAV_DISARM(Z, VEHICLE) is refused in the air ('zmav:refused').
%
%   Example:
%       zmav_disarm(z, 'quad1');
%
%   See also ZMAV_ARM.

    zmav_do(z, vehicle, 'disarm');
end
