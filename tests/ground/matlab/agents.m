% Orders to an agent, and its parameters, by their functions; and what the agent does not take.
z = zmav_open(getenv('URL'));

result = zmav_agent_do(z, 'quad1', 'counter', 'count', 'to', 3, 'pos', [1 2 -3], 'word', 'north');
assert(result.counted, 3);
assert(result.pos, [1; 2; -3]);
assert(result.word, 'north');
assert(zmav_agent_do(z, string('quad1'), string('counter'), string('count'), struct('to', 4)).counted, 4);
assert(isstruct(zmav_agent_do(z, 'quad1', 'counter', 'rest')));
assert(zmav_agent_do(z, 'quad1', 'counter', 'params').gain.high, 5);

[value, before] = zmav_agent_param_set(z, 'quad1', 'counter', 'gain', 2.5);
assert([value, before], [2.5, 1]);
assert(zmav_agent_param_get(z, 'quad1', 'counter', 'gain'), 2.5);
zmav_agent_param_set(z, zmav_vehicles(z), 'counter', 'roll.kp', 7.25);
[kp, about] = zmav_agent_param_get(z, 'quad1', 'counter', 'roll.kp');
assert(kp, 7.25);
assert([about.default, about.low, about.high], [6.5, 0, 20]);
params = zmav_agent_param_get(z, 'quad1', 'counter');
assert(size(params), [1 2]);
assert({params.name}, {'gain', 'roll.kp'});
assert([params.value], [2.5, 7.25]);
assert(params(1).unit, '1/s');

refused('zmav:bad_input', '0 to 5 1/s', @() zmav_agent_param_set(z, 'quad1', 'counter', 'gain', 6));
refused('zmav:bad_input', 'mass', @() zmav_agent_param_set(z, 'quad1', 'counter', 'mass', 1));
refused('zmav:bad_input', 'float', @() zmav_agent_param_set(z, 'quad1', 'counter', 'gain', NaN));
refused('zmav:not_found', 'quad1', @() zmav_agent_param_get(z, 'quad1', 'counter', 'mass'));
refused('zmav:not_found', 'nobody', @() zmav_agent_param_get(z, 'quad1', 'nobody'));
refused('zmav:bad_input', 'name', @() zmav_agent_param_get(z, 'quad1', 'counter', '*'));
refused('zmav:refused', 'upwards', @() zmav_agent_do(z, 'quad1', 'counter', 'count', 'to', -1));
refused('zmav:bad_input', 'count, params, rest, set', @() zmav_agent_do(z, 'quad1', 'counter', 'sing'));
refused('zmav:bad_input', 'engage', @() zmav_agent_do(z, 'quad1', 'counter', '../do'));
refused('zmav:bad_input', 'ev1', @() zmav_agent_do(z, 'quad1', 'A/b', 'count'));
refused('zmav:no_such_vehicle', 'quad9', @() zmav_agent_do(z, 'quad9', 'counter', 'count', 'to', 1));
assert(zmav_agent_param_get(z, 'quad1', 'counter', 'gain'), 2.5);
zmav_close(z);
