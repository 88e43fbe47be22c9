"""Corrections from an NTRIP caster of version 1 or 2, within bounds of time, memory and processor.

RTCM 10410.1 (version 2: HTTP/1.1) and its forerunner, whose reply is one line, ``ICY 200 OK``. Each connection ends for
good with the first trouble; the messages are :class:`zmav.formats.rtcm3.Cutter`'s to find.
"""

from __future__ import annotations

import asyncio
import base64
import importlib.metadata
import operator
import re
import ssl
import time
from collections.abc import Callable
from functools import reduce
from typing import NamedTuple

from ground.rtk.options import Caster, Fixed
from zmav.formats.rtcm3 import Cutter, Message
from zmav.waiting import within

SILENCE_S = 20.0
"""s without a message after which a caster is given up"""
HEAD_S = 10.0
"""s within which the head of a reply comes, and the connection and TLS before it, each step"""
LONGEST_S = 60.0
"""s until the first message, whatever holds it up: a name that is looked up, TLS in single bytes"""
MOST_HEAD, MOST_PAGE = 16_384, 262_144
"""bytes of a reply's head, and of one that is no stream"""
MOST_GARBAGE = 65_536
"""bytes without a message after which a caster is given up"""
PIECE, PACE = 4096, 32_768.0
"""bytes that are read at once, and that are taken a second, whatever a caster sends; a rich one sends 2,000"""
MOST_LINE = 64
"""characters of a chunk's length"""
GGA_S = 10.0
"""s between two words to the caster on where the rover is"""


class Ended(Exception):
    """The connection is over, for that reason."""


class Chunks:
    """Takes HTTP's chunks apart (RFC 9112, 7.1), whatever pieces they come in."""

    def __init__(self) -> None:
        self._line, self._left, self._ends = b"", 0, 0

    def feed(self, data: bytes) -> bytes:
        """The content; raises :class:`Ended` for what is no chunk, and at the last one."""
        found = []
        while data:
            if self._left:
                part, data = data[: self._left], data[self._left :]
                found.append(part)
                self._left -= len(part)
                self._ends = 2 if not self._left else 0
            elif self._ends:
                self._ends, data = self._ends - min(self._ends, len(data)), data[self._ends :]
            else:
                self._line += data[:1]
                data = data[1:]
                if self._line.endswith(b"\n"):
                    self._left, self._line = self._length(self._line), b""
                elif len(self._line) > MOST_LINE:
                    raise Ended("it lies about the length of what it sends")
        return b"".join(found)

    @staticmethod
    def _length(line: bytes) -> int:
        digits = line.split(b";")[0].strip()
        if not re.fullmatch(b"[0-9a-fA-F]{1,16}", digits):
            raise Ended("it lies about the length of what it sends")
        length = int(digits, 16)
        if not length:
            raise Ended("it ended the stream")
        return length


class Head(NamedTuple):
    """A reply's lines in lower case, and what came behind them."""

    lines: str
    rest: bytes

    @property
    def streams(self) -> bool:
        return self.lines.startswith("icy") or "gnss/data" in self.lines


async def read_head(reader: asyncio.StreamReader) -> Head:
    """Raises :class:`Ended` where none comes, or one of no caster."""
    deadline, data = time.monotonic() + HEAD_S, b""
    while True:
        end = data.find(b"\r\n\r\n")
        if data.startswith(b"ICY 200") and b"\r\n" in data and end != data.find(b"\r\n"):
            # Casters of version 1 may end their one line with one line break, and begin with data at once.
            end = data.find(b"\r\n") - 2
        if end != -1:
            break
        if len(data) > MOST_HEAD:
            raise Ended("no reply to the request for corrections")
        try:
            more = await within(deadline - time.monotonic(), reader.read(PIECE))
        except asyncio.TimeoutError:
            raise Ended("no reply to the request for corrections") from None
        if not more:
            raise Ended("it ended the connection without a reply")
        data = (data + more).lstrip(b"\r\n")
    lines = data[: end + 2].decode("latin-1").strip()
    found = re.match(r"(?:HTTP/\d\.\d|ICY|SOURCETABLE) (\d{3})\b ?([^\r\n]*)", lines)
    if found is None:
        raise Ended(f"it does not speak NTRIP: {lines[:80]!r}")
    if found[1] != "200":
        why = f"Connection failed {found[1]} {found[2][:80]}"
        raise Ended(f"refused: {'user or password is wrong (401)' if found[1] == '401' else why}", found[1])
    return Head(lines.lower(), data[end + 4 :])


def gga(at: Fixed) -> str:
    """A GGA (NMEA 0183) of a place."""
    parts = []
    for value, digits, ends in ((at.lat_deg, 2, "NS"), (at.lon_deg, 3, "EW")):
        degrees, minutes = divmod(round(abs(value) * 60.0, 5), 60.0)
        parts.append(f"{degrees:0{digits}.0f}{minutes:08.5f},{ends[value < 0.0]}")
    text = f"GPGGA,{time.strftime('%H%M%S', time.gmtime())}.00,{','.join(parts)},1,12,1.0,{at.height:.3f},M,0.0,M,,"
    return f"${text}*{reduce(operator.xor, text.encode()):02X}\r\n"


