"""Where corrections come from, as it is written on the command line."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import parse_qsl, unquote, urlsplit

import msgspec

from zmav.errors import BadInput, BadUrl
from zmav.links import SerialUrl, parse_url

PASSWORD = "ZMAV_NTRIP_PASSWORD"
"""the variable that holds a caster's password, which on a command line everybody on the computer can read"""
PORT, TLS_PORT = 2101, 443
EXPECTED = (
    "ntrip://USER@HOST/MOUNTPOINT, ntrips://USER@HOST/MOUNTPOINT, /dev/ttyACM0, /dev/ttyUSB0,115200, tcp:HOST:PORT or"
    " a file of RTCM 3"
)
BAUD = 115200
LARGEST_FILE = 100_000_000
SIGNS = "in a name or a password / is written %2F, ? %3F, # %23; anywhere @ %40"
_SCHEME = re.compile(r"[a-z]+(?::/{0,2}|//)", re.I)
"""with what stands for its :// where that is miswritten"""


class Caster(msgspec.Struct, frozen=True, kw_only=True):
    """An NTRIP caster's mountpoint."""

    host: str
    port: int
    mountpoint: str
    tls: bool = False
    version: str = "2.0"
    user: str = ""
    password: str = ""
    ca: str | None = None
    """file of the caster's own certificate, where no public authority has signed it"""

    @property
    def words(self) -> str:
        """Without the password."""
        return f"ntrip{'s' if self.tls else ''}://{self.host}:{self.port}/{self.mountpoint}"


class Receiver(msgspec.Struct, frozen=True):
    """A base receiver, or anything that sends RTCM 3 as a stream: a link's URL."""

    url: str

    @property
    def words(self) -> str:
        return self.url


class Recording(msgspec.Struct, frozen=True):
    """A file of RTCM 3."""

    path: Path

    @property
    def words(self) -> str:
        return str(self.path)


Where = Caster | Receiver | Recording


class Survey(msgspec.Struct, frozen=True):
    """The receiver finds out where it is: for so many seconds at least, and until it is so exact."""

    seconds: int
    metres: float


class Fixed(msgspec.Struct, frozen=True):
    """The receiver is told where its antenna is; ``height`` is above the ellipsoid, m."""

    lat_deg: float
    lon_deg: float
    height: float


def parse_source(text: str, environment: Mapping[str, str] = os.environ) -> Where:
    """Raises :class:`BadUrl` for what is none of them."""
    if text.startswith(("ntrip:", "ntrips:", "http:", "https:")):
        return _caster(text, environment)
    path = Path(text)
    if path.is_file():
        if path.stat().st_size > LARGEST_FILE:
            raise BadUrl(f"{text} is larger than {LARGEST_FILE} bytes", field="source", value=text, expected=EXPECTED)
        return Recording(path)
    try:
        target = parse_url(text)
    except BadUrl:  # whose words hold a password that stands there
        raise _no_source(text) from None
    if isinstance(target, SerialUrl):
        if target.baud is None:
            target = msgspec.structs.replace(target, baud=BAUD)  # a link that listens looks for MAVLink
        return Receiver(str(target))
    if not str(target).startswith(("tcp:", "udpin:")):
        raise _no_source(text)
    return Receiver(str(target))


def _no_source(text: str) -> BadUrl:
    shown = _hidden(text)
    return BadUrl(f"no source of corrections {shown!r}", field="source", value=shown, expected=EXPECTED)


def _caster(text: str, environment: Mapping[str, str]) -> Caster:
    try:
        parts = urlsplit(text)
        options = dict(parse_qsl(parts.query, strict_parsing=bool(parts.query)))
        host, port = parts.hostname or "", parts.port
    except ValueError:  # whose words may hold a part of the password
        why = f"its port or its options cannot be read ({SIGNS})"
        raise BadUrl(f"{_hidden(text)}: {why}", field="source", value=_hidden(text), expected=EXPECTED) from None
    version, ca = options.pop("version", "2"), options.pop("ca", None)
    misplaced = parts.fragment or "@" in parts.path + parts.query  # words about it would show a part of the password
    if not host or misplaced or options or version not in ("1", "2", "1.0", "2.0"):
        wrong = "no host after //" if not host else SIGNS if misplaced else ", ".join(options) or f"version {version}"
        expected = f"{EXPECTED}; options are version=1 and ca=FILE"
        raise BadUrl(f"{_hidden(text)}: {wrong}", field="source", value=_hidden(text), expected=expected)
    mountpoint = unquote(parts.path.lstrip("/"))
    if not mountpoint.isprintable() or any(sign in mountpoint for sign in " /@"):
        raise BadUrl(f"no mountpoint in {_hidden(text)!r}", field="source", value=_hidden(text), expected=EXPECTED)
    tls = parts.scheme in ("ntrips", "https")
    if ca is not None and not Path(ca).is_file():
        raise BadUrl(f"no certificate {ca}", field="ca", value=ca, expected="a PEM file")
    return Caster(
        host=host,
        port=port or (TLS_PORT if tls else PORT),
        mountpoint=mountpoint,
        tls=tls,
        version=f"{version[0]}.0",
        user=unquote(parts.username or ""),
        password=unquote(parts.password or "") or environment.get(PASSWORD, ""),
        ca=ca,
    )


def _hidden(text: str) -> str:
    """The URL without its password, for words that people read."""
    _, at, rest = text.rpartition("@" if "@" in text else "%40")
    scheme = _SCHEME.match(text)
    return f"{scheme[0] if scheme else ''}…@{rest}" if at else text


def parse_survey(text: str) -> Survey:
    """``SECONDS,METRES``."""
    seconds, _, metres = text.partition(",")
    try:
        found = Survey(int(seconds), float(metres or 2.0))
    except ValueError:
        found = Survey(0, 0.0)
    if not (1 <= found.seconds <= 86_400 and 0.001 <= found.metres <= 100.0):
        expected = "SECONDS,METRES: 1 to 86400 and 0.001 to 100"
        raise BadInput(f"no survey-in {text!r}", field="survey", value=text, expected=expected)
    return found


def parse_place(text: str, field: str = "at") -> Fixed:
    """``LAT,LON,HEIGHT``."""
    try:
        lat, lon, height = map(float, text.split(","))
    except ValueError:
        lat = lon = height = float("nan")
    if not (-90.0 <= lat <= 90.0 and -180.0 <= lon <= 180.0 and -1000.0 <= height <= 10_000.0):
        expected = "LAT,LON,HEIGHT in degrees and metres: 50.123456789,8.123456789,152.341"
        raise BadInput(f"no place {text!r}", field=field, value=text, expected=expected)
    return Fixed(lat, lon, height)
