"""Where video comes from: what is passed through stays what it was, garbage and a vanished camera are said."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from agents.camera.capture import Lost
from agents.camera.streams import (
    STAMP_BITS,
    STAMP_PX,
    ClockSource,
    Contained,
    Device,
    Encoded,
    Encoding,
    ParameterSets,
    open_stream,
    stamp,
)
from agents.camera.video import Feed
from tests.waiting import wait_until
from zmav.errors import BadConfig
from zmav.vision.video import START, nal_units

SPS, PPS = b"\x67\x42\xc0\x1e", b"\x68\xce\x3c\x80"


def joined(*units: bytes) -> bytes:
    return b"".join(START + each for each in units)


def film(path: Path, count: int = 20, codec: str = "libx264", rate: int = 60) -> list[bytes]:
    """A file of video, and its packets as they were encoded."""
    packets = []
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream(codec, rate=rate)
        stream.width, stream.height, stream.pix_fmt = 320, 240, "yuv420p"
        if codec == "libx264":
            stream.options = {"tune": "zerolatency", "g": "10"}
        for number in range(count):
            frame = av.VideoFrame.from_ndarray(np.full((240, 320, 3), 10 * number, np.uint8), format="rgb24")
            for packet in (*stream.encode(frame), *(stream.encode() if number == count - 1 else ())):
                packets.append(bytes(packet))
                container.mux(packet)
    return packets


def units_of(stream: Any, most: int = 10_000) -> list[Encoded]:
    closed, found = threading.Event(), []
    for unit in stream.shots(closed):
        found.append(unit)
        if len(found) == most:
            closed.set()
    return found


def slices(data: bytes) -> list[bytes]:
    return [each for each in nal_units(data) if each[0] & 0x1F in (1, 5)]


@pytest.mark.parametrize("name", ["film.mp4", "film.ts", "film.h264"])
def test_a_file_is_passed_through(tmp_path: Path, name: str) -> None:
    made = film(tmp_path / name)
    found = units_of(open_stream(str(tmp_path / name)))
    assert len(found) == 20
    assert [unit.key for unit in found] == [n % 10 == 0 for n in range(20)]
    assert [unit.t for unit in found] == sorted({unit.t for unit in found})
    assert {(unit.width, unit.height) for unit in found} == {(320, 240)}
    for unit in found:
        kinds = [each[0] & 0x1F for each in nal_units(unit.data)]
        assert ({7, 8, 5} <= set(kinds)) == unit.key, "parameter sets with each key frame"
    if name != "film.mp4":  # in which they are boxed
        assert [slices(unit.data) for unit in found] == [slices(each) for each in made], "not a bit was changed"


def test_a_file_begins_again_and_comes_at_its_own_pace(tmp_path: Path) -> None:
    film(tmp_path / "film.mp4", rate=100)
    begin = time.monotonic()
    found = units_of(open_stream(str(tmp_path / "film.mp4"), loop=True), most=41)
    assert len(found) == 41
    assert time.monotonic() - begin >= 0.35, "40 pictures at 100 Hz are no burst"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("/nowhere/film.mp4", "neither a device, a URL nor a file"),
        ("/dev/video99", "no camera /dev/video99"),
        ("gopher://camera", "gopher:// is no source of video"),
    ],
)
def test_what_is_no_source_is_refused(text: str, words: str) -> None:
    with pytest.raises(BadConfig, match=words):
        open_stream(text)


def test_garbage_and_another_codec_are_said(tmp_path: Path) -> None:
    path = tmp_path / "film.ts"
    path.write_bytes(os.urandom(100_000))
    with pytest.raises(Lost):
        units_of(Contained(str(path), paced=True))
    film(tmp_path / "film.mkv", codec="mpeg4")
    with pytest.raises(Lost, match=r"mpeg4: expected H\.264"):
        units_of(Contained(str(tmp_path / "film.mkv"), paced=True))
    with pytest.raises(Lost, match=r"rtsp://127\.0\.0\.1:9/x"):
        units_of(Contained("rtsp://user:secret@127.0.0.1:9/x"))


@pytest.mark.parametrize("password", ["secret", "se/cret", "sec@ret", "s@/cr:et"])
def test_no_password_is_in_a_sources_name(password: str) -> None:
    assert Contained(f"rtsp://user:{password}@127.0.0.1:9/x").words == "rtsp://127.0.0.1:9/x"


def test_what_no_encoder_takes_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = open_stream("clock:64x64@20")
    monkeypatch.setattr(av.CodecContext, "create", fails)
    with pytest.raises(Lost, match="encoded here: no encoder"):
        next(stream.shots(threading.Event()))


def fails(*args: object) -> None:
    raise ValueError("no encoder")


def test_a_camera_that_vanishes_comes_back(tmp_path: Path) -> None:
    path, said, came = tmp_path / "film.ts", list[str](), list[Encoded]()
    made = film(path)
    path.rename(tmp_path / "gone.ts")
    stream = Contained(str(path), paced=True, loop=True)
    stream.check = lambda: None  # type: ignore[method-assign]  # it was there when it was opened
    feed = Feed(stream, came.append, lambda: None, said.append, 0.1)
    try:
        wait_until(lambda: bool(feed.lost), "the loss")
        (tmp_path / "gone.ts").rename(path)
        wait_until(lambda: len(came) > len(made), "its units")
        assert not feed.lost
        assert "opened again" in said[0] and "come again" in said[1]
        assert came[0].key, "it begins with a key frame"
    finally:
        feed.close()


def test_parameter_sets_are_repeated_and_what_is_of_no_use_left_out() -> None:
    sets = ParameterSets()
    assert sets.unit(joined(b"\x65\x88")) is None, "nobody could begin here"
    data, key = sets.unit(joined(b"\x09\xf0", SPS, PPS, b"\x65\x88")) or (b"", False)
    assert (nal_units(data), key) == ([SPS, PPS, b"\x65\x88"], True)
    data, key = sets.unit(joined(b"\x65\x99", b"\x0c\xff\x80")) or (b"", False)
    assert (nal_units(data), key) == ([SPS, PPS, b"\x65\x99"], True)
    assert sets.unit(joined(b"\x41\x9a")) == (b"\x00" + joined(b"\x41\x9a"), False)
    data, _ = ParameterSets(joined(SPS, PPS)).unit(joined(b"\x65\x88")) or (b"", False)
    assert nal_units(data)[:2] == [SPS, PPS], "those that came beside the stream"


def test_a_device_is_told_its_bits_and_asked_for_key_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The kernel's part is played: a device that takes what it is told, and one that has no such control."""
    path, told, refuses = tmp_path / "video7", list[tuple[int, int]](), [False]
    path.touch()

    def ioctl(file: int, request: int, data: bytes) -> bytes:
        if refuses[0]:
            raise OSError(22, "Invalid argument")
        assert request == 0xC008561C
        told.append((int.from_bytes(data[:4], "little"), int.from_bytes(data[4:], "little", signed=True)))
        return data

    monkeypatch.setattr("fcntl.ioctl", ioctl)
    device = Device(str(path), 30.0, (1280, 720), 0.0)
    device.check()
    assert device.options() == {"input_format": "h264", "video_size": "1280x720", "framerate": "30"}
    assert device.aim(1e6) and device.aim(1.01e6) and device.aim(2e6) and device.aim(1e9)
    device.want_key()
    assert told == [(0x9909CF, 1_000_000), (0x9909CF, 2_000_000), (0x9909CF, 20_000_000), (0x9909E5, 1)]
    refuses[0] = True
    assert not device.aim(3e6)
    with pytest.raises(Lost):
        units_of(device)  # a file is no device


