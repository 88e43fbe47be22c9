"""Link URLs: what may be written, and the one canonical form of each.

Empty hosts mean loopback, also in listening URLs: write ``0.0.0.0`` (or ``[::]``) to be heard from other machines.
Spellings of pymavlink, MAVProxy and MAVSDK are accepted with their own meaning: ``udp:H:P`` and a bare ``H:P`` listen
(pymavlink's ``mavlink_connection``); ``udp://H:P`` speaks to H, ``udp://:P`` listens (MAVSDK).
"""

from __future__ import annotations

import difflib
import ipaddress
import math
import re
from pathlib import Path
from typing import Literal, cast

import msgspec

from zmav.errors import BadUrl

SocketScheme = Literal["udpin", "udpout", "tcp"]
LOOPBACK = "127.0.0.1"
EXPECTED = (
    "serial:/dev/ttyACM0, serial:/dev/ttyUSB0:57600, /dev/ttyUSB0,57600, udpin:HOST:PORT, udpout:HOST:PORT,"
    " tcp:HOST:PORT or replay:FILE.tlog?speed=4"
)
# What is written -> what it means; udp followed by // is MAVSDK's and depends on the host.
SCHEMES: dict[str, str] = {
    "serial": "serial",
    "udp": "udpin",
    "udpin": "udpin",
    "udpout": "udpout",
    "tcp": "tcp",
    "tcpout": "tcp",
    "replay": "replay",
}
OPTIONS: dict[str, tuple[str, ...]] = {
    "serial": ("baud", "rtscts"),
    "udpin": (),
    "udpout": ("local",),
    "tcp": (),
    "replay": ("speed",),
}
BAUD_RANGE = range(300, 20_000_001)
_EVERYWHERE = ("0.0.0.0", "::")
_NODE = re.compile(r"(tty(ACM|USB|AMA|THS|S|O)\d+|cu\..+|serial\d*)(?=$|[:,])")


class SerialUrl(msgspec.Struct, frozen=True):
    path: str
    baud: int | None = None  # None: found by listening
    rtscts: bool = False  # hardware flow control

    def __str__(self) -> str:
        options = ["rtscts=1"] if self.rtscts else []
        if self.baud is None and _ends_in_number(self.path):
            options.insert(0, "baud=auto")
        baud = "" if self.baud is None else f":{self.baud}"
        return f"serial:{self.path}{baud}{_query(options)}"


class SocketUrl(msgspec.Struct, frozen=True):
    scheme: SocketScheme
    host: str  # a name or an address, without brackets
    port: int  # 0 in a listening URL: any free port
    local_port: int = 0  # udpout: the port to send from, 0 = any

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.scheme}:{host}:{self.port}{_query([f'local={self.local_port}'] if self.local_port else [])}"


class ReplayUrl(msgspec.Struct, frozen=True):
    path: str
    speed: float = 1.0  # times real time; 0 = as fast as possible

    def __str__(self) -> str:
        return f"replay:{self.path}{_query([] if self.speed == 1 else [f'speed={self.speed:.15g}'])}"


LinkUrl = SerialUrl | SocketUrl | ReplayUrl


def parse_url(url: str) -> LinkUrl:
    """Read a link URL; raises BadUrl whose detail has ``field``, ``value``, ``expected`` and perhaps ``hint``."""
    url = str(url).strip()
    if not url:
        raise _bad(url, "url", url, EXPECTED)
    body, options = _split_options(url)
    scheme, rest, slashes = _split_scheme(url, body)
    if scheme == "udp" and slashes and rest.rpartition(":")[0] not in ("", *_EVERYWHERE, "[::]"):
        scheme = "udpout"
    if scheme == "tcp" and slashes and rest.startswith(":"):  # MAVSDK listens there; we would speak to ourselves
        raise _bad(url, "host", "", "an address to send to", hint=f"tcp:{LOOPBACK}{rest}")
    kind = SCHEMES[scheme]
    _check_options(url, kind, options)
    if kind == "serial":
        return _serial(url, rest, options)
    if kind == "replay":
        return _replay(url, rest, options)
    return _socket(url, kind, rest, options)


