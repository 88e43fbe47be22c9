classdef System < handle
% What the toolbox uses of MATLAB's matlab.System, which Octave lacks: enough to run the classes' own methods.

    properties (Access = private)
        IsReady = false
    end

    methods
        function setProperties(obj, count, varargin)
            for k = 1:2:count
                obj.(varargin{k}) = varargin{k + 1};
            end
        end

        function values = step(obj, varargin)
            if ~obj.IsReady
                obj.setupImpl(varargin{:});
                obj.IsReady = true;
            end
            values = obj.stepImpl(varargin{:});
        end

        function release(obj)
            obj.releaseImpl();
            obj.IsReady = false;
        end
    end
end
