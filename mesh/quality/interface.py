"""By which network interface a neighbour is reached, and how loud it is heard where that is a radio.

Linux is asked by generic netlink, as ``iw dev wlan0 station get MAC`` does: one request, one answer; a kernel without
Wi-Fi says so at once. Numbers are those of ``linux/netlink.h``, ``linux/genetlink.h`` and ``linux/nl80211.h``.
"""

from __future__ import annotations

import contextlib
import re
import socket
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path

import ifaddr

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


NETLINK_GENERIC = 16
GENL_ID_CTRL, CTRL_CMD_GETFAMILY, CTRL_ATTR_FAMILY_ID, CTRL_ATTR_FAMILY_NAME = 16, 3, 1, 2
NLM_F_REQUEST, NLMSG_MIN_TYPE = 1, 16
NL80211_CMD_GET_STATION = 17
NL80211_ATTR_IFINDEX, NL80211_ATTR_MAC, NL80211_ATTR_STA_INFO = 3, 6, 21
NL80211_STA_INFO_SIGNAL, NL80211_STA_INFO_SIGNAL_AVG = 7, 13
NLA_TYPE_MASK = 0x3FFF
TIMEOUT = 0.1
_HEADER = struct.Struct("=IHHII")
_GENERIC = struct.Struct("=BBH")
_ATTRIBUTE = struct.Struct("=HH")


def station_signal(interface: str, mac: bytes) -> float | None:
    """dBm, averaged where the driver does; None where the interface has no such station, or is no radio."""
    with contextlib.suppress(OSError), socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, NETLINK_GENERIC) as kernel:
        kernel.settimeout(TIMEOUT)
        index = socket.if_nametoindex(interface)
        kernel.send(_request(GENL_ID_CTRL, CTRL_CMD_GETFAMILY, {CTRL_ATTR_FAMILY_NAME: b"nl80211\0"}))
        family = attributes(kernel.recv(65_536)).get(CTRL_ATTR_FAMILY_ID, b"")
        if len(family) != 2:
            return None
        asked = {NL80211_ATTR_IFINDEX: struct.pack("=I", index), NL80211_ATTR_MAC: mac}
        kernel.send(_request(struct.unpack("=H", family)[0], NL80211_CMD_GET_STATION, asked))
        return level(attributes(kernel.recv(65_536)))
    return None


def level(station: dict[int, bytes]) -> float | None:
    """dBm in the attributes of a station."""
    info = dict(_split(station.get(NL80211_ATTR_STA_INFO, b"")))
    for kind in (NL80211_STA_INFO_SIGNAL_AVG, NL80211_STA_INFO_SIGNAL):
        if len(value := info.get(kind, b"")) == 1 and (dbm := int.from_bytes(value, "little", signed=True)) < 0:
            return float(dbm)
    return None


def attributes(message: bytes) -> dict[int, bytes]:
    """Those of the first message in what the kernel sent; none for an error."""
    if len(message) < _HEADER.size:
        return {}
    length, kind, _, _, _ = _HEADER.unpack_from(message)
    if kind < NLMSG_MIN_TYPE or not _HEADER.size + _GENERIC.size <= length <= len(message):
        return {}
    return dict(_split(message[_HEADER.size + _GENERIC.size : length]))


def _split(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Attributes are length, type and value, each at a multiple of four."""
    while len(data) >= _ATTRIBUTE.size:
        length, kind = _ATTRIBUTE.unpack_from(data)
        if not _ATTRIBUTE.size <= length <= len(data):
            return
        yield kind & NLA_TYPE_MASK, data[_ATTRIBUTE.size : length]
        data = data[(length + 3) & ~3 :]


def _request(family: int, command: int, said: dict[int, bytes]) -> bytes:
    body = _GENERIC.pack(command, 1, 0)
    for kind, value in said.items():
        body += (_ATTRIBUTE.pack(_ATTRIBUTE.size + len(value), kind) + value).ljust((len(value) + 7) & ~3, b"\0")
    return _HEADER.pack(_HEADER.size + len(body), family, NLM_F_REQUEST, 1, 0) + body
