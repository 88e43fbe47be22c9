classdef ZmavState < ZmavBlock
%ZMAVSTATE  Simulink source: what a vehicle says of itself.
%   The output is a column of 11: north, east, down (m, about the fleet's origin), velocity (m/s, north, east, down),
%   roll, pitch, yaw (rad), armed (0 or 1) and the age of all this in seconds. NaN: not known.
%
%   Example:
%       source = ZmavState('Vehicle', 'quad1');
%       values = source();
%       release(source);
%
%   See also ZMAV_BLOCK, ZMAVTELEMETRY, ZMAVSETPOINT.

    methods
        function obj = ZmavState(varargin)
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
            settings.Kind = 'state';
        end

        function name = getOutputNamesImpl(~)
            name = 'state';
        end

        function icon = getIconImpl(obj)
            icon = sprintf('%s\nstate', obj.Vehicle);
        end
    end
end