def _split_options(url: str) -> tuple[str, dict[str, str]]:
    body, mark, query = url.rpartition("?")
    if not mark or "=" not in query:
        return url, {}  # a question mark may also stand in a file's name
    options: dict[str, str] = {}
    for part in query.split("&"):
        name, equals, value = part.partition("=")
        if not equals or not name or name in options:
            raise _bad(url, "options", part, "name=value pairs joined by &, each name once")
        options[name] = value
    return body, options


def _split_scheme(url: str, body: str) -> tuple[str, str, bool]:
    """(scheme as written, the rest, whether // stood between them); bare paths and HOST:PORT imply one."""
    if body.lower().endswith(".tlog") and not re.match(r"[a-z]+:", body):
        return "replay", body, False
    if body.startswith(("/", "./", "../", "~")):
        return "serial", body, False
    word, colon, rest = body.partition(":")
    name = word.lower()
    if colon and name in SCHEMES:
        slashes = rest.startswith("//")
        return name, rest.removeprefix("//"), slashes
    if _NODE.match(body):
        raise _bad(url, "path", body, "a device with its whole path", hint=f"/dev/{body}")
    if body.isdecimal():
        raise _bad(url, "url", body, EXPECTED, hint=f"udpin:{LOOPBACK}:{body}")
    close = difflib.get_close_matches(name, SCHEMES, 1, 0.7)
    is_host = body.startswith("[") or (rest.isdecimal() and not close)
    if colon and is_host:
        return "udpin", body, False
    hint = ""
    if close and colon:
        lacks_host = rest.isdecimal() and SCHEMES[close[0]] not in ("serial", "replay")
        hint = f"{close[0]}:{LOOPBACK}:{rest}" if lacks_host else f"{close[0]}:{rest}"
    raise _bad(url, "scheme" if colon else "url", word, EXPECTED, hint=hint)


def _check_options(url: str, kind: str, options: dict[str, str]) -> None:
    allowed = OPTIONS[kind]
    for name in options:
        if name not in allowed:
            close = difflib.get_close_matches(name, allowed, 1, 0.6)
            expected = f"one of {', '.join(allowed)}" if allowed else f"no options: {kind} has none"
            raise _bad(url, "option", name, expected, hint=close[0] if close else "")


def _serial(url: str, rest: str, options: dict[str, str]) -> SerialUrl:
    path, baud_text = rest, options.get("baud", "")
    if "baud" not in options:
        found = re.fullmatch(r"(.*?)(?:,([^,/]*)|:(\w*))", rest)
        if found and (found[2] is not None or found[3] is not None):
            path, baud_text = found[1], found[2] if found[2] is not None else found[3]
            if not baud_text.isdecimal() and not baud_text == "auto":
                raise _bad(url, "baud", baud_text, _baud_expected())
    path = _expand(path)
    if not path:
        raise _bad(url, "path", path, "a serial device such as /dev/ttyACM0")
    if not path.startswith(("/", "./", "../")):
        hint = f"serial:/dev/{rest}" if _NODE.match(path) else ""
        raise _bad(url, "path", path, "a serial device with its whole path, such as /dev/ttyACM0", hint=hint)
    return SerialUrl(path, _baud(url, baud_text), _flag(url, options.get("rtscts", "0").lower()))


def _baud(url: str, text: str) -> int | None:
    if text in ("", "auto"):
        return None
    if not (text.isascii() and text.isdecimal() and len(text) < 10 and int(text) in BAUD_RANGE):
        raise _bad(url, "baud", text, _baud_expected())
    return int(text)


def _baud_expected() -> str:
    return f"a number from {BAUD_RANGE.start} to {BAUD_RANGE.stop - 1} such as 57600 or 921600, or auto"


