function zmav_sfun(block)
%ZMAV_SFUN  The Simulink blocks as one Level-2 MATLAB S-function, for releases older than R2021a.
%   In a Level-2 MATLAB S-Function block with the parameters KIND, URL, VEHICLE, MESSAGE, FIELDS, SAMPLE_TIME:
%       'telemetry', 'http://127.0.0.1:8088', 'quad1', 'ATTITUDE', {'roll', 'pitch', 'yaw'}, 0.1
%       'state',     'http://127.0.0.1:8088', 'quad1', '', {}, 0.1
%       'setpoint',  'http://127.0.0.1:8088', 'quad1', '', {}, 0.1
%   Inputs and outputs are those of ZMAV_BLOCK.
%
%   See also ZMAV_BLOCK, ZMAV_SIMULINK_LIBRARY.

    block.NumDialogPrms = 6;
    settings = settings_of(block);
    if strcmp(settings.Kind, 'setpoint')
        block.NumInputPorts = 1;
        block.InputPort(1).Dimensions = 5;
        block.InputPort(1).DatatypeID = 0;  % double
        block.InputPort(1).Complexity = 'Real';
        block.InputPort(1).SamplingMode = 'Sample';
        block.InputPort(1).DirectFeedthrough = true;
    else
        block.NumInputPorts = 0;
    end
    block.NumOutputPorts = 1;
    block.OutputPort(1).Dimensions = numel(zmav_block_names(settings));
    block.OutputPort(1).DatatypeID = 0;
    block.OutputPort(1).Complexity = 'Real';
    block.OutputPort(1).SamplingMode = 'Sample';
    block.SampleTimes = [block.DialogPrm(6).Data, 0];
    block.SimStateCompliance = 'DisallowSimState';
    block.RegBlockMethod('Start', @start);
    block.RegBlockMethod('Outputs', @outputs);
    block.RegBlockMethod('Terminate', @terminate);
end

function settings = settings_of(block)
    given = cell(1, 5);
    for k = 1:5
        given{k} = block.DialogPrm(k).Data;
    end
    settings = struct('Kind', given{1}, 'Url', given{2}, 'Vehicle', given{3}, 'Message', given{4}, ...
        'Fields', {given{5}}, 'Rate', 1 / block.DialogPrm(6).Data);
end

function start(block)
    [~, opened] = zmav_block('open', settings_of(block));
    set_param(block.BlockHandle, 'UserData', opened);
end

function outputs(block)
    input = [];
    if block.NumInputPorts > 0
        input = block.InputPort(1).Data;
    end
    [values, opened] = zmav_block('step', get_param(block.BlockHandle, 'UserData'), input);
    set_param(block.BlockHandle, 'UserData', opened);
    block.OutputPort(1).Data = values;
end

function terminate(block)
    opened = get_param(block.BlockHandle, 'UserData');
    if ~isempty(opened)
        zmav_block('close', opened);
        set_param(block.BlockHandle, 'UserData', []);
    end
end
