function zmav_arm(z, vehicle, ready_timeout)
%ZMAV_ARM  Wait until a vehicle is ready, and arm it.
%   ZMAV_ARM(Z, VEHICLE) waits for 60 s at most; ZMAV_ARM(Z, VEHICLE, S) for S seconds, 0: try at once. 'zmav:refused'
%   and 'zmav:timed_out' say what is missing, in the autopilot's words.
%
%   Example:
%       zmav_arm(z, 'quad1');
%
%   See also ZMAV_TAKEOFF, ZMAV_DISARM.

    if nargin < 3
        zmav_do(z, vehicle, 'arm');
    else
        zmav_do(z, vehicle, 'arm', 'ready_timeout', ready_timeout);
    end
end
