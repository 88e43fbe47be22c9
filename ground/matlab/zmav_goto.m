function zmav_goto(z, vehicle, varargin)
%ZMAV_GOTO  Fly to a point, and wait for the arrival.
%   ZMAV_GOTO(Z, VEHICLE, [N E D]): metres north, east and down about the fleet's origin (down: negative is up).
%   ZMAV_GOTO(Z, VEHICLE, 'lat_deg', LAT, 'lon_deg', LON, 'alt_rel', H): degrees WGS84 and metres above home; or
%   'alt_amsl' above mean sea level.
%   Options behind either: 'yaw' (radians clockwise from north), 'tolerance' (1 m), 'timeout' (300 s), 'arrive' (false:
%   return as soon as the autopilot has the target), 'speed' (m/s over the ground), 'radius' (m of a plane's circle there,
%   negative: counter-clockwise).
%
%   Example:
%       zmav_goto(z, 'quad1', [20 0 -10], 'yaw', pi / 2);
%
%   See also ZMAV_SETPOINT, ZMAV_TAKEOFF.

    varargin = cellfun(@zmav_char, varargin, 'UniformOutput', false);
    if ~isempty(varargin) && isnumeric(varargin{1})
        if numel(varargin{1}) ~= 3
            error('zmav:bad_input', 'position: expected [N E D] in metres');
        end
        varargin = [{'pos'}, varargin];
    elseif any(strcmp(varargin(1:2:end), 'lat_deg'))
        varargin = [varargin, {'frame', 'global'}];
    end
    zmav_do(z, vehicle, 'goto', varargin{:});
end
