classdef ZmavBlock < matlab.System
%ZMAVBLOCK  What the Simulink blocks of the toolbox have in common; all they do is in ZMAV_BLOCK.
%   It needs MATLAB R2021a or newer; for older releases there is ZMAV_SFUN. Runs interpreted: nothing is compiled.
%
%   See also ZMAVTELEMETRY, ZMAVSTATE, ZMAVSETPOINT, ZMAV_SIMULINK_LIBRARY.

    properties (Nontunable)
        Url = 'http://127.0.0.1:8088'  % Gateway
        Vehicle = 'quad1'              % Vehicle
        SampleTime = 0.1               % Sample time (s)
    end

    properties (Access = private)
        Block
    end

    methods (Access = protected)
        function settings = settingsOf(obj)
            % What ZMAV_BLOCK needs to know; each block adds its kind.
            settings = struct('Kind', '', 'Url', char(obj.Url), 'Vehicle', char(obj.Vehicle));
        end

        function values = run(obj, input)
            [values, obj.Block] = zmav_block('step', obj.Block, input);
        end

        function setupImpl(obj, varargin)
            [~, obj.Block] = zmav_block('open', obj.settingsOf());
        end

        function releaseImpl(obj)
            if ~isempty(obj.Block)
                zmav_block('close', obj.Block);
                obj.Block = [];
            end
        end

        function count = getNumOutputsImpl(~)
            count = 1;
        end

        function size = getOutputSizeImpl(obj)
            size = [numel(zmav_block_names(obj.settingsOf())), 1];
        end

        function type = getOutputDataTypeImpl(~)
            type = 'double';
        end

        function yes = isOutputComplexImpl(~)
            yes = false;
        end

        function yes = isOutputFixedSizeImpl(~)
            yes = true;
        end

        function time = getSampleTimeImpl(obj)
            time = createSampleTime(obj, 'Type', 'Discrete', 'SampleTime', obj.SampleTime);
        end
    end

    methods (Static, Access = protected)
        function mode = getSimulateUsingImpl
            mode = 'Interpreted execution';
        end

        function yes = showSimulateUsingImpl
            yes = false;
        end
    end
end
