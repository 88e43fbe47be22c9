% The square of the examples, then the outer loop, and who may fly meanwhile.
url = getenv('URL');
path = zmav_square(url, 'quad1', 10, 6);
assert(size(path), [5 3]);
assert(path, [0 0 -6; 10 0 -6; 10 10 -6; 0 10 -6; 0 0 -6], 1.5);

z = zmav_open(url);
zmav_arm(z, 'quad1', 30);
zmav_takeoff(z, 'quad1', 6);

% Eastward by commands at 10 Hz; in the middle the camera sees nothing.
eastward = @(t, state) [0, 5 + 5 * t, -6] + 0 ./ (t < 0.8 | t > 1.2);
track = zmav_follow(z, 'quad1', eastward, 2, 10);
assert(size(track), [20 7]);
commanded = all(isfinite(track(:, 2:4)), 2);
assert(any(commanded) && ~all(commanded));
assert(track(end, 6) > 2, sprintf('it went %g m east only', track(end, 6)));
assert(isempty(keys(z.held)));

% One at a time: another script is told who flies.
said = zmav_setpoint(z, 'quad1', [0 0 -6], 0);
assert(zmav_get(z, 'quad1').lease.holder, said.holder);
other = zmav_open(url, 'As', 'other-script');
refused('zmav:not_holder', 'http', @() zmav_setpoint(other, 'quad1', [5 5 -6]));
refused('zmav:not_holder', 'http', @() zmav_goto(other, 'quad1', [5 5 -6]));
zmav_close(z);  % gives the lease back
zmav_wait(z, 'quad1', @(s) isempty(s.lease), 30);
assert(zmav_setpoint(other, 'quad1', 'vel', [0 1 0]).holder, 'other-script');

% An order of the holder's own ends its stream; so does hold, by anybody.
zmav_goto(other, 'quad1', 'lat_deg', -35.36320, 'lon_deg', 149.16530, 'alt_rel', 8, 'timeout', 60);
assert(zmav_get(other, 'quad1').position.alt_rel, 8, 1.5);
assert(isempty(keys(other.held)));
zmav_hold(z, 'quad1');
zmav_rtl(z, 'quad1');
assert(zmav_wait(z, 'quad1', @(s) strcmp(s.mode, 'RTL'), 30).mode, 'RTL');
zmav_land(z, 'quad1');
zmav_wait(z, 'quad1', @(s) ~s.armed, 60);
zmav_disarm(z, 'quad1');
zmav_close(other);
