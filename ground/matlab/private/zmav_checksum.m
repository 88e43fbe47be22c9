function value = zmav_checksum(bytes)
%ZMAV_CHECKSUM  CRC-16/MCRF4XX of bytes, as MAVLink has it (X.25 without the final inversion).
    persistent table
    if isempty(table)
        table = zeros(1, 256);
        for k = 0:255
            c = k;
            for bit = 1:8
                if mod(c, 2)
                    c = bitxor(floor(c / 2), 33800);  % 0x8408
                else
                    c = floor(c / 2);
                end
            end
            table(k + 1) = c;
        end
    end
    value = 65535;
    for each = double(bytes)
        value = bitxor(floor(value / 256), table(bitxor(mod(value, 256), each) + 1));
    end
end