def test_pictures_are_encoded_with_a_clock_in_them() -> None:
    found, codec = units_of(Encoding(ClockSource(640, 360, 50.0), 50.0, stamped=True), most=5), None
    codec = av.CodecContext.create("h264", "r")
    shown = [frame for unit in found for frame in codec.decode(av.Packet(unit.data))] + codec.decode(None)
    for unit, frame in zip(found, shown, strict=True):
        row = frame.to_ndarray(format="gray")[STAMP_PX // 2]
        bits = [row[STAMP_PX * i + STAMP_PX // 2] > 127 for i in range(STAMP_BITS)]
        assert sum(bit << (STAMP_BITS - 1 - i) for i, bit in enumerate(bits)) == int(unit.t * 1e3) % (1 << STAMP_BITS)
    image = np.zeros((20, 100, 3), np.uint8)
    stamp(image, 1e9)  # a narrow picture holds a part of it


def test_an_encoder_does_as_it_is_told() -> None:
    class Source(ClockSource):
        def shots(self, closed: threading.Event) -> Iterator[Any]:
            for number, shot in enumerate(super().shots(closed)):
                if number == 3:
                    stream.want_key()
                if number == 6:
                    stream.aim(300e3)
                stream.wanted = number not in (8, 9)
                yield shot

    stream = Encoding(Source(320, 240, 200.0), 200.0)
    assert [unit.key for unit in units_of(stream, most=10)] == [n in (0, 3, 6, 8) for n in range(10)]
    assert stream.words == "a test picture, 320x240 at 200 Hz, encoded here"
