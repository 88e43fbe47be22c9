"""Units of video at a reader: what is let in, what is dropped, and that nothing grows."""

from __future__ import annotations

import asyncio
import contextlib
import random
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import av
import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

import zmav
from tests.waiting import until
from zmav import keys
from zmav.errors import BadInput, BadMessage
from zmav.process import free_port
from zmav.session import SessionSettings
from zmav.vision.assembler import Whole
from zmav.vision.chunks import VIDEO, split
from zmav.vision.mux import Muxer, sdp
from zmav.vision.video import MOST_NALS, MOST_WAITING, START, Unit, Units, VideoReader, nal_units, packed, unpacked

if TYPE_CHECKING:
    from tests.conftest import Net

SPS, PPS = START + b"\x67\x42\xc0\x1e", START + b"\x68\xce\x3c\x80"
KEY, NEXT = SPS + PPS + START + b"\x65\x88\x84", START + b"\x41\x9a\x24"


def whole(data: bytes, seq: int = 0) -> Whole:
    return Whole(data, seq, 5.0, 1280, 720, 0)


def unit(seq: int, key: bool = False, data: bytes = NEXT) -> Unit:
    return Unit(KEY if key else data, key, 5.0 + seq / 30, seq, 1280, 720, 5.0)


async def patient(session: zenoh.Session) -> zenoh.Publisher:
    """Of a test's own chunks none is dropped, and none comes before somebody listens."""
    key = keys.VIDEO.key("demo", "quad1", camera="down")
    publisher = session.declare_publisher(key, congestion_control=zenoh.CongestionControl.BLOCK)
    await until(lambda: publisher.matching_status.matching, "a reader")  # type: ignore[attr-defined]
    return publisher


def test_a_unit_is_what_was_packed() -> None:
    for data, key in ((KEY, True), (NEXT, False), (KEY.replace(START, b"\x00" + START), True)):
        found = unpacked(whole(packed(data, key)), 6.0)
        assert (found.data, found.key, found.width, found.arrived) == (data, key, 1280, 6.0)
    assert [each[0] & 0x1F for each in nal_units(KEY)] == [7, 8, 5]
    assert nal_units(b"\x00" + START + b"\x41\x01\x00" + START + b"\x41\x02") == [b"\x41\x01", b"\x41\x02"]
    with pytest.raises(BadInput, match="cannot be sent"):
        packed(b"", False)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\xff\xd8\xff\xe0 a JPEG",
        START,
        START + START + b"\x41",
        START + b"\xc1 forbidden bit",
        START + b"\x1c a fragment of RTP, which no stream holds",
        NEXT * (MOST_NALS + 1),
        START * 300_000,
    ],
)
def test_what_is_no_unit_is_not_let_in(data: bytes) -> None:
    with pytest.raises(BadMessage):
        unpacked(whole(b"\0" + data), 6.0)


@given(data=st.binary(max_size=200).map(lambda data: data.replace(b"\x02", START)))
def test_whatever_comes_is_let_in_or_refused(data: bytes) -> None:
    with contextlib.suppress(BadMessage):
        assert all(each and START not in each for each in nal_units(START + data))


def test_a_key_frame_needs_its_parameter_sets() -> None:
    with pytest.raises(BadMessage):
        unpacked(whole(packed(START + b"\x65\x88", True)), 6.0)


async def test_whoever_is_slow_gets_the_next_key_frame_and_nothing_grows() -> None:
    units = Units()
    units.put(unit(0))
    assert (units.waits, units.dropped) == (True, 1)
    units.put(unit(1, key=True))
    for seq in range(2, 2 + 3 * MOST_WAITING):
        units.put(unit(seq))
    assert units.waits
    assert units.dropped == 1 + 3 * MOST_WAITING + 1, "all that waited, too"
    units.put(unit(500, key=True))
    assert (await units.get()).seq == 500
    for seq in range(501, 510):
        units.put(unit(seq, data=b"\0" * 1_000_000))
    assert units.dropped > 4, "bounded by bytes, too"
    units.end()
    with pytest.raises(EOFError):
        while True:
            await units.get()


async def test_a_hostile_vehicles_chunks_reach_nobody(net: Net) -> None:
    session, endpoint = net.router()
    rng = random.Random(2)
    async with (
        zmav.open(settings=SessionSettings(connect=[endpoint])) as z,
        VideoReader(z, "quad1") as reader,
    ):
        with reader.units() as units:
            put = await patient(session)
            hostile = [START * 300, b"", rng.randbytes(5000), START + b"\x65", bytes(999_000)]
            for seq, data in enumerate(hostile):
                for chunk in split(b"\x01" + data, sender=1, seq=seq, t=5.0, size=(1, 1), code=VIDEO):
                    put.put(chunk)
                put.put(rng.randbytes(500))
            await until(lambda: reader.assembler.bad >= 2 * len(hostile), "the garbage")
            for seq, each in enumerate((NEXT, KEY, NEXT), start=100):
                for chunk in split(packed(each, each == KEY), sender=1, seq=seq, t=5.0, size=(1, 1), code=VIDEO):
                    put.put(chunk)
            assert [(await units.get()).seq for _ in range(2)] == [101, 102]
            assert (reader.came, units.dropped) == (3, 1)


