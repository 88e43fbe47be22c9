"""What OpenCV opens: devices, streams, folders of pictures; and which of them an argument means."""

from __future__ import annotations

import contextlib
import re
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from agents.camera.capture import Lost, Shot, Source, pause, without_password
from agents.camera.mjpeg import MjpegSource
from zmav.errors import BadConfig
from zmav.vision.opencv import Image, opencv

PICTURES = (".jpg", ".jpeg", ".png", ".bmp")
STREAMS = ("rtsp", "rtsps", "rtmp", "udp", "tcp", "https")
CONTAINERS = (".m3u8", ".mp4", ".ts", ".mkv", ".avi", ".flv", ".webm")
DEVICE = re.compile(r"(?:/dev/video)?(\d{1,3})\Z")
OPEN_MS, READ_MS = 5000, 5000
OLDEST = 5.0
"""s that a device's time stamp may lie back: one that is older, or ahead, is of another clock"""


def open_source(
    text: str, *, rate: float = 10.0, loop: bool = False, delay: float = 0.0, size: tuple[int, int] | None = None
) -> Source:
    """The source that an argument means: ``0`` or ``/dev/video0``, a URL, a folder of pictures.

    ``rate``: Hz of a folder, asked of a device; ``loop``: a folder begins again; ``delay``: s from the middle of an
    exposure to arrival, where the source does not say when a picture was taken; ``size``: asked of a device. Raises
    :class:`BadConfig` for what is no source, or is not there.
    """
    source: Source
    if DEVICE.match(text):
        source = DeviceSource(text, rate, delay, size)
    elif "://" in text:
        scheme = text.partition("://")[0].lower()
        if scheme == "http" and not text.partition("?")[0].lower().endswith(CONTAINERS):
            source = MjpegSource(text, delay)
        elif scheme in (*STREAMS, "http"):
            source = StreamSource(text, delay)
        else:
            expected = ", ".join(f"{each}://" for each in ("http", *STREAMS))
            raise BadConfig(
                f"{text!r}: {scheme}:// is no source of pictures; expected one of {expected}",
                field="source",
                value=text,
                expected=expected,
            )
    else:
        source = Replay(Path(text), rate, loop)
    source.check()
    return source


class DeviceSource:
    """A V4L2 camera, by its number or path."""

    def __init__(self, text: str, rate: float, delay: float, size: tuple[int, int] | None) -> None:
        found = DEVICE.match(text)
        assert found is not None, text
        self.path = f"/dev/video{int(found[1])}"
        self.words = self.path
        self._rate, self._delay, self._size = rate, delay, size

    def check(self) -> None:
        opencv()
        check_device(self.path)

    def shots(self, closed: threading.Event) -> Iterator[Shot]:
        cv2 = opencv()
        video = cv2.VideoCapture(self.path, cv2.CAP_V4L2)
        try:
            video.set(cv2.CAP_PROP_BUFFERSIZE, 1)
            video.set(cv2.CAP_PROP_FPS, self._rate)
            if self._size is not None:
                video.set(cv2.CAP_PROP_FRAME_WIDTH, self._size[0])
                video.set(cv2.CAP_PROP_FRAME_HEIGHT, self._size[1])
            yield from _frames(video, f"{self.path} gives no pictures", closed, self._taken)
        finally:
            video.release()

    def _taken(self, video: Any) -> float:
        stamp = float(video.get(opencv().CAP_PROP_POS_MSEC)) / 1e3
        return taken(stamp, time.monotonic(), time.time(), self._delay)


def check_device(path: str) -> None:
    """Raise :class:`BadConfig` where there is no such device."""
    if not Path(path).exists():
        there = ", ".join(sorted(str(each) for each in Path("/dev").glob("video*"))) or "none"
        text = f"there is no camera {path} (there are: {there})"
        raise BadConfig(text, field="source", value=path, expected=there)


def taken(stamp: float, monotonic: float, utc: float, delay: float) -> float:
    """UTC seconds at which a picture was taken that came now: V4L2 stamps it by the monotonic clock; else ``delay``
    seconds ago.
    """
    age = monotonic - stamp
    return utc - age if stamp > 0.0 and 0.0 <= age < OLDEST else utc - delay


class StreamSource:
    """RTSP and whatever else FFmpeg reads from the network."""

    def __init__(self, url: str, delay: float) -> None:
        self.words = without_password(url)
        self._url, self._delay = url, delay

    def check(self) -> None:
        opencv()

    def shots(self, closed: threading.Event) -> Iterator[Shot]:
        cv2 = opencv()
        limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, OPEN_MS, cv2.CAP_PROP_READ_TIMEOUT_MSEC, READ_MS]
        video = cv2.VideoCapture(self._url, cv2.CAP_FFMPEG, limits)
        try:
            yield from _frames(video, "the stream gives no pictures", closed, lambda _: time.time() - self._delay)
        finally:
            video.release()


def _frames(video: Any, why: str, closed: threading.Event, taken: Any) -> Iterator[Shot]:
    count = 0
    while not closed.is_set():
        good, image = video.read()
        if not good:
            raise Lost(why)
        yield Shot(count, taken(video), image, None)
        count += 1


class Replay:
    """The pictures of a folder by their names at ``rate``, as if a camera took them now: what is too slow for them
    misses some. JPEGs are passed on as they are.
    """

    def __init__(self, path: Path, rate: float, loop: bool) -> None:
        self.words = str(path)
        self._path, self._rate, self._loop = path, rate, loop

    def check(self) -> None:
        opencv()
        if not self._path.is_dir():
            text = f"{self._path} is neither a device, a URL nor a folder of pictures"
            raise BadConfig(text, field="source", value=str(self._path), expected="a folder that is there")
        if not pictures_in(self._path):
            text = f"there are no pictures ({', '.join(PICTURES)}) in {self._path}"
            raise BadConfig(text, field="source", value=str(self._path), expected="a folder with pictures")

    def shots(self, closed: threading.Event) -> Iterator[Shot]:
        count, due = 0, time.monotonic()
        while not closed.is_set():
            before = count
            for image, jpeg in self._pictures():
                pause(closed, due)
                yield Shot(count, time.time(), image, jpeg)
                count += 1
                due = max(due, time.monotonic() - 1.0) + 1.0 / self._rate
                if closed.is_set():
                    return
            if count == before:
                raise Lost(f"{self._path} holds no picture that can be read")
            if not self._loop:
                return

    def _pictures(self) -> Iterator[tuple[Image | None, bytes | None]]:
        """Each decoded, or as JPEG."""
        cv2 = opencv()
        for path in pictures_in(self._path):
            data = path.read_bytes()
            jpeg = data if data[:2] == b"\xff\xd8" else None
            image = None
            if jpeg is None:
                with contextlib.suppress(cv2.error):  # one that it refuses as too large is passed over, too
                    image = cv2.imread(str(path), cv2.IMREAD_COLOR)
            if jpeg is not None or image is not None:
                yield image, jpeg


def pictures_in(folder: Path) -> list[Path]:
    """The pictures of a folder, by name."""
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in PICTURES)
