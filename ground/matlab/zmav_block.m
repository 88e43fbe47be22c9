function [values, block] = zmav_block(what, varargin)
%ZMAV_BLOCK  What the Simulink blocks do, in plain functions: the System objects and the S-function only call it.
%   [NAMES, BLOCK] = ZMAV_BLOCK('open', SETTINGS) begins. SETTINGS is a structure with the fields Kind ('telemetry',
%   'state' or 'setpoint'), Url, Vehicle, and for telemetry Message, Fields (a cell row of names) and Rate (Hz). NAMES are
%   those of the values that a step returns.
%   [VALUES, BLOCK] = ZMAV_BLOCK('step', BLOCK, INPUT) does one step; VALUES is a column of doubles.
%   ZMAV_BLOCK('close', BLOCK) gives back what was taken.
%
%   telemetry: the fields of the last message that came, in MAVLink's own units, then its age in seconds; NaN and Inf
%   before the first. By UDP where there is some (see ZMAV_STREAM).
%   state: north, east, down (m, about the fleet's origin), velocity (m/s, north, east, down), roll, pitch, yaw (rad),
%   armed (0 or 1), age (s). A step that gets no answer keeps the last values, and the age grows.
%   setpoint: INPUT is [N E D YAW ENABLE]: metres, radians and 0 or 1. While ENABLE is 1 each step sends a command; the
%   value is 1 where it was taken, 0 where it was not, and then no more is sent until ENABLE has been 0: what has taken
%   the vehicle, say its pilot, is not fought.
%
%   Example:
%       settings = struct('Kind', 'state', 'Url', '', 'Vehicle', 'quad1');
%       [names, block] = zmav_block('open', settings);
%       [values, block] = zmav_block('step', block, []);
%       zmav_block('close', block);
%
%   See also ZMAV_SIMULINK_LIBRARY, ZMAV_SFUN.

    switch what
        case 'open'
            [values, block] = open_block(varargin{1});
        case 'step'
            block = varargin{1};
            [values, block] = step_block(block, varargin{2});
        case 'close'
            block = varargin{1};
            values = [];
            zmav_close(block.z);
        otherwise
            error('zmav:bad_input', 'what: expected open, step or close');
    end
end

function [names, block] = open_block(settings)
    names = zmav_block_names(settings);
    block = struct('settings', settings, 'z', zmav_open(settings.Url), 'values', nan(numel(names), 1), ...
        'came', [], 'stream', [], 'barred', false);
    if strcmp(settings.Kind, 'telemetry')
        try
            block.stream = zmav_stream(block.z, settings.Vehicle, 'Messages', {settings.Message}, 'Hz', settings.Rate);
        catch problem
            zmav_close(block.z);
            rethrow(problem);
        end
    end
    if ~strcmp(settings.Kind, 'setpoint')
        block.values(end) = Inf;
    end
end

function [values, block] = step_block(block, input)
    switch block.settings.Kind
        case 'telemetry'
            block = telemetry(block);
        case 'state'
            block = state(block);
        case 'setpoint'
            block = setpoint(block, input);
    end
    if ~isempty(block.came)
        block.values(end) = toc(block.came);
    end
    values = block.values;
end

function block = telemetry(block)
    messages = zmav_read(block.stream, 0);
    if isempty(messages)
        return
    end
    fields = messages(end).fields;
    for k = 1:numel(block.settings.Fields)
        value = fields.(block.settings.Fields{k});
        block.values(k) = double(value(1));
    end
    block.came = tic;
end

function block = state(block)
    try
        s = zmav_get(block.z, block.settings.Vehicle, 0.5);
    catch problem
        if any(strcmp(problem.identifier, {'zmav:not_found', 'zmav:timed_out', 'zmav:unreachable'}))
            return
        end
        rethrow(problem);
    end
    block.values(1:6) = [three(s.local); three(s.velocity)];
    if isstruct(s.attitude)
        block.values(7:9) = [s.attitude.roll; s.attitude.pitch; s.attitude.yaw];
    end
    block.values(10) = double(isequal(s.armed, true));
    block.came = tic;
end

function column = three(value)
    column = nan(3, 1);
    if numel(value) == 3
        column = double(value(:));
    end
end

function block = setpoint(block, input)
    block.values = 0;
    if input(5) < 0.5
        if ~block.barred && isKey(block.z.held, ['lease ' block.settings.Vehicle])
            zmav_release(block.z, block.settings.Vehicle);
        end
        block.barred = false;
        return
    end
    if block.barred || any(~isfinite(input(1:4)))
        return
    end
    try
        zmav_setpoint(block.z, block.settings.Vehicle, reshape(input(1:3), 1, 3), input(4));
        block.values = 1;
    catch problem
        block.barred = true;
        warning('zmav:setpoint', '%s: %s', block.settings.Vehicle, problem.message);
    end
end
