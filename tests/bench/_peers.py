"""The programs that the adapter's benchmark compares, each a process: they run until killed.

_peers.py pymavlink IN OUT        receive a message with pymavlink, send its bytes on
_peers.py bare-in IN ENDPOINT     UDP to one Zenoh key, nothing checked: the least a Zenoh hop can cost from Python
_peers.py bare-out ENDPOINT OUT   that key to UDP
_peers.py ground ENDPOINT OUT     every frame under mav/rx to UDP, as a ground station's bridge would
"""

from __future__ import annotations

import socket
import sys
import threading

import zenoh

from zmav.session import SessionSettings, open_session


def _sender(port: str) -> socket.socket:
    out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    out.connect(("127.0.0.1", int(port)))
    return out


def pymavlink(port_in: str, port_out: str) -> None:
    from pymavlink import mavutil

    source = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port_in}", dialect="ardupilotmega")
    source.port.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 8 << 20)
    out = _sender(port_out)
    while True:
        message = source.recv_match(blocking=True)
        if message is not None and message.get_type() != "BAD_DATA":
            out.send(message.get_msgbuf())


def bare_in(port_in: str, endpoint: str) -> None:
    source = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    source.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 8 << 20)
    source.bind(("127.0.0.1", int(port_in)))
    with open_session(SessionSettings(mode="peer", listen=[endpoint])) as session:
        publisher = session.declare_publisher("bench/raw", congestion_control=zenoh.CongestionControl.DROP)
        while True:
            publisher.put(source.recv(2048))


def bare_out(endpoint: str, port_out: str) -> None:
    _pump(endpoint, "bench/raw", port_out)


def ground(endpoint: str, port_out: str) -> None:
    _pump(endpoint, "zmav/*/*/mav/rx/**", port_out)


def _pump(endpoint: str, key: str, port_out: str) -> None:
    send = _sender(port_out).send
    with open_session(SessionSettings(connect=[endpoint])) as session:
        session.declare_subscriber(key, lambda sample: send(sample.payload.to_bytes()))
        threading.Event().wait()


if __name__ == "__main__":
    {"pymavlink": pymavlink, "bare-in": bare_in, "bare-out": bare_out, "ground": ground}[sys.argv[1]](*sys.argv[2:])
