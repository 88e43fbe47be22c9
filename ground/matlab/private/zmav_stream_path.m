function path = zmav_stream_path(z, what, vehicle)
%ZMAV_STREAM_PATH  /setpoint/... or /release/..., under the name that Z was opened with.
    path = ['/' what '/' vehicle];
    if ~isempty(z.as)
        path = [path '?as=' z.as];
    end
end
