"""Pictures from anywhere, each source in a thread of its own: the latest wins, and what vanishes is opened again."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple, Protocol

from zmav.vision.opencv import Image, decode

FIRST_WAIT, LONGEST_WAIT = 0.5, 8.0
"""s before a source that vanished is opened again; doubled each time until a picture comes"""


class Shot(NamedTuple):
    """One picture of a source: decoded, or as the JPEG that it came as."""

    seq: int
    """counts the source's pictures"""
    t: float
    """UTC seconds at the middle of the exposure, as well as it is known"""
    image: Image | None
    """(height, width, 3) BGR"""
    jpeg: bytes | None

    def decoded(self) -> Image:
        """(height, width, 3) BGR; raises :class:`~zmav.errors.BadInput` for a JPEG that is none."""
        return self.image if self.image is not None else decode(self.jpeg or b"")


class Lost(Exception):
    """The source has ended or failed; it may be there again later."""


class Source(Protocol):
    """Where pictures come from."""

    @property
    def words(self) -> str:
        """For people."""

    def check(self) -> None:
        """Raises :class:`BadConfig` for what can never be opened."""

    def shots(self, closed: threading.Event) -> Iterator[Shot]:
        """Open it and give its pictures until ``closed``; raises :class:`Lost`. Ends by itself at the end of a file."""


class Capture:
    """Runs a source until :meth:`close`; raises what its ``check`` does.

    ``news`` is called after each picture and at the end, and ``say`` with a line for people, both in the source's
    thread.
    """

    def __init__(
        self,
        source: Source,
        news: Callable[[], None] = lambda: None,
        say: Callable[[str], None] = lambda line: None,
        first_wait: float = FIRST_WAIT,
    ) -> None:
        source.check()
        self.source = source
        self.ended = False
        """a file that is not looped has come to its end"""
        self.lost = ""
        """why there are no pictures at present; empty where they come"""
        self._news, self._say, self._first_wait = news, say, first_wait
        self.latest: Shot | None = None
        self.count = 0
        """pictures that have come"""
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="zmav-capture", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End it; a source that blocks (a dead RTSP server) is left to its thread, which ends with the process."""
        self._closed.set()
        self._thread.join(2.0)

    def _run(self) -> None:
        wait = self._first_wait
        while not self._closed.is_set():
            before = self.count
            try:
                for shot in self.source.shots(self._closed):
                    self._take(shot)
                    if self._closed.is_set():
                        return
                why = ""
            except Exception as e:  # of OpenCV, FFmpeg and HTTP, too: a thread that ends would say nothing of it
                why = " ".join(str(e).split()) or type(e).__name__
            if not why:
                break
            wait = self._first_wait if self.count > before else wait
            self._lose(f"{why}; opened again in {wait:g} s")
            self._closed.wait(wait)
            wait = min(2.0 * wait, LONGEST_WAIT)
        self.ended = True
        self._news()

    def _take(self, shot: Shot) -> None:
        if self.lost:
            self.lost = ""
            self._say(f"{self.source.words}: pictures come again")
        self._keep(shot)
        self.count += 1
        self._news()

    def _keep(self, shot: Shot) -> None:
        # A source that was opened again counts from zero; its pictures are later all the same.
        self.latest = shot._replace(seq=self.count)

    def _lose(self, why: str) -> None:
        if not self.lost:
            self._say(why if why.startswith(self.source.words) else f"{self.source.words}: {why}")
        self.lost = why


def without_password(url: str) -> str:
    """A URL for people; passwords with / or @ in them are about, too."""
    return re.sub(r"//.*@", "//", url)


def pause(closed: threading.Event, until: float) -> None:
    """Wait until ``until`` (monotonic seconds), or the end."""
    closed.wait(max(0.0, until - time.monotonic()))
