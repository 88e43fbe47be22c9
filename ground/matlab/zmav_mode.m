function zmav_mode(z, vehicle, mode)
%ZMAV_MODE  Enter a flight mode by the autopilot's own name for it.
%   ZMAV_MODE(Z, VEHICLE, MODE). 'zmav:bad_input' lists the modes there are.
%
%   Example:
%       zmav_mode(z, 'quad1', 'GUIDED');
%
%   See also ZMAV_HOLD, ZMAV_DO.

    zmav_do(z, vehicle, 'set_mode', 'mode', mode);
end
