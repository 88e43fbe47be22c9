% What is there, what was said, and what goes wrong, with the gateway's words.
z = zmav_open(getenv('URL'));

vehicles = zmav_vehicles(z);
assert(numel(vehicles), 1);
assert(vehicles.name, 'quad1');
assert([vehicles.sysid, vehicles.compid], [1 1]);
assert(vehicles.autopilot, 'ardupilot');
assert(vehicles.armed, false);

state = zmav_get(z, 'quad1');
assert(size(state.local), [3 1]);
assert(state.position.lat_deg, -35.363261, 1e-3);
[again, t] = zmav_get(z, vehicles);
assert(again.name, 'quad1');
assert(abs(t - time()) < 60);
answers = zmav_get(z, 'quad*/state');
assert(answers.key, 'zmav/demo/quad1/state');
assert(isempty(zmav_get(z, 'boat*/state', 0.2)));


% Text is 'characters' or, in MATLAB, a "string".
s = zmav_open(string(getenv('URL')), string('As'), string('a-script'));
assert(s.as, 'a-script');
assert(zmav_get(s, string('quad1/state')).name, 'quad1');
assert(zmav_last(s, string('quad1'), string('HEARTBEAT')).autopilot, 'MAV_AUTOPILOT_ARDUPILOTMEGA');
assert(zmav_mission_item(string('NAV_LAND'), 0, 0, 0).command, 'MAV_CMD_NAV_LAND');
refused('zmav:bad_input', 'GUIDED', @() zmav_do(s, string('quad1'), string('set_mode'), string('mode'), string('NONE')));

[fields, age] = zmav_last(z, 'quad1', 'ATTITUDE');
assert(isnumeric(fields.roll) && abs(fields.roll) < 0.2);
assert(age >= 0 && age < 30);
fields = zmav_last(z, [1 1], 'HEARTBEAT');
assert(fields.type, 'MAV_TYPE_QUADROTOR');
assert(fields.mavlink_version, 3);

% What is wrong, each by its identifier and with words that say what to do.
refused('zmav:not_found', 'present: quad1', @() zmav_get(z, 'nobody', 0.3));
refused('zmav:not_found', 'HEARTBEAT', @() zmav_last(z, 'quad1', 'NONSENSE'));
refused('zmav:not_found', 'quad1', @() zmav_last(z, [9 1], 'ATTITUDE'));
refused('zmav:bad_input', '0 to 255', @() zmav_last(z, [1 2 3], 'ATTITUDE'));
refused('zmav:bad_input', 'lower-case', @() zmav_get(z, struct('name', 'a/b')));
refused('zmav:bad_key', 'no order', @() zmav_do(z, 'quad1', 'dance'));
refused('zmav:bad_input', 'takeoff', @() zmav_do(z, 'quad1', '../keys'));
refused('zmav:bad_input', 'unknown field', @() zmav_do(z, 'quad1', 'takeoff', 'altitude', 10));
refused('zmav:bad_input', 'pairs', @() zmav_do(z, 'quad1', 'takeoff', 10));
refused('zmav:bad_input', 'NaN|float|null', @() zmav_takeoff(z, 'quad1', NaN));
refused('zmav:refused', 'disarmed', @() zmav_takeoff(z, 'quad1', 10));
refused('zmav:bad_input', 'GUIDED', @() zmav_mode(z, 'quad1', 'FLY "HIGH" & äöü'));
refused('zmav:no_such_vehicle', 'nobody', @() zmav_hold(z, 'nobody'));
refused('zmav:bad_input', 'y, z, r, buttons', @() zmav_send(z, 'quad1', 'MANUAL_CONTROL', 'x', 1));
refused('zmav:bad_input', 'metres', @() zmav_goto(z, 'quad1', [1 2]));
refused('zmav:bad_input', 'pos', @() zmav_setpoint(z, 'quad1', 'yaw', 1));
refused('zmav:bad_input', 'url', @() zmav_open('quad1'));
refused('zmav:bad_input', 'Token', @() zmav_open(getenv('URL'), 'Tokn', 'x'));
refused('zmav:unreachable', 'zmav http', @() zmav_open('http://127.0.0.1:1'));
refused('zmav:timed_out', 'disarmed|armed 0', @() zmav_wait(z, 'quad1', @(s) s.armed, 0.2));
refused('Octave:', 'nonsense', @() zmav_wait(z, 'quad1', @(s) s.nonsense, 5));
refused('zmav:timed_out', 'did not come', @() zmav_wait(z, 'quad1', @(s) s.lease.number > 0, 0.2));

