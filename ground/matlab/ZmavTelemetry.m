classdef ZmavTelemetry < ZmavBlock
%ZMAVTELEMETRY  Simulink source: fields of a vehicle's MAVLink message, by UDP.
%   The output is a column: the fields named in Fields, in MAVLink's own units, then the age of the message in seconds
%   (NaN and Inf before the first). Use it in a MATLAB System block, or see ZMAV_SIMULINK_LIBRARY.
%
%   Example:
%       source = ZmavTelemetry('Vehicle', 'quad1', 'Message', 'ATTITUDE', 'Fields', 'roll, pitch, yaw');
%       values = source();
%       release(source);
%
%   See also ZMAV_BLOCK, ZMAVSTATE, ZMAVSETPOINT.

    properties (Nontunable)
        Message = 'ATTITUDE'          % Message
        Fields = 'roll, pitch, yaw'   % Fields, with commas between
        Rate = 20                     % Most messages a second
    end

    methods
        function obj = ZmavTelemetry(varargin)
            setProperties(obj, nargin, varargin{:});
        end
    end

    methods (Access = protected)
        function values = stepImpl(obj)
            values = obj.run([]);
        end

        function count = getNumInputsImpl(~)
            count = 0;
        end

        function settings = settingsOf(obj)
            settings = settingsOf@ZmavBlock(obj);
            settings.Kind = 'telemetry';
            settings.Message = char(obj.Message);
            settings.Fields = regexp(strtrim(char(obj.Fields)), '\s*,\s*', 'split');
            settings.Rate = obj.Rate;
        end

        function name = getOutputNamesImpl(~)
            name = 'values';
        end

        function icon = getIconImpl(obj)
            icon = sprintf('%s\n%s', obj.Vehicle, obj.Message);
        end
    end
end