class NtripSource:
    """One caster. ``take`` gets its messages on the event loop, ``told`` a state and words about it."""

    def __init__(
        self,
        caster: Caster,
        take: Callable[[list[Message]], object],
        told: Callable[[str, str], None],
        where: Callable[[], Fixed | None] | None = None,
    ) -> None:
        self._caster, self._take, self._told, self._where = caster, take, told, where
        self.mountpoints: list[str] = []
        """of the sourcetable, which comes instead of corrections for a mountpoint that is not there"""
        self.longest = LONGEST_S
        self._count = 0
        """times that messages came"""

    async def run(self) -> None:
        """Connect again and again; each loss is told, and waited for longer."""
        pause = 1.0
        while True:
            if self._where is not None and self._where() is None:
                self._told("waiting", "for the place of the vehicle that the caster is told")
                await asyncio.sleep(1.0)
                continue
            self._told("connecting", f"to {self._caster.words}")
            began, count = time.monotonic(), self._count
            why, code = await self._connect()
            pause = 1.0 if self._count > count and time.monotonic() - began > 30.0 else min(pause * 2.0, 60.0)
            if code in ("401", "403", "404") or self.mountpoints:
                pause = 60.0  # it will not have changed its mind, and casters ban who knocks too often
            self._told("lost", f"{why}; again in {pause:.0f} s")
            await asyncio.sleep(pause)

    async def _connect(self) -> tuple[str, str]:
        """Why it is over, and the reply's status where that is the reason."""
        count, serving = self._count, asyncio.ensure_future(self._serve())
        try:
            await asyncio.wait({serving}, timeout=self.longest)
            if not serving.done() and self._count == count:
                return f"nothing within {self.longest:.0f} s", ""
            await serving
            return "it ended the stream", ""
        except Ended as e:
            return str(e.args[0]), "".join(e.args[1:])
        except asyncio.TimeoutError:
            return "it is silent", ""
        except (OSError, ValueError) as e:  # ValueError: of a name that cannot be one
            return getattr(e, "strerror", None) or str(e) or type(e).__name__, ""
        finally:
            serving.cancel()
            await asyncio.wait({serving})

    async def _serve(self) -> None:
        """Raises why it is over."""
        caster, tls = self._caster, None
        if caster.tls:
            tls = ssl.create_default_context(cafile=caster.ca)
            tls.check_hostname = caster.ca is None  # a certificate that was given is believed, whatever name it has
        opening = asyncio.open_connection(caster.host, caster.port, ssl=tls, limit=PIECE)
        reader, writer = await within(HEAD_S, opening)
        try:
            writer.write(self._request())
            await within(HEAD_S, writer.drain())
            head = await read_head(reader)
            await (self._stream(head, reader, writer) if head.streams else self._page(head, reader))
        finally:
            writer.transport.abort()

    def _request(self) -> bytes:
        caster, at = self._caster, self._where() if self._where is not None else None
        lines = [f"GET /{caster.mountpoint} HTTP/1.{'0' if caster.version == '1.0' else '1'}"]
        lines += [f"Host: {caster.host}:{caster.port}", f"User-Agent: NTRIP zmav/{importlib.metadata.version('zmav')}"]
        if caster.user:
            login = base64.b64encode(f"{caster.user}:{caster.password}".encode()).decode()
            lines.append(f"Authorization: Basic {login}")
        if caster.version != "1.0":
            lines += ["Ntrip-Version: Ntrip/2.0", *([f"Ntrip-GGA: {gga(at).strip()}"] if at is not None else [])]
        return "\r\n".join((*lines, "Connection: close", "", "")).encode()

    async def _stream(self, head: Head, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        encoding = re.search(r"^transfer-encoding:(.*)$", head.lines, re.MULTILINE)
        chunks = Chunks() if encoding is not None and encoding[1].strip() == "chunked" else None
        if (encoding is not None and chunks is None) or "content-encoding:" in head.lines:
            raise Ended("it sends compressed corrections, which nobody asked for")
        cutter, garbage, heard, data = Cutter(), 0, time.monotonic(), head.rest
        say_at = heard + (GGA_S if self._caster.version != "1.0" else 0.0)
        while True:
            if not data:
                data = await within(heard + SILENCE_S - time.monotonic(), reader.read(PIECE))
            if not data:
                raise Ended("it ended the stream")
            await asyncio.sleep(len(data) / PACE)
            if messages := cutter.feed(data if chunks is None else chunks.feed(data)):
                self._count += 1
                self._told("streaming", f"from {self._caster.words}")
                self._take(messages)
                garbage, heard = 0, time.monotonic()
            else:
                garbage += len(data)
            now, data = time.monotonic(), b""
            if garbage > MOST_GARBAGE or now > heard + SILENCE_S:
                raise Ended("what it sends is no RTCM 3")
            if self._where is not None and now >= say_at and (at := self._where()) is not None:
                say_at = now + GGA_S
                writer.write(gga(at).encode())

    async def _page(self, head: Head, reader: asyncio.StreamReader) -> None:
        """A sourcetable, or a page that is none."""
        page = head.rest
        while b"ENDSOURCETABLE" not in page and (more := await within(SILENCE_S, reader.read(PIECE))):
            page += more
            if len(page) > MOST_PAGE:
                raise Ended("it sends a page without end instead of corrections")
        rows = re.findall(r"^STR;([^;\r\n]+)", page.decode("latin-1"), re.MULTILINE)
        self.mountpoints = sorted({row[:80] for row in rows})[:200]
        if not self.mountpoints:
            raise Ended("it ended the stream")
        mountpoint = self._caster.mountpoint
        named = f"no mountpoint {mountpoint!r}" if mountpoint else "no mountpoint is named"
        raise Ended(f"{named}: it has {', '.join(self.mountpoints[:20])}")
