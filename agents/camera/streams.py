"""Encoded video from where a camera gives it: H.264 of a device, of RTSP or a file, as it was encoded; and pictures
that are encoded here, as a stand-in for a camera that does it.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import struct
import threading
import time
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from agents.camera.capture import Lost, Shot, Source, pause, without_password
from agents.camera.mjpeg import MjpegSource
from agents.camera.sources import CONTAINERS, DEVICE, check_device
from zmav.errors import BadConfig, BadMessage
from zmav.vision.opencv import Image
from zmav.vision.video import DELIMITER, FILLER, KEY_SLICE, PPS, SPS, START, nal_units, pyav

SCHEMES = ("rtsp", "rtsps", "rtmp", "udp", "tcp", "http", "https")
OPEN_S, READ_S = 5.0, 5.0
CLOCK = re.compile(r"clock(?::([1-9]\d{1,3})x([1-9]\d{1,3})(?:@([1-9]\d?))?)?\Z")
GROUP_S = 2.0
"""s from one key frame to the next, where we encode"""
BITS = (100e3, 20e6)
"""bits a second that an encoder is asked for, at least and at most"""
CHANGED = 0.15
"""share by which what is asked of an encoder has to differ from the last time"""


class Encoded(NamedTuple):
    """One access unit of a camera: Annex B, a key frame with its parameter sets."""

    data: bytes
    key: bool
    t: float
    """UTC seconds, as well as it is known"""
    width: int
    height: int


class Stream(Protocol):
    """Where encoded video comes from."""

    words: str
    """for people"""

    def check(self) -> None:
        """Raises :class:`BadConfig` for what can never be opened."""

    def shots(self, closed: threading.Event) -> Iterator[Encoded]:
        """Open it and give its units until ``closed``; raises :class:`Lost`. Ends by itself at the end of a file."""

    def aim(self, bits: float) -> bool:
        """Have it encode with so many bits a second; False: it cannot be told."""

    def want_key(self) -> None:
        """Have it send a key frame soon, where it can be told."""


def open_stream(
    text: str, *, rate: float = 30.0, loop: bool = False, delay: float = 0.0, size: tuple[int, int] = (1280, 720)
) -> Stream:
    """The stream that an argument means: ``/dev/video0``, a URL, a file of H.264, ``clock``; the simulator's pictures
    are encoded. ``rate`` (Hz) and ``size`` are asked of a device; ``delay``: s from shutter to arrival. Raises
    :class:`BadConfig` for what is no stream, or is not there.
    """
    scheme = text.partition("://")[0].lower() if "://" in text else ""
    stream: Stream
    if found := CLOCK.match(text):
        width, height, hz = (
            int(each) if each else usual for each, usual in zip(found.groups(), (*size, int(rate)), strict=True)
        )
        stream = Encoding(ClockSource(width, height, hz), hz, stamped=True)
    elif scheme == "http" and not text.partition("?")[0].lower().endswith(CONTAINERS):
        stream = Encoding(MjpegSource(text, delay), rate)
    elif scheme in SCHEMES:
        stream = Contained(text, delay=delay)
    elif scheme:
        expected = ", ".join(f"{each}://" for each in SCHEMES)
        text = f"{text!r}: {scheme}:// is no source of video; expected one of {expected}"
        raise BadConfig(text, field="source", value=scheme, expected=expected)
    elif device := DEVICE.match(text):
        stream = Device(f"/dev/video{int(device[1])}", rate, size, delay)
    else:
        stream = Contained(text, paced=True, loop=loop)
    stream.check()
    return stream


class ParameterSets:
    """Repeats a stream's parameter sets (SPS, PPS) with each key frame, so that anyone may begin there; leaves out
    what is of no use. ``known``: those that came beside the stream, Annex B.
    """

    def __init__(self, known: bytes = b"") -> None:
        self._sets: dict[int, bytes] = {}
        with contextlib.suppress(BadMessage):
            self._learn(nal_units(known))

    def unit(self, data: bytes) -> tuple[bytes, bool] | None:
        """The unit to send and whether it is a key frame; None: not yet, for want of parameter sets. Raises
        :class:`BadMessage` for what is no H.264.
        """
        units = [each for each in nal_units(data) if each[0] & 0x1F not in (DELIMITER, FILLER)]
        self._learn(units)
        kinds = {each[0] & 0x1F for each in units}
        key = KEY_SLICE in kinds
        if key and not {SPS, PPS} <= kinds:
            if len(self._sets) < 2:
                return None
            units = [self._sets[SPS], self._sets[PPS], *(each for each in units if each[0] & 0x1F not in (SPS, PPS))]
        return b"".join(b"\x00" + START + each for each in units), key

    def _learn(self, units: list[bytes]) -> None:
        self._sets.update({each[0] & 0x1F: each for each in units if each[0] & 0x1F in (SPS, PPS)})


class Contained:
    """Whatever FFmpeg finds H.264 in: RTSP over TCP, MPEG-TS, a file. ``paced``: by its own times; ``loop``: a file
    begins again.
    """

    format: str | None = None

    def __init__(self, text: str, *, delay: float = 0.0, paced: bool = False, loop: bool = False) -> None:
        self.words = without_password(text)
        self._url, self._delay, self._paced, self._loop = text, delay, paced, loop

    def check(self) -> None:
        pyav()
        if "://" not in self._url and not Path(self._url).exists():
            text = f"{self._url} is neither a device, a URL nor a file of video"
            raise BadConfig(text, field="source", value=self._url, expected="a file that is there")

    def options(self) -> dict[str, str]:
        if self._paced:
            return {}
        own = {"rtsp_transport": "tcp"} if self._url.startswith("rtsp") else {}
        return {"fflags": "nobuffer", "flags": "low_delay", "analyzeduration": "2000000", **own}

    def shots(self, closed: threading.Event) -> Iterator[Encoded]:
        while True:
            count = 0
            for unit in self._once(closed):
                count += 1
                yield unit
            if not count:
                raise Lost(f"{self.words} holds no access unit of H.264")
            if closed.is_set() or not self._loop:
                break
        if not self._paced and not closed.is_set():
            raise Lost(f"{self.words} has ended")

    def _once(self, closed: threading.Event) -> Iterator[Encoded]:
        av = pyav()
        try:
            with av.open(self._url, options=self.options(), format=self.format, timeout=(OPEN_S, READ_S)) as container:
                video = next(iter(container.streams.video), None)
                if video is None or video.codec_context.name != "h264":
                    what = video.codec_context.name if video is not None else "no video"
                    raise Lost(f"{self.words} has {what}: expected H.264, which is passed through as it is")
                yield from self._units(container, video, closed)
        except (av.FFmpegError, OSError, ValueError) as e:
            raise Lost(f"{self.words}: {getattr(e, 'strerror', None) or e}") from e

    def _units(self, container: Any, video: Any, closed: threading.Event) -> Iterator[Encoded]:
        extra = video.codec_context.extradata or b""
        boxed = pyav().bitstream.BitStreamFilterContext("h264_mp4toannexb", video) if extra[:1] == b"\x01" else None
        sets, begin, first, last = ParameterSets(extra), time.monotonic(), None, 0.0
        size, begun = (video.codec_context.width, video.codec_context.height), False
        for packet in container.demux(video):
            if closed.is_set():
                return
            for each in boxed.filter(packet) if boxed else [packet]:
                if not each.size:
                    continue  # the end's mark
                try:
                    found = sets.unit(bytes(each))
                except BadMessage as e:
                    raise Lost(f"{self.words}: {e}") from e
                if self._paced and each.dts is not None and each.time_base:
                    at = float(each.dts * each.time_base)
                    first = at if first is None else first
                    pause(closed, begin + at - first)
                begun = begun or (found is not None and found[1])
                if found is not None and begun:
                    last = max(time.time() - self._delay, last + 1e-4)
                    yield Encoded(*found, last, *size)

    def aim(self, bits: float) -> bool:
        return False

    def want_key(self) -> None:
        """Nobody can be asked over RTSP, and a file is as it is."""


class Device(Contained):
    """A V4L2 device that encodes by itself: its H.264, and its controls."""

    format = "v4l2"
    SET = 0xC008561C
    """VIDIOC_S_CTRL (linux/videodev2.h): id and value, 32 bits each"""
    BITRATE, KEY_FRAME = 0x009909CF, 0x009909E5
    """V4L2_CID_MPEG_VIDEO_BITRATE and ..._FORCE_KEY_FRAME (linux/v4l2-controls.h)"""

    def __init__(self, path: str, rate: float, size: tuple[int, int], delay: float) -> None:
        super().__init__(path, delay=delay)
        self._path, self._rate, self._size = path, rate, size
        self._bits = 0.0

    def check(self) -> None:
        pyav()
        check_device(self._path)

    def options(self) -> dict[str, str]:
        width, height = self._size
        return {"input_format": "h264", "video_size": f"{width}x{height}", "framerate": f"{self._rate:g}"}

    def aim(self, bits: float) -> bool:
        bits = min(max(bits, BITS[0]), BITS[1])
        if abs(bits - self._bits) > CHANGED * self._bits:
            if not self._set(self.BITRATE, round(bits)):
                return False
            self._bits = bits
        return True

    def want_key(self) -> None:
        self._set(self.KEY_FRAME, 1)

    def _set(self, control: int, value: int) -> bool:
        try:
            file = os.open(self._path, os.O_RDWR | os.O_NONBLOCK)
        except OSError:
            return False
        try:
            fcntl.ioctl(file, self.SET, struct.pack("Ii", control, value))
        except OSError:
            return False  # it has no such control
        finally:
            os.close(file)
        return True


class Encoding:
    """Pictures of another source, encoded here: the simulator's, a test picture. It costs what encoding costs, and is
    no way for a real camera. ``stamped``: with the time of each in its upper edge.
    """

    def __init__(self, source: Source, rate: float, stamped: bool = False) -> None:
        self.words = f"{source.words}, encoded here"
        self._source, self._rate, self._stamped = source, rate, stamped
        self._bits = 2e6
        self._key = self._renew = False
        self.wanted = True
        """False: nothing is encoded"""

    def check(self) -> None:
        pyav()
        self._source.check()

    def shots(self, closed: threading.Event) -> Iterator[Encoded]:
        sets, codec, start = ParameterSets(), None, 0.0
        for shot in self._source.shots(closed):
            if not self.wanted:
                codec = None  # whoever comes next begins with a key frame
                continue
            image = shot.decoded()
            height, width = (each - each % 2 for each in image.shape[:2])  # as 4:2:0 has it
            image = np.ascontiguousarray(image[:height, :width])
            if self._stamped:
                stamp(image, shot.t)
            try:
                if codec is None or self._renew or (codec.width, codec.height) != (width, height):
                    codec, start, self._renew = self._codec(width, height), shot.t, False
                frame = pyav().VideoFrame.from_ndarray(image, format="bgr24")
                frame.pts, frame.time_base = round((shot.t - start) * 1e3), codec.time_base
                if self._key:
                    self._key, frame.pict_type = False, pyav().video.frame.PictureType.I
                packets = codec.encode(frame)
            except (pyav().FFmpegError, ValueError) as e:  # no encoder in this FFmpeg, or a size that it cannot take
                raise Lost(f"{self.words}: {getattr(e, 'strerror', None) or e}") from e
            for packet in packets:
                found = sets.unit(bytes(packet))
                if found is not None:
                    yield Encoded(*found, shot.t, width, height)

    def _codec(self, width: int, height: int) -> Any:
        codec = pyav().CodecContext.create("libx264", "w")
        codec.width, codec.height, codec.pix_fmt = width, height, "yuv420p"
        codec.bit_rate, codec.gop_size = round(self._bits), round(GROUP_S * self._rate)
        codec.framerate, codec.time_base = Fraction(round(self._rate), 1), Fraction(1, 1000)
        limits = {"maxrate": str(round(self._bits)), "bufsize": str(round(self._bits / 2))}
        codec.options = {"preset": "ultrafast", "tune": "zerolatency", "forced-idr": "1", "threads": "1", **limits}
        return codec

    def aim(self, bits: float) -> bool:
        bits = min(max(bits, BITS[0]), BITS[1])
        if abs(bits - self._bits) > CHANGED * self._bits:
            self._bits, self._renew = bits, True
        return True

    def want_key(self) -> None:
        self._key = True


STAMP_BITS, STAMP_PX = 32, 16
"""of the time in a picture: cells in its upper left corner, white for 1, the highest bit first; it needs 512 pixels"""


def stamp(image: Image, t: float) -> None:
    """Write UTC milliseconds (modulo 2^32) into a picture, so that a player can tell how old it is."""
    number = int(t * 1e3) % (1 << STAMP_BITS)
    cells = [(number >> (STAMP_BITS - 1 - i)) & 1 for i in range(STAMP_BITS)]
    row = np.repeat(np.array(cells, np.uint8) * 255, STAMP_PX)[: image.shape[1]]
    image[:STAMP_PX, : len(row)] = row[None, :, None]


class ClockSource:
    """A test picture: stripes that move."""

    def __init__(self, width: int, height: int, rate: float) -> None:
        self.words = f"a test picture, {width}x{height} at {rate:g} Hz"
        shades = np.arange(width + height, dtype=np.uint32)
        self._back = (shades[None, :width] + np.arange(height, dtype=np.uint32)[:, None]).astype(np.uint8)
        self._rate = rate

    def check(self) -> None:
        """There is nothing that could be missing."""

    def shots(self, closed: threading.Event) -> Iterator[Shot]:
        count, due = 0, time.monotonic()
        while not closed.is_set():
            pause(closed, due)
            due = max(due + 1.0 / self._rate, time.monotonic() - 1.0)
            moved = np.roll(self._back, -4 * count, axis=1)
            yield Shot(count, time.time(), np.repeat(moved[:, :, None], 3, axis=2), None)
            count += 1
