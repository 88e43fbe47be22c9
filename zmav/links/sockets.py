"""Socket options and error texts that UDP and TCP share."""

from __future__ import annotations

import errno
import ipaddress
import socket
import struct
import sys
from typing import Any

from zmav.errors import LinkDown, LinkError, PortInUse

READ_WAKE_S = 0.25  # a blocked read returns after so long, to look whether the link is being closed
RECEIVE_BUFFER = 4 * 1024 * 1024  # the usual 212,992 bytes hold only about 277 small datagrams
MAX_READ = 65535

# Linux: lets a privileged process pass net.core.rmem_max (asm-generic/socket.h; Python has no name for it).
SO_RCVBUFFORCE = 33
# A send that never blocks, on a socket whose reads do.
DONTWAIT: int = socket.MSG_DONTWAIT

Address = tuple[Any, ...]  # (host, port) or (host, port, flow, scope), as the socket module gives it


def set_read_wake(sock: socket.socket) -> None:
    """Let blocking reads end with BlockingIOError after :data:`READ_WAKE_S`.

    Set in the kernel, because Python's own ``settimeout`` puts a poll before every read: one more system call each.
    """
    # 66 is SO_RCVTIMEO_NEW: a 32-bit machine with 64-bit time.
    layout = "@qq" if socket.SO_RCVTIMEO == 66 else "@ll"
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack(layout, 0, int(READ_WAKE_S * 1e6)))


def grow_receive_buffer(sock: socket.socket) -> int:
    """Ask for :data:`RECEIVE_BUFFER` bytes; what the kernel then reports (Linux: twice what it granted)."""
    try:
        if sys.platform != "linux":
            raise PermissionError
        sock.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, RECEIVE_BUFFER)
    except OSError:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
    return sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)


def resolve(host: str, port: int, kind: socket.SocketKind) -> list[tuple[int, Address]]:
    """(family, address) of each meaning of ``host``, IPv4 first; raises LinkDown when the name is not known (yet).

    IPv4 first, because autopilots and simulators speak nothing else: ``localhost`` must not listen on ::1 alone.
    """
    try:
        found = socket.getaddrinfo(host, port, type=kind)
    except (OSError, UnicodeError) as error:
        raise LinkDown(f"cannot resolve {host!r}: {getattr(error, 'strerror', None) or error}", host=host) from error
    found.sort(key=lambda one: one[0] != socket.AF_INET)
    return [(family, address) for family, _, _, _, address in found]


def show(address: Address) -> str:
    """``127.0.0.1:14550`` or ``[::1]:14550``."""
    host, port = address[0], address[1]
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def is_loopback(host: str) -> bool:
    """Whether an address is this computer's own; a name is none."""
    try:
        address = ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        return False
    mapped = address.ipv4_mapped if isinstance(address, ipaddress.IPv6Address) else None
    return (mapped or address).is_loopback


def bind_error(error: OSError, address: Address, scheme: str) -> LinkError:
    """The error of a failed bind, saying which port and what to do about it."""
    where = show(address)
    if error.errno == errno.EADDRINUSE:
        return PortInUse(
            f"port {address[1]} on {address[0]} is held by another program: stop it, or use another port", address=where
        )
    if error.errno == errno.EADDRNOTAVAIL:
        out = {"udpin": "udpout", "tcpin": "tcp"}.get(scheme, scheme)
        return LinkDown(
            f"{address[0]} is not an address of this machine, so nothing can listen there;"
            f" to reach a vehicle at that address use {out}:{where}",
            address=where,
        )
    if error.errno == errno.EACCES:
        return LinkDown(f"not permitted to use port {address[1]}: ports below 1024 need privileges", address=where)
    return LinkDown(f"cannot bind {where}: {error.strerror or error}", address=where)