async def test_what_is_torn_is_waited_out_and_asked_for(net: Net) -> None:
    session, endpoint = net.router()
    async with (
        zmav.open(settings=SessionSettings(connect=[endpoint])) as z,
        VideoReader(z, "quad1") as reader,
    ):
        wishes = list[bool]()
        key = keys.VIDEO_REPORT.key("demo", "quad1", camera="down", reader="*")
        session.declare_subscriber(key, lambda sample: wishes.append(b'"waits":true' in sample.payload.to_bytes()))
        put = await patient(session)

        def send(seq: int, key: bool) -> None:
            for chunk in split(packed(KEY if key else NEXT, key), sender=1, seq=seq, t=5.0, size=(1, 1), code=VIDEO):
                put.put(chunk)

        with reader.units() as units:
            for seq, is_key in ((0, True), (1, False), (3, False), (4, False), (5, True), (6, False)):
                send(seq, is_key)
                if seq == 4:
                    await until(lambda: True in wishes, "a wish for a key frame")
            await until(lambda: reader.came == 6, "all units")
            found = [(await units.get()).seq for _ in range(2)]
            assert found == [5, 6], "what waited with nothing to follow it is of no use"
            await until(lambda: wishes[-1] is False, "the end of the wish")


def encoded(count: int) -> list[bytes]:
    codec = av.CodecContext.create("libx264", "w")
    codec.width, codec.height, codec.pix_fmt = 320, 240, "yuv420p"
    codec.framerate, codec.time_base = Fraction(30, 1), Fraction(1, 30)
    codec.options = {"tune": "zerolatency", "preset": "ultrafast"}
    found = []
    for number in range(count):
        frame = av.VideoFrame(320, 240, "yuv420p")
        frame.pts = number
        found += [bytes(packet) for packet in codec.encode(frame)]
    return found


def test_a_file_holds_what_came_and_times_go_on(tmp_path: Path) -> None:
    path, units = tmp_path / "down.ts", encoded(12)
    times = [5.0 + n / 30 for n in range(4)] + [4.0 + n / 30 for n in range(4)] + [1e9 + n / 30 for n in range(4)]
    sent = [Unit(data, n == 0, t, n, 320, 240, t) for n, (data, t) in enumerate(zip(units, times, strict=True))]
    muxer = Muxer(str(path), sent[0])
    for each in sent:
        muxer.add(each)
    muxer.close()
    with av.open(str(path)) as container:
        packets = [packet for packet in container.demux(video=0) if packet.size]
        stamps = [packet.pts for packet in packets if packet.pts is not None]
    assert stamps == sorted(set(stamps)) and len(stamps) == 12
    assert stamps[-1] - stamps[0] < 2 * 90_000, "a clock that was set leaves no hole"
    with av.open(str(path)) as container:
        assert sum(1 for _ in container.decode(video=0)) == 12


def test_where_nobody_can_write_is_said() -> None:
    with pytest.raises(BadInput, match=r"/nowhere/at/all\.ts"):
        Muxer("/nowhere/at/all.ts", unit(0, key=True))
    text = sdp("rtp://127.0.0.1:5600")
    assert "m=video 5600 RTP/AVP 96\r\n" in text
    assert "c=IN IP4 127.0.0.1\r\n" in text


@pytest.mark.parametrize("scheme", ["udp", "tcp"])
async def test_other_programs_read_it(scheme: str) -> None:
    port = free_port()
    url = f"{scheme}://127.0.0.1:{port}" + ("?listen=1" if scheme == "tcp" else "")

    def read() -> int:
        with av.open(url, format="mpegts", timeout=30.0) as container:
            return next(iter(container.decode(video=0))).width

    reading = asyncio.create_task(asyncio.to_thread(read))
    await asyncio.sleep(0.5)
    units = [Unit(data, n == 0, 5.0 + n / 30, n, 320, 240, 5.0) for n, data in enumerate(encoded(60))]
    muxer = await asyncio.to_thread(Muxer, f"{scheme}://127.0.0.1:{port}", units[0])
    for each in units:
        with contextlib.suppress(BadInput):  # it has seen enough, and is gone
            await asyncio.to_thread(muxer.add, each)
        await asyncio.sleep(0.005)
    with contextlib.suppress(Exception):
        await asyncio.to_thread(muxer.close)
    assert await reading == 320


async def test_rtp_is_what_the_description_says(tmp_path: Path) -> None:
    loop = asyncio.get_running_loop()
    came: list[bytes] = []

    class Hear(asyncio.DatagramProtocol):
        def datagram_received(self, data: bytes, addr: object) -> None:
            came.append(data)

    transport, _ = await loop.create_datagram_endpoint(Hear, local_addr=("127.0.0.1", 0))
    port = transport.get_extra_info("sockname")[1]
    units = [Unit(data, n == 0, 5.0 + n / 30, n, 320, 240, 5.0) for n, data in enumerate(encoded(6))]
    muxer = await asyncio.to_thread(Muxer, f"rtp://127.0.0.1:{port}", units[0])
    for each in units:
        await asyncio.to_thread(muxer.add, each)
    await asyncio.to_thread(muxer.close)
    await until(lambda: len(came) >= 6, "packets of RTP")
    transport.close()
    assert {data[1] & 0x7F for data in came if data[0] >> 6 == 2} == {96}
