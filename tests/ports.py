"""Ports of this computer that nobody uses now."""

from __future__ import annotations

import contextlib
import socket

from zmav.process import free_port


def free_udp_ports(count: int) -> int:
    """The first of ``count`` neighbouring UDP ports nobody uses now on loopback."""
    while True:
        first = free_port(socket.SOCK_DGRAM)
        with contextlib.ExitStack() as held, contextlib.suppress(OSError, OverflowError):
            for port in range(first, first + count):
                held.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)).bind(("127.0.0.1", port))
            return first
