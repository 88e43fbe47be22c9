function refused(identifier, words, call)
% CALL must end in an error whose identifier begins with IDENTIFIER and whose text matches WORDS.
    try
        call();
    catch problem
        if ~strncmp(problem.identifier, identifier, numel(identifier))
            error('%s instead of %s: %s', problem.identifier, identifier, problem.message);
        end
        if isempty(regexp(problem.message, words, 'once'))
            error('%s does not say %s: %s', identifier, words, problem.message);
        end
        return
    end
    error('%s was not refused', func2str(call));
end
