"""How endpoints are written.

``ardupilot`` is what ArduPilot's own simulation opens: ``serial0``, ``serial1`` and ``serial2``, TCP servers at
5760+10*i, 5762+10*i and 5763+10*i, each with its own stream rates (``MAV1_``, ``MAV2_``, ``MAV3_``). ``tcp`` is
``serial0`` alone. ``px4`` is both of PX4's links: ``onboard`` binds 14580+i and sends to 14540+i (from the eleventh on
all to 14549), ``ground`` binds 18570+i and sends to 14550. Here i counts the vehicles that have such ports, from 0.

``tcp:[HOST:]PORT[+STEP]`` (and ``serial0:`` and so on) listens elsewhere; port 0 is any free one. ``+STEP`` adds that
much for each vehicle of the world. ``udp:HOST:PORT[+STEP]`` sends there from a local port that stays the same; who
answers is heard. ``udp-listen:[HOST:]PORT[+STEP]`` waits to be spoken to, and answers who spoke last.
``onboard:LOCAL[+STEP]:[HOST:]REMOTE[+STEP]`` (local port 0: any free one) and ``ground:`` likewise send to who
spoke first, until the vehicle's end is opened again.

``pty[:PATH[+STEP]]`` is a pseudo-terminal, as a serial autopilot's; PATH becomes a link to it (``+STEP`` counts the
number at its end up).
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import msgspec

from zmav.errors import BadUrl

EXPECTED = (
    "ardupilot, tcp, tcp:[HOST:]PORT[+STEP], udp:HOST:PORT[+STEP], udp-listen:[HOST:]PORT[+STEP], px4, "
    "onboard:LOCAL[+STEP]:[HOST:]REMOTE[+STEP], ground:... or pty[:PATH[+STEP]]"
)
LOOPBACK = "127.0.0.1"
_SEVERAL = {"ardupilot": ("serial0", "serial1", "serial2"), "px4": ("onboard", "ground")}
_SERIAL_PORTS = {"tcp": "5760+10", "serial0": "5760+10", "serial1": "5762+10", "serial2": "5763+10"}
_PX4_LINKS = {"onboard": "14580+1:14540+1", "ground": "18570+1:14550"}
_FAMILY = {**dict.fromkeys(_SERIAL_PORTS, "ardupilot"), **dict.fromkeys(_PX4_LINKS, "px4")}
_ONBOARD_REMOTES = 10  # different ports that PX4 sends to
_PTY = re.compile(r"pty(?::(?P<path>[^@]*?)(?P<step>\+\d*)?)?", re.ASCII)


class Address(msgspec.Struct, frozen=True):
    """A parsed endpoint."""

    kind: str
    host: str
    port: int
    local: int = 0
    """the port that one of PX4's links is bound to; 0: any"""
    path: str = ""
    """of the link to a pseudo-terminal; empty: none"""

    def __str__(self) -> str:
        if self.kind == "pty":
            return f"pty:{self.path}"
        kind = "tcp" if self.kind in _SERIAL_PORTS else self.kind
        return f"{kind}:{self.host}:{self.local or self.port}"


def expand(texts: Sequence[str]) -> list[str]:
    """Each endpoint by itself: "px4" stands for two, "ardupilot" for three."""
    return [each for text in texts for each in _SEVERAL.get(text, (text,))]


def addresses(vehicles: Sequence[Sequence[str]]) -> list[list[Address]]:
    """The addresses of all vehicles of a world, from the endpoints of each. :class:`BadUrl` names the one that is
    none, and what is expected.
    """
    instances: dict[str, int] = {}
    found = []
    for index, texts in enumerate(vehicles):
        each = expand(texts)
        found.append(
            [
                parse_endpoint(text, instances.get(_FAMILY.get(text, ""), 0) if text in _FAMILY else index)
                for text in each
            ]
        )
        for family in {_FAMILY[text] for text in each if text in _FAMILY}:
            instances[family] = instances.get(family, 0) + 1
    return found


def parse_endpoint(text: str, index: int) -> Address:
    """The address of vehicle ``index`` (0, 1, ...). Raises :class:`BadUrl` naming what is expected."""
    kind, _, rest = text.partition(":")
    if "\0" in text:
        raise _bad(text)
    if kind in _PX4_LINKS:
        return _parse_px4(kind, _PX4_LINKS[kind] if text == kind else rest, index, text)
    if kind == "pty":
        return _parse_pty(text, index)
    if kind in _SERIAL_PORTS and not rest:
        rest = _SERIAL_PORTS[kind]
    name, _, place = rest.rpartition(":")
    number = _stepped(place, index)
    if kind not in (*_SERIAL_PORTS, "udp", "udp-listen") or number is None or (kind == "udp" and not (name and number)):
        raise _bad(text)
    return Address(kind, name or LOOPBACK, number)


def _parse_px4(kind: str, rest: str, index: int, text: str) -> Address:
    local, _, remote = rest.partition(":")
    name, _, port = remote.rpartition(":")
    bound = _stepped(local, index)
    to = _stepped(port, min(index, _ONBOARD_REMOTES - 1) if kind == "onboard" else index)
    if bound is None or not to:
        raise _bad(text)
    return Address(kind, name or LOOPBACK, to, bound)


def _parse_pty(text: str, index: int) -> Address:
    found = _PTY.fullmatch(text)
    if found is None or found["path"] == "":
        raise _bad(text)
    path = found["path"] or ""
    if found["step"]:
        stem = path.rstrip("0123456789")
        path = f"{stem}{int(path[len(stem) :] or 1) + index * int(found['step'][1:] or 1)}"
    return Address("pty", "", 0, path=path)


def _stepped(text: str, index: int) -> int | None:
    """``PORT[+STEP]`` for vehicle ``index``; port 0 stays 0. None where that is no port."""
    found = re.fullmatch(r"(\d{1,5})(\+(\d{0,5}))?", text, re.ASCII)
    if found is None:
        return None
    number = int(found[1])
    if number and found[2]:
        number += index * int(found[3] or 1)
    return number if number <= 65535 else None


def _bad(text: str) -> BadUrl:
    return BadUrl.wrong("endpoint", text, EXPECTED, f"no endpoint {text!r}")
