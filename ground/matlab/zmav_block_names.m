function names = zmav_block_names(settings)
%ZMAV_BLOCK_NAMES  Names of the values that a Simulink block gives, in their order: see ZMAV_BLOCK.
%   NAMES = ZMAV_BLOCK_NAMES(SETTINGS) is a cell row; it asks nobody, so that a model can be drawn without a gateway.
%
%   Example:
%       names = zmav_block_names(struct('Kind', 'telemetry', 'Message', 'ATTITUDE', 'Fields', {{'roll', 'pitch'}}));
%
%   See also ZMAV_BLOCK.

    switch settings.Kind
        case 'telemetry'
            fields = settings.Fields;
            if ~iscellstr(fields) || isempty(fields)
                error('zmav:bad_input', 'Fields: expected names of fields, like {''roll'', ''pitch''}');
            end
            known = zmav_message_fields(settings.Message);
            for k = 1:numel(fields)
                if ~any(strcmp(fields{k}, known))
                    error('zmav:bad_input', '%s has no field %s; it has %s', settings.Message, fields{k}, ...
                        strjoin(known, ', '));
                end
            end
            names = [reshape(fields, 1, []), {'age'}];
        case 'state'
            names = {'north', 'east', 'down', 'v_north', 'v_east', 'v_down', 'roll', 'pitch', 'yaw', 'armed', 'age'};
        case 'setpoint'
            names = {'taken'};
        otherwise
            error('zmav:bad_input', 'Kind: expected telemetry, state or setpoint');
    end
end
