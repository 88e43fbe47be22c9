"""How loud a station is heard, asked of Linux by generic netlink: what ``iw dev wlan0 station get MAC`` does.

Numbers are those of ``linux/netlink.h``, ``linux/genetlink.h`` and ``linux/nl80211.h``. One request, one answer; a
kernel without Wi-Fi says so at once.
"""

from __future__ import annotations

import contextlib
import socket
import struct
from collections.abc import Iterator

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
