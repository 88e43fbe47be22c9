function file = zmav_simulink_library(folder)
%ZMAV_SIMULINK_LIBRARY  Make the Simulink block library zmav_blocks.slx: telemetry, state and setpoint.
%   FILE = ZMAV_SIMULINK_LIBRARY() makes it in the current folder, ZMAV_SIMULINK_LIBRARY(FOLDER) in another. The blocks
%   are MATLAB System blocks over the classes of this folder, which must stay on the path; older releases than R2021a
%   get Level-2 S-functions in their place.
%
%   A vehicle flies in real time: in a model that uses the blocks, switch simulation pacing on, and take a fixed step.
%
%   Example:
%       zmav_simulink_library();
%       open_system('zmav_blocks');
%
%   See also ZMAVTELEMETRY, ZMAVSTATE, ZMAVSETPOINT, ZMAV_SFUN.

    if nargin < 1
        folder = pwd;
    end
    if exist('OCTAVE_VERSION', 'builtin') || isempty(which('new_system'))
        error('zmav:no_simulink', 'Simulink is not installed here');
    end
    name = 'zmav_blocks';
    if bdIsLoaded(name)
        close_system(name, 0);
    end
    new_system(name, 'Library');
    fields = '{''roll'', ''pitch'', ''yaw''}';
    blocks = { ...
        'Telemetry', 'ZmavTelemetry', ['''telemetry'', ''http://127.0.0.1:8088'', ''quad1'', ''ATTITUDE'', ' fields]; ...
        'State', 'ZmavState', '''state'', ''http://127.0.0.1:8088'', ''quad1'', '''', {}'; ...
        'Setpoint', 'ZmavSetpoint', '''setpoint'', ''http://127.0.0.1:8088'', ''quad1'', '''', {}'};
    for k = 1:size(blocks, 1)
        path = [name '/' blocks{k, 1}];
        place = [40, 40 + 110 * (k - 1), 200, 110 + 110 * (k - 1)];
        if verLessThan('simulink', '10.3') %#ok<VERLESSMATLAB>
            add_block('simulink/User-Defined Functions/Level-2 MATLAB S-Function', path, 'Position', place, ...
                'FunctionName', 'zmav_sfun', 'Parameters', [blocks{k, 3} ', 0.1']);
        else
            add_block('simulink/User-Defined Functions/MATLAB System', path, 'Position', place, ...
                'System', blocks{k, 2});
        end
    end
    file = fullfile(folder, [name '.slx']);
    save_system(name, file);
end
