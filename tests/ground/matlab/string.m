classdef string
% What the toolbox uses of MATLAB's "strings", which Octave lacks.

    properties (Access = private)
        Text
    end

    methods
        function obj = string(text)
            obj.Text = text;
        end

        function text = char(obj)
            text = obj.Text;
        end
    end
end
