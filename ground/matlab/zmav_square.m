function path = zmav_square(url, vehicle, side, height)
%ZMAV_SQUARE  Example: take off, fly a square, land.
%   ZMAV_SQUARE() flies quad1 by the gateway at http://127.0.0.1:8088: 20 m to a side, 10 m above the fleet's origin.
%   PATH = ZMAV_SQUARE(URL, VEHICLE, SIDE, HEIGHT) returns where the vehicle was at each corner: rows of north, east
%   and down, in metres about the fleet's origin.
%
%   Each leg is one order, and the vehicle sees to it by itself: should this computer or the network fail, it arrives
%   and stays there.
%
%   Example (a simulated copter; each of the first three in a terminal of its own):
%       zmav sim --copters 1
%       zmav up --link tcp:127.0.0.1:5760 --name quad1 --origin -35.363261 149.165230 584.09
%       zmav http
%       octave --path ground/matlab --eval zmav_square
%
%   See also ZMAV_OPEN, ZMAV_GOTO, ZMAV_FOLLOW.

    if nargin < 1, url = ''; end
    if nargin < 2, vehicle = 'quad1'; end
    if nargin < 3, side = 20; end
    if nargin < 4, height = 10; end

    z = zmav_open(url);
    closing = onCleanup(@() zmav_close(z));

    zmav_arm(z, vehicle);  % ready: it knows where it is
    start = zmav_get(z, vehicle);
    corners = [0 0; side 0; side side; 0 side; 0 0];
    corners = repmat(start.local(1:2)', size(corners, 1), 1) + corners;

    zmav_takeoff(z, vehicle, height);
    path = zeros(0, 3);
    for corner = corners'
        zmav_goto(z, vehicle, [corner' -height]);
        state = zmav_get(z, vehicle);
        path(end + 1, :) = state.local'; %#ok<AGROW>
        fprintf('%s is %.1f m north, %.1f m east, %.1f m up\n', vehicle, path(end, 1), path(end, 2), -path(end, 3));
    end
    zmav_land(z, vehicle);
    zmav_wait(z, vehicle, @(s) ~s.armed, 120);
    fprintf('%s has landed\n', vehicle);
end