def _socket(url: str, kind: str, rest: str, options: dict[str, str]) -> SocketUrl:
    host, colon, port_text = rest.rpartition(":")
    listening = kind == "udpin"
    shape = f"{kind}:HOST:PORT"
    if not colon or rest.endswith("]"):
        hint = f"{kind}:{LOOPBACK}:{rest}" if rest.isdecimal() else ""
        raise _bad(url, "port", "", f"{shape} with both host and port", hint=hint)
    port = _port(url, "port", port_text, 0 if listening else 1)
    host = _host(url, kind, host, port_text)
    if not listening and host in _EVERYWHERE:
        raise _bad(url, "host", host, "an address to send to", hint=f"{kind}:{LOOPBACK}:{port_text}")
    local = _port(url, "local", options["local"], 0) if "local" in options else 0
    return SocketUrl(cast(SocketScheme, kind), host, port, local)


def _host(url: str, kind: str, text: str, port: str) -> str:
    expected = "a name, an IPv4 address, or an IPv6 address in brackets; empty is loopback, 0.0.0.0 every interface"
    if not text:
        return LOOPBACK
    bracketed = text.startswith("[") and text.endswith("]")
    host = text[1:-1] if bracketed else text
    try:
        version: int = ipaddress.ip_address(host).version
    except ValueError:
        version = 0
    if bracketed or version == 6:
        if version == 6 and bracketed:
            return host
        raise _bad(url, "host", text, expected, hint=f"{kind}:[{host}]:{port}" if version == 6 else "")
    looks_numeric = re.fullmatch(r"[\d.]+", host) is not None
    if version == 4 or (not looks_numeric and re.fullmatch(r"[A-Za-z0-9_]([A-Za-z0-9_.-]{0,253})", host)):
        return host
    raise _bad(url, "host", text, expected, hint=f"{kind}:0.0.0.0:{port}" if host == "*" else "")


def _port(url: str, field: str, text: str, lowest: int) -> int:
    if not (text.isascii() and text.isdecimal() and len(text) <= 5 and lowest <= int(text) <= 65535):
        any_port = " (0: any free port)" if lowest == 0 else ""
        raise _bad(url, field, text, f"a number from {lowest} to 65535{any_port}")
    return int(text)


def _replay(url: str, rest: str, options: dict[str, str]) -> ReplayUrl:
    if not rest:
        raise _bad(url, "file", rest, "a recording, as in replay:flight.tlog")
    path = Path(_expand(rest))
    if not _is_file(path):
        raise _bad(url, "file", rest, "an existing .tlog file")
    text = options.get("speed", "1")
    try:
        speed = 0.0 if text == "max" else float(text.removesuffix("x"))
    except ValueError:
        speed = math.nan
    if not (math.isfinite(speed) and speed >= 0):
        raise _bad(url, "speed", text, "a number: 1 is real time, 4 four times as fast, 0 or max as fast as possible")
    return ReplayUrl(str(path), speed)


def _expand(path: str) -> str:
    """``~`` and ``~user`` written out; as it is where there can be no such user."""
    try:
        return str(Path(path).expanduser()) if path.startswith("~") else path
    except (RuntimeError, ValueError):
        return path


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # may not be looked at, too long, or not a name at all
        return False


def _flag(url: str, text: str) -> bool:
    if text not in ("0", "1", "false", "true", "no", "yes"):
        raise _bad(url, "rtscts", text, "1 or 0")
    return text in ("1", "true", "yes")


def _ends_in_number(path: str) -> bool:
    return re.search(r"[:,]\w*$", path) is not None


def _query(options: list[str]) -> str:
    return "?" + "&".join(options) if options else ""


def _bad(url: object, field: str, value: object, expected: str, hint: str = "") -> BadUrl:
    text = f"bad link URL {url!r}: {field} is {value!r}, expected {expected}"
    if hint:
        text += f"; did you mean {hint!r}?"
    return BadUrl(text, url=url, field=field, value=value, expected=expected, **({"hint": hint} if hint else {}))
