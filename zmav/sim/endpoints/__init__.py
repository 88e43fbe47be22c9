"""Where simulated vehicles are reached: one kind of endpoint a file. How they are written is in
:mod:`zmav.sim.endpoints.address`.
"""

from __future__ import annotations

import errno
from collections.abc import Callable

from zmav.errors import BadUrl, PortInUse
from zmav.sim.endpoints.address import EXPECTED, Address, addresses, expand, parse_endpoint
from zmav.sim.endpoints.base import Endpoint, Switchboard, Wiring
from zmav.sim.endpoints.serial import PtyEndpoint
from zmav.sim.endpoints.tcp import TcpServer
from zmav.sim.endpoints.udp import LatchingUdp, UdpListener, UdpSender

__all__ = ["Address", "Endpoint", "Switchboard", "Wiring", "addresses", "expand", "open_endpoint", "parse_endpoint"]

_KINDS: dict[str, Callable[[Address, Switchboard, Wiring], Endpoint]] = {
    "tcp": TcpServer,
    "serial0": TcpServer,
    "serial1": TcpServer,
    "serial2": TcpServer,
    "udp": UdpSender,
    "udp-listen": UdpListener,
    "onboard": LatchingUdp,
    "ground": LatchingUdp,
    "pty": PtyEndpoint,
}


def open_endpoint(address: Address, vehicle: Switchboard, wiring: Wiring) -> Endpoint:
    """Open it and have the world serve it.

    Raises :class:`PortInUse` where another program listens there, :class:`BadUrl` where there is no such address.
    """
    try:
        return _KINDS[address.kind](address, vehicle, wiring)
    except (OSError, UnicodeError) as error:  # the latter for a host's name that cannot be one
        where = str(address)
        number = error.errno if isinstance(error, OSError) else None
        if number == errno.EADDRINUSE:
            raise PortInUse(f"{where} is in use by another program", port=address.local or address.port) from error
        if number in (errno.EMFILE, errno.ENFILE):
            text = f"{where}: too many open files; allow more with 'ulimit -n', or name fewer endpoints"
            raise BadUrl(text, field="endpoint", value=where, expected="fewer endpoints") from error
        raise BadUrl(f"{where}: {error}", field="endpoint", value=where, expected=EXPECTED) from error
