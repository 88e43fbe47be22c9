function value = zmav_char(value)
%ZMAV_CHAR  A string of MATLAB's ("quad1") as the characters ('quad1') that the toolbox knows; anything else as it is.
    if isa(value, 'string') && isscalar(value)
        value = char(value);
    end
end
