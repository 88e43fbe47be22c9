"""Links: byte transports to autopilots. One transport a file; each reopens by itself, for ever, and reports its state.

``open_link(url)`` makes any of them; what may be written is in :mod:`zmav.links.url`.
"""

from __future__ import annotations

from zmav.links.base import Link, LinkCounters, LinkState
from zmav.links.replay import ReplayLink
from zmav.links.serial import SerialLink
from zmav.links.tcp import TcpLink
from zmav.links.udp import UdpInLink, UdpOutLink
from zmav.links.url import LinkUrl, ReplayUrl, SerialUrl, SocketUrl, parse_url

__all__ = [
    "Link",
    "LinkCounters",
    "LinkState",
    "LinkUrl",
    "ReplayLink",
    "ReplayUrl",
    "SerialLink",
    "SerialUrl",
    "SocketUrl",
    "TcpLink",
    "UdpInLink",
    "UdpOutLink",
    "open_link",
    "parse_url",
]

_SOCKET_LINKS: dict[str, type[UdpInLink] | type[UdpOutLink] | type[TcpLink]] = {
    "udpin": UdpInLink,
    "udpout": UdpOutLink,
    "tcp": TcpLink,
}


def open_link(url: str) -> Link:
    """The link of a URL, not started yet; its ``url`` is the canonical form.

    ======================================  ==========================================================================
    ``serial:/dev/ttyUSB0:57600``           also ``/dev/ttyUSB0,57600``, ``/dev/ttyACM0``, ``?baud=57600``,
                                            ``?rtscts=1``; without a baud rate it is found by listening
    ``udpin:HOST:PORT``                     listen, answer whom was heard; also ``udp:HOST:PORT`` and ``HOST:PORT``
    ``udpout:HOST:PORT``                    speak first; ``?local=PORT`` sends from that port; also ``udp://HOST:PORT``
    ``tcp:HOST:PORT``                       connect; also ``tcpout:``
    ``replay:FILE.tlog``                    ``?speed=4``, ``?speed=max``; also a bare path to a .tlog
    ======================================  ==========================================================================

    **An empty HOST means loopback**, also where a link listens: write ``0.0.0.0`` (or ``[::]``) to be reached from
    other machines. IPv6 addresses stand in brackets. ``//`` after the colon is accepted (MAVSDK).

    Raises BadUrl, whose detail has ``field``, ``value``, ``expected`` and perhaps ``hint``; also for a recording that
    does not exist. A device or peer that is not there yet is no error: the link waits for it.
    """
    target = parse_url(url)
    if isinstance(target, SerialUrl):
        return SerialLink(target)
    if isinstance(target, ReplayUrl):
        return ReplayLink(target)
    return _SOCKET_LINKS[target.scheme](target)
