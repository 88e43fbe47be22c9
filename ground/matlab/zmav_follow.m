function track = zmav_follow(z, vehicle, target, seconds, hz)
%ZMAV_FOLLOW  Example: an outer loop that sends position commands only, as for following a pad seen by a camera.
%   TRACK = ZMAV_FOLLOW(Z, VEHICLE, TARGET, SECONDS, HZ) calls TARGET(T, STATE) HZ times a second (default 10) for
%   SECONDS seconds, and sends the vehicle where it says. TARGET returns [N E D] in metres about the fleet's origin, from
%   the seconds T since the start and the vehicle's STATE (ZMAV_GET); in its place would be the image processing. NaN
%   says that there is nothing to follow: no command is sent, and after two seconds of that the vehicle holds by itself.
%   TRACK has a row for each step: T, the command (N E D), and where the vehicle was (N E D).
%
%   The autopilot does the stabilising: only the outer loop is closed here, so that a late step does no harm.
%
%   Example:
%       circle = @(t, state) [10 * cos(t / 5), 10 * sin(t / 5), -10];
%       track = zmav_follow(z, 'quad1', circle, 30);
%       plot(track(:, 3), track(:, 2), track(:, 6), track(:, 5)); axis equal
%
%   See also ZMAV_SETPOINT, ZMAV_SQUARE.

    if nargin < 5
        hz = 10;
    end
    steps = ceil(seconds * hz);
    track = nan(steps, 7);
    closing = onCleanup(@() zmav_release(z, vehicle));
    begun = tic;
    for k = 1:steps
        t = toc(begun);
        state = zmav_get(z, vehicle);
        command = reshape(target(t, state), 1, 3);
        if all(isfinite(command))
            zmav_setpoint(z, vehicle, command);
        end
        track(k, :) = [t, command, reshape(state.local, 1, 3)];
        pause(max(0, k / hz - toc(begun)));
    end
end
