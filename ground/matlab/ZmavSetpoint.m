classdef ZmavSetpoint < ZmavBlock
%ZMAVSETPOINT  Simulink sink: a stream of position commands to a vehicle.
%   The input is a column of 5: north, east, down (m, about the fleet's origin), yaw (rad, clockwise from north), and 1
%   to command or 0 to let go. The output is 1 where the command was taken. When the model stops, the lease is given
%   back and the vehicle holds; when MATLAB hangs, the vehicle holds by itself within two seconds.
%
%   Example:
%       sink = ZmavSetpoint('Vehicle', 'quad1');
%       taken = sink([10; 0; -10; 0; 1]);
%       release(sink);
%
%   See also ZMAV_BLOCK, ZMAVTELEMETRY, ZMAVSTATE.

    methods
        function obj = ZmavSetpoint(varargin)
            setProperties(obj, nargin, varargin{:});
        end
    end

    methods (Access = protected)
        function taken = stepImpl(obj, command)
            taken = obj.run(command);
        end

        function validateInputsImpl(~, command)
            if numel(command) ~= 5
                error('zmav:bad_input', 'command: expected [north; east; down; yaw; enable]');
            end
        end

        function count = getNumInputsImpl(~)
            count = 1;
        end

        function settings = settingsOf(obj)
            settings = settingsOf@ZmavBlock(obj);
            settings.Kind = 'setpoint';
        end

        function name = getInputNamesImpl(~)
            name = 'command';
        end

        function name = getOutputNamesImpl(~)
            name = 'taken';
        end

        function icon = getIconImpl(obj)
            icon = sprintf('%s\nsetpoint', obj.Vehicle);
        end
    end
end
