"""Corrections from an NTRIP caster, by pygnssutils' client, within bounds.

What that client (1.3.1) does by itself, and is kept from here: it reads a reply's head with one ``recv`` and loses the
bytes that came with it; at a stream's end it spins until its timeout; in garbage it neither looks at the clock nor
whether it is to stop; a chunk's length and a page that is no stream it believes and keeps without bound; messages that
pyrtcm cannot decode it drops; after five losses of the caster it is silent for good, and its default stop event is one
for all clients of a process. So each connection is one client, which ends for good with the first trouble, reads
through a socket that counts, and leaves the messages to :class:`zmav.formats.rtcm3.Cutter`. Its request, its login,
TLS, the sourcetable and GGA are as they are there.
"""

from __future__ import annotations

import asyncio
import logging
import re
import ssl
import threading
import time
from collections.abc import Callable
from typing import Any

from pygnssutils import GNSSNTRIPClient

from ground.rtk.options import Caster, Fixed
from zmav.formats.rtcm3 import Cutter, Message
from zmav.waiting import on_loop

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
PACE = 32_768.0
"""bytes a second that are taken, whatever a caster sends; a rich one sends 2,000"""
MOST_LINE = 64
"""characters of a chunk's length"""
GGA_S = 10
"""s between two words to the caster on where the rover is"""


class Ended(Exception):
    """The connection is over, for that reason. No OSError, which the client would take for a reason to go on."""


class _Socket:
    """What the client reads by. The head comes in one piece, and nothing without bound."""

    def __init__(self, sock: Any, stop: threading.Event, source: NtripSource) -> None:
        self._sock, self._stop, self._source = sock, stop, source
        self._rest = b""
        self._reads = self._page = 0
        self._streams = False
        sock.settimeout(0.5)

    def sendall(self, data: bytes) -> None:
        self._sock.settimeout(self._source.head)
        self._sock.sendall(data)
        self._sock.settimeout(0.5)

    def recv(self, size: int) -> bytes:
        """As the client calls it: for the head, then to learn that more comes (it throws that away), then a page."""
        self._reads += 1
        if self._reads == 1:
            return self._head()
        if self._reads == 2 and self._streams:
            return b"\n"
        data = self.read(time.monotonic() + self._source.silence)
        self._page += len(data)
        if self._page > MOST_PAGE:
            raise Ended("it sends a page without end instead of corrections")
        return data

    def read(self, deadline: float) -> bytes:
        """What came; empty at the end of the stream or where it is to stop. Raises :class:`Ended` at the deadline."""
        if self._rest:
            data, self._rest = self._rest, b""
            return data
        while not self._stop.is_set():
            try:
                return bytes(self._sock.recv(4096))
            except (TimeoutError, ssl.SSLWantReadError):
                if time.monotonic() > deadline:
                    raise Ended("it is silent") from None
        return b""

    def _head(self) -> bytes:
        deadline, data = time.monotonic() + self._source.head, b""
        while True:
            lines = data.lstrip(b"\r\n")
            end = data.find(b"\r\n\r\n")
            # Casters of version 1 may end their one line with one line break, and begin with data at once.
            if lines.startswith(b"ICY 200") and b"\r\n" in lines:
                end = data.find(b"\r\n")
                self._rest = data[end + 2 :].removeprefix(b"\r\n")
                self._streams = True
                return data[:end] + b"\r\n\r\n"
            if end >= 0:
                self._rest = data[end + 4 :]
                self._streams = b"gnss/data" in data[:end].lower()
                return data[: end + 4]
            if len(data) > MOST_HEAD or time.monotonic() > deadline:
                raise Ended("no reply to the request for corrections")
            more = self.read(deadline)
            if not more:
                raise Ended("it ended the connection without a reply")
            data += more

    def shutdown(self, how: int) -> None:
        self._sock.shutdown(how)

    def close(self) -> None:
        self._sock.close()


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


class _Client(GNSSNTRIPClient):  # type: ignore[misc]  # it has no types
    """One connection: ``ended(why)`` is called once, from its thread."""

    def __init__(
        self, source: NtripSource, take: Callable[[list[Message]], None], ended: Callable[[str, str], None]
    ) -> None:
        self._source, self._take, self._ended, self._why, self._over = source, take, ended, "", False
        more = {"tlscrtpath": source.caster.ca} if source.caster.ca else {}
        super().__init__(source.place, retries=0, timeout=source.head, verbosity=-1, **more)
        for name in ("pyrtcm", "pyspartn"):  # it gives them one more handler each time
            logging.getLogger(name).handlers.clear()

    def _open_connection(self, settings: dict[str, Any]) -> Any:
        return _Socket(super()._open_connection(settings), self.stopevent, self._source)

    def _do_request(self, sock: Any, settings: dict[str, Any], stopevent: threading.Event, output: Any) -> int:
        super()._do_request(sock, settings, stopevent, output)
        self._why = self._why or "it ended the stream"
        return 0  # or it would try again by itself

    def _parse_ntrip_data(self, sock: Any, settings: dict[str, Any], stopevent: threading.Event, output: Any) -> None:
        chunks = Chunks() if self.encoding & 1 else None
        if self.encoding & ~1:
            raise Ended("it sends compressed corrections, which nobody asked for")
        cutter, garbage, heard = Cutter(), 0, time.monotonic()
        while not stopevent.is_set():
            data = sock.read(heard + self._source.silence)
            if not data:
                raise Ended("it ended the stream")
            time.sleep(len(data) / PACE)
            content = data if chunks is None else chunks.feed(data)
            if messages := cutter.feed(content):
                self._take(messages)
                garbage, heard = 0, time.monotonic()
            else:
                garbage += len(data)
            if garbage > MOST_GARBAGE or time.monotonic() > heard + self._source.silence:
                raise Ended("what it sends is no RTCM 3")
            self._send_gga(sock, settings["ggainterval"], None)

    def _app_update_status(self, status: bool, msgt: tuple[str, str]) -> None:
        self._why = str(msgt[0])

    def _close_connection(self, sock: Any) -> None:
        super()._close_connection(sock)
        if not self._over:
            self._over = True
            code = self._response_status.get("code", 0) if self._response_status else 0
            self._ended(_words(self._why, code), str(code))


