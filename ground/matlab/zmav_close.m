function zmav_close(z)
%ZMAV_CLOSE  Give back what was taken through Z: leases, UDP streams and their sockets.
%   ZMAV_CLOSE(Z) may be called at any time, and twice. A vehicle whose lease it gives back holds its position.
%
%   Example:
%       z = zmav_open();
%       stop = onCleanup(@() zmav_close(z));     % also when a script ends in an error
%
%   See also ZMAV_OPEN, ZMAV_RELEASE, ZMAV_STOP.

    for name = keys(z.held)
        what = z.held(name{1});
        try
            if strcmp(what.kind, 'lease')
                zmav_release(z, what.vehicle);
            else
                zmav_stop(z, what.stream);
            end
        catch problem
            warning('zmav:close', '%s', problem.message);
            if isKey(z.held, name{1})
                remove(z.held, name{1});
            end
        end
    end
end
