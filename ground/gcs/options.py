"""What an endpoint of the bridge may be told: where it is, and what its clients get.

    14550                               on loopback
    0.0.0.0:14550?rate=4kB/s            from anywhere, thinned
    /dev/ttyUSB0,57600?read_only=1      behind a radio

Options stand behind a question mark: ``rate`` (bytes a second to each client: ``4kB/s``), ``vehicles`` (by name, ``*``
for any part of it, joined by commas), ``read_only`` (1: nothing a client says reaches a vehicle).
"""

from __future__ import annotations

import difflib
import fnmatch
from typing import Literal

import msgspec

from ground.feed import patterns
from zmav.config.mesh import parse_budget
from zmav.errors import BadConfig
from zmav.links.url import LOOPBACK

Kind = Literal["udp", "udpin", "tcp", "serial"]
NAMES = ("rate", "vehicles", "read_only")
LEAST_RATE = 100.0


class Options(msgspec.Struct, frozen=True, kw_only=True):
    """What a client gets, and may do."""

    rate: float | None = None
    """bytes a second; None: no limit"""
    vehicles: tuple[str, ...] = ("*",)
    read_only: bool = False

    def sees(self, vehicle: str) -> bool:
        return any(fnmatch.fnmatchcase(vehicle, pattern) for pattern in self.vehicles)


class Endpoint(msgspec.Struct, frozen=True):
    """One place where clients are."""

    kind: Kind
    text: str
    """as a person wrote it, without its options"""
    host: str
    port: int
    options: Options

    def __str__(self) -> str:
        return f"{self.kind} {self.text if self.kind == 'serial' else self.where}"

    @property
    def where(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


def parse_endpoint(kind: Kind, text: str, defaults: Options) -> Endpoint:
    """What stands behind ``--udp`` and the others; raises :class:`BadConfig` that names the option and its value.

    An option that is not there is as in ``defaults``.
    """
    place, _, query = text.partition("?")
    options = parse_options(query, defaults, f"--{kind} {text}")
    if kind == "serial":
        if not place:
            raise _bad(kind, text, "a device, such as /dev/ttyUSB0,57600", text)
        return Endpoint(kind, place, "", 0, options)
    host, _, port = place.rpartition(":")
    host = host.strip("[]")
    number = int(port) if port.isascii() and port.isdecimal() and len(port) < 6 else -1
    if not (number > 0 or (number == 0 and kind != "udp")) or number > 65535:
        raise _bad(kind, port, "[HOST:]PORT, a port being from 1 to 65535", text)
    return Endpoint(kind, place, host or LOOPBACK, number, options)


def parse_options(query: str, defaults: Options, where: str) -> Options:
    """``rate=4kB/s&vehicles=quad*`` on top of the defaults; raises :class:`BadConfig`."""
    given: dict[str, str] = {}
    for part in filter(None, query.split("&")):
        name, equals, value = part.partition("=")
        if name not in NAMES or not equals or name in given:
            close = difflib.get_close_matches(name, NAMES, 1)
            hint = f"; did you mean {close[0]}?" if close and close[0] not in given else ""
            expected = f"NAME=VALUE joined by &, each once, of {', '.join(NAMES)}"
            raise BadConfig.wrong("option", part, expected, f"{where}: no option {part!r}{hint}")
        given[name] = value
    return Options(
        rate=read_rate(given["rate"]) if "rate" in given else defaults.rate,
        vehicles=read_vehicles(given["vehicles"]) if "vehicles" in given else defaults.vehicles,
        read_only=_read_flag(given["read_only"], where) if "read_only" in given else defaults.read_only,
    )


def read_rate(text: str) -> float:
    """Bytes a second of ``4kB/s`` or ``57600 bit/s``."""
    return parse_budget(text, "rate", LEAST_RATE, "'4kB/s' or '57600 bit/s'")


def read_vehicles(text: str) -> tuple[str, ...]:
    return tuple(patterns([name.strip() for name in text.split(",")]))


def _read_flag(text: str, where: str) -> bool:
    if text not in ("0", "1"):
        raise BadConfig(
            f"{where}: read_only is {text!r}; expected 0 or 1", field="read_only", value=text, expected="0, 1"
        )
    return text == "1"


def _bad(kind: Kind, value: str, expected: str, text: str) -> BadConfig:
    return BadConfig.wrong(kind, value, expected, f"--{kind} {text!r}: {value!r}")