def _words(why: str, code: int) -> str:
    if code == 401:
        return "refused: user or password is wrong (401)"
    if code and code != 200:
        return f"refused: {why}"
    for name in ("Ended", "TimeoutError", "ConnectionRefusedError", "gaierror"):
        if why.startswith(name):
            return why.removeprefix(name).strip("()'\"") or name
    if re.match(r"\w+Error\(", why):
        return f"it does not speak NTRIP: {why}"
    return why or "it ended the stream"


class _Place:
    """Where the client asks for the rover's place."""

    def __init__(self) -> None:
        self.at: Fixed | None = None

    def get_coordinates(self) -> dict[str, Any]:
        if self.at is None:
            raise ValueError("not known")  # by which the client sends none
        return {"lat": self.at.lat_deg, "lon": self.at.lon_deg, "alt": self.at.height, "sep": 0.0}


class NtripSource:
    """One caster. ``take`` gets its messages on the event loop, ``told`` a state and words about it."""

    def __init__(
        self,
        caster: Caster,
        take: Callable[[list[Message]], object],
        told: Callable[[str, str], None],
        where: Callable[[], Fixed | None] | None = None,
    ) -> None:
        self.caster, self._take, self._told, self._where = caster, take, told, where
        self.place = _Place()
        self.mountpoints: list[str] = []
        """of the sourcetable, which comes instead of corrections for a mountpoint that is not there"""
        self.longest, self.head, self.silence = LONGEST_S, HEAD_S, SILENCE_S
        self._count = 0
        """times that messages came"""
        logging.getLogger("pygnssutils").setLevel(logging.CRITICAL + 1)  # what it has to say is told by ``told``

    async def run(self) -> None:
        """Connect again and again; each loss is told, and waited for longer."""
        pause = 1.0
        while True:
            if self._where is not None and self._where() is None:
                self._told("waiting", "for the place of the vehicle that the caster is told")
                await asyncio.sleep(1.0)
                continue
            self._told("connecting", f"to {self.caster.words}")
            began, count = time.monotonic(), self._count
            why, code = await self._connect()
            pause = 1.0 if self._count > count and time.monotonic() - began > 30.0 else min(pause * 2.0, 60.0)
            if code in ("401", "403", "404") or self.mountpoints:
                pause = 60.0  # it will not have changed its mind, and casters ban who knocks too often
            self._told("lost", f"{why}; again in {pause:.0f} s")
            await asyncio.sleep(pause)

    async def _connect(self) -> tuple[str, str]:
        loop, caster = asyncio.get_running_loop(), self.caster
        over: asyncio.Future[tuple[str, str]] = loop.create_future()

        def take(messages: list[Message]) -> None:
            self._count += 1
            self._told("streaming", f"from {caster.words}")
            self._take(messages)

        def ended(why: str, code: str) -> None:
            if not over.done():
                over.set_result((why, code))

        began, count = time.monotonic(), self._count
        client = _Client(self, on_loop(loop, take), on_loop(loop, ended))
        stop = threading.Event()
        self.place.at = self._where() if self._where else None
        client.run(
            server=caster.host,
            port=caster.port,
            https=caster.tls,
            selfsign=caster.ca is not None,
            mountpoint=caster.mountpoint,
            version=caster.version,
            ntripuser=caster.user,
            ntrippassword=caster.password,
            ggainterval=-1 if self._where is None else GGA_S,
            stopevent=stop,
        )
        try:
            while not over.done():
                await asyncio.wait({over}, timeout=1.0)
                if self._where is not None:
                    self.place.at = self._where() or self.place.at
                if self._count == count and time.monotonic() - began > self.longest:
                    return f"nothing within {self.longest:.0f} s", ""
            why, code = over.result()
        finally:
            client.stop()
        table = client.settings["sourcetable"]
        self.mountpoints = sorted({str(row[0])[:80] for row in table if row})[:200]
        if self.mountpoints:
            named = f"no mountpoint {caster.mountpoint!r}" if caster.mountpoint else "no mountpoint is named"
            why = f"{named}: it has {', '.join(self.mountpoints[:20])}"
        return why, code
