% Says jvm where Octave has Java.
try
    javaMethod('currentTimeMillis', 'java.lang.System');
    disp('jvm');
catch problem
    disp('none');
end
