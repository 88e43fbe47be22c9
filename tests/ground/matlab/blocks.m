% The Simulink blocks, as far as they can be without Simulink: their functions, and their classes over a stand-in.
url = getenv('URL');
attitude = struct('Kind', 'telemetry', 'Url', url, 'Vehicle', 'quad1', 'Message', 'ATTITUDE', 'Rate', 20, ...
    'Fields', {{'time_boot_ms', 'yaw'}});
[names, block] = zmav_block('open', attitude);
assert(names, {'time_boot_ms', 'yaw', 'age'});
values = [];
begun = tic;
while (isempty(values) || isnan(values(1))) && toc(begun) < 60
    [values, block] = zmav_block('step', block, []);
    pause(0.02);
end
assert(size(values), [3 1]);
assert(values(1) > 0 && abs(values(2)) < 4 && values(3) < 60);
zmav_block('close', block);
attitude.Fields = {'rol'};
refused('zmav:bad_input', 'it has time_boot_ms, roll', @() zmav_block('open', attitude));
attitude.Message = '.*';
refused('zmav:bad_input', 'no message', @() zmav_block('open', attitude));

% A setpoint block takes the vehicle, lets it go, and does not fight who else has it.
[names, block] = zmav_block('open', struct('Kind', 'setpoint', 'Url', url, 'Vehicle', 'quad1'));
[taken, block] = zmav_block('step', block, [0; 0; -10; 0; 1]);
assert(taken, 1);
zmav_wait(block.z, 'quad1', @(s) ~isempty(s.lease), 30);
[taken, block] = zmav_block('step', block, [0; 0; NaN; 0; 1]);
assert(taken, 0);
[taken, block] = zmav_block('step', block, [0; 0; -10; 0; 0]);
assert(taken, 0);
zmav_wait(block.z, 'quad1', @(s) isempty(s.lease), 30);
other = zmav_open(url, 'As', 'other-script');
zmav_setpoint(other, 'quad1', [0 0 -10]);
warning('off', 'zmav:setpoint');
[taken, block] = zmav_block('step', block, [0; 0; -10; 0; 1]);
assert(taken == 0 && block.barred);
zmav_close(other);
zmav_wait(block.z, 'quad1', @(s) isempty(s.lease), 30);
[taken, block] = zmav_block('step', block, [0; 0; -10; 0; 1]);
assert(taken, 0);  % barred until it is let go once
[taken, block] = zmav_block('step', block, [0; 0; -10; 0; 0]);
[taken, block] = zmav_block('step', block, [0; 0; -10; 0; 1]);
assert(taken, 1);
zmav_block('close', block);
zmav_wait(block.z, 'quad1', @(s) isempty(s.lease), 30);

% The classes.
source = ZmavTelemetry('Url', url, 'Message', 'ATTITUDE', 'Fields', ' roll ,pitch, yaw');
assert(getOutputSizeImpl(source), [4 1]);
assert(size(step(source)), [4 1]);
release(source);
source = ZmavState('Url', url);
values = step(source);
assert(size(values), getOutputSizeImpl(source));
assert(values(10), 0);
assert(values(11) < 60);
release(source);
sink = ZmavSetpoint('Url', url);
assert(getNumInputsImpl(sink), 1);
refused('zmav:bad_input', 'enable', @() validateInputsImpl(sink, [1 2 3]));
assert(step(sink, [0; 0; -10; 0; 1]), 1);
release(sink);
zmav_wait(other, 'quad1', @(s) isempty(s.lease), 30);
refused('zmav:no_simulink', 'Simulink', @() zmav_simulink_library());
