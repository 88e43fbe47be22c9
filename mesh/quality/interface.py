"""By which network interface a neighbour is reached, and how loud it is heard where that is a radio."""

from __future__ import annotations

import contextlib
import re
import socket
from collections.abc import Sequence
from pathlib import Path

import ifaddr

from mesh.quality.nl80211 import station_signal

PROC = Path("/proc/net")
LEAST_DBM, MOST_DBM = -120, 0
"""what a signal can be; some drivers give a share of something instead"""


def signal(interface: str, address: str, proc: Path = PROC) -> float | None:
    """dBm of the neighbour at ``address`` on our radio; None where the kernel does not say, as on a wire.

    First the station's own level by its MAC (access point, ad-hoc and mesh modes); else that of the access point we are
    with, by which a neighbour behind it is heard, too.
    """
    levels = _wireless(proc)
    mac = _mac(address, interface, proc)
    heard = station_signal(interface, mac) if mac else None
    return heard if heard is not None else levels.get(interface)


def _mac(address: str, interface: str, proc: Path) -> bytes | None:
    """From the kernel's table of neighbours: IP, type, flags, MAC, mask, interface."""
    for line in _lines(proc / "arp")[1:]:
        fields = line.split()
        if len(fields) == 6 and fields[0] == address and fields[5] == interface:
            found = re.fullmatch(r"([0-9a-f]{2}:){5}[0-9a-f]{2}", fields[3].lower())
            mac = bytes.fromhex(fields[3].replace(":", "")) if found else b""
            return mac if any(mac) else None
    return None


def _wireless(proc: Path) -> dict[str, float]:
    """Levels of what each radio is associated with: ``name: status``, then link quality, level and noise."""
    found = {}
    for line in _lines(proc / "wireless"):
        name, colon, rest = line.partition(":")
        try:
            level = float(rest.split()[2]) if colon else 0.0
        except (IndexError, ValueError):
            continue
        if LEAST_DBM <= level < MOST_DBM:
            found[name.strip()] = level
    return found


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text("utf-8", "replace").splitlines()
    except OSError:
        return []


def address_of(locator: str) -> str | None:
    """The IP address in a Zenoh locator ``udp/10.77.0.2:7447?rel=1``; None: it holds none."""
    found = re.fullmatch(r"\w+/(?:\[([0-9a-fA-F:.]+)(?:%\w+)?\]|([0-9.]+)):\d+(?:[?#].*)?", locator)
    return (found[1] or found[2]) if found else None


def interface_to(locator: str, named: Sequence[str]) -> str | None:
    """The interface by which this computer reaches a Zenoh locator; ``named``: those that Zenoh names, often all."""
    if len(named) == 1:
        return named[0]
    address = address_of(locator)
    if address is None:
        return None
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    with contextlib.suppress(OSError), socket.socket(family, socket.SOCK_DGRAM) as asked:
        asked.connect((address, 9))  # sends nothing: it asks the kernel for the route
        own = asked.getsockname()[0]
        for adapter in ifaddr.get_adapters():
            if any(own == (ip.ip if isinstance(ip.ip, str) else ip.ip[0]) for ip in adapter.ips):
                return adapter.name
    return None