% A gateway that asks for a token.
refused('zmav:token', 'token', @() zmav_open(getenv('GUARDED')));
refused('zmav:token', 'not this gateway', @() zmav_open(getenv('GUARDED'), 'Token', 'guess & try=1'));
guarded = zmav_open(getenv('GUARDED'), 'Token', getenv('TOKEN'));
assert(zmav_get(guarded, 'quad1').name, 'quad1');
zmav_close(guarded);

% Messages and orders with values of every kind.
zmav_send(z, 'quad1', 'MANUAL_CONTROL', 'x', 0, 'y', 0, 'z', 0, 'r', 0, 'buttons', 0);
zmav_send(z, [1 1], 'SET_MODE', struct('base_mode', 1, 'custom_mode', 0));
zmav_send(z, 'quad1', 'STATUSTEXT', 'severity', 'MAV_SEVERITY_INFO', 'text', 'a, "b" & c');
zmav_send(z, 'quad1', 'PLAY_TUNE', 'tune', '"quoted" [1] tune');
zmav_send(z, 'quad1', 'SET_GPS_GLOBAL_ORIGIN', 'latitude', -353632610, 'longitude', 1491652300, 'altitude', 584090);
zmav_do(z, 'quad1', 'command', 'command', 'REQUEST_MESSAGE', 'params', struct('param1', 148));
zmav_mode(z, 'quad1', 'STABILIZE');

% Parameters.
before = zmav_param_get(z, 'quad1', 'RTL_ALT');
assert(zmav_param_set(z, 'quad1', 'RTL_ALT', before + 100), before + 100);
assert(zmav_param_get(z, 'quad1', 'RTL_ALT'), before + 100);
all = zmav_param_get(z, 'quad1');
assert(all.RTL_ALT, before + 100);
assert(numel(fieldnames(all)) > 100);
zmav_param_set(z, 'quad1', 'RTL_ALT', before);
refused('zmav:', 'NO_SUCH', @() zmav_param_set(z, 'quad1', 'NO_SUCH', 1));

% A mission: degrees with all their digits, one item or several, none.
up = zmav_mission_item('NAV_TAKEOFF', 0, 0, 10);
to = zmav_mission_item('NAV_WAYPOINT', -35.3628123, 149.1652456, 12.5, 'params', 3);
zmav_mission_upload(z, 'quad1', [up, to]);
items = zmav_mission_get(z, 'quad1');
assert(size(items), [1 2]);
assert({items.command}, {'MAV_CMD_NAV_TAKEOFF', 'MAV_CMD_NAV_WAYPOINT'});
assert([items(2).x, items(2).y, items(2).z], [-35.3628123, 149.1652456, 12.5], 1e-7);
assert(items(2).params(1), 3);
zmav_mission_upload(z, 'quad1', items(2));
assert(size(zmav_mission_get(z, 'quad1')), [1 1]);
refused('zmav:', 'NO_SUCH', @() zmav_mission_upload(z, 'quad1', zmav_mission_item('NO_SUCH', 0, 0, 0)));
zmav_mission_clear(z, 'quad1');
assert(size(zmav_mission_get(z, 'quad1')), [1 0]);

zmav_close(z);
zmav_close(z);
