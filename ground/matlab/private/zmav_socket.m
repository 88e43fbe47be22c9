function varargout = zmav_socket(what, kind, socket, timeout)
%ZMAV_SOCKET  A UDP socket by Java or by udpport.
%   [SOCKET, PORT] = ZMAV_SOCKET('open', KIND); ZMAV_SOCKET('close', KIND, SOCKET);
%   DATAGRAMS = ZMAV_SOCKET('receive', KIND, SOCKET, S): a cell row of uint8 rows, within S seconds for the first.
    if ~any(strcmp(kind, {'java', 'udpport'}))
        error('zmav:bad_input', 'Transport: expected java, udpport or poll');
    end
    switch [what ' ' kind]
        case 'open java'
            socket = javaObject('java.net.DatagramSocket', 0);
            socket.setReceiveBufferSize(1048576);
            varargout = {socket, double(socket.getLocalPort())};
        case 'open udpport'
            socket = udpport('datagram', 'IPV4');
            varargout = {socket, double(socket.LocalPort)};
        case 'close java'
            socket.close();
        case 'close udpport'
            delete(socket);
        case 'receive java'
            varargout = {by_java(socket, timeout)};
        case 'receive udpport'
            varargout = {by_udpport(socket, timeout)};
    end
end

function datagrams = by_java(socket, timeout)
    most = 1000;
    size = 2048;
    datagrams = {};
    packet = javaObject('java.net.DatagramPacket', zeros(1, size, 'int8'), size);
    wait = max(1, round(1000 * timeout));
    while numel(datagrams) < most
        socket.setSoTimeout(wait);
        packet.setLength(size);
        try
            socket.receive(packet);
        catch problem
            if isempty(strfind(problem.message, 'SocketTimeoutException')) %#ok<STREMP>
                rethrow(problem);
            end
            return
        end
        data = packet.getData();
        datagrams{end + 1} = typecast(reshape(data(1:packet.getLength()), 1, []), 'uint8'); %#ok<AGROW>
        wait = 1;  % ms: only what is there already; 0 would be for ever
    end
end

function datagrams = by_udpport(socket, timeout)
    begun = tic;
    while socket.NumDatagramsAvailable == 0 && toc(begun) < timeout
        pause(0.005);
    end
    datagrams = {};
    if socket.NumDatagramsAvailable > 0
        found = read(socket, socket.NumDatagramsAvailable, 'uint8');
        datagrams = arrayfun(@(each) uint8(reshape(each.Data, 1, [])), found, 'UniformOutput', false);
        datagrams = reshape(datagrams, 1, []);
    end
end
