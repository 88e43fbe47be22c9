"""The adapter: frames out to their keys, frames in that are fit, and what a hostile or broken link may not do."""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import AsyncIterator
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest
import zenoh

from tests.waiting import until
from zmav import keys
from zmav.adapter import Adapter, LinkChanged
from zmav.bus import Bus
from zmav.errors import BadKey, Clash
from zmav.forwarding import FrameForwarder
from zmav.links import Link, LinkState, UdpInLink, open_link
from zmav.mavlink import Frame, encode, load_dialect, parse_frame
from zmav.mavlink.checksum import checksum
from zmav.services.link.port import FrameRefused
from zmav.trust.gate import anybody

if TYPE_CHECKING:
    from tests.conftest import Ground, Net, Samples

DIALECT = load_dialect()


PATIENCE_S = 30.0
HEARTBEAT = {"type": 2, "autopilot": 3, "base_mode": 1, "custom_mode": 4, "system_status": 4}


class Rig(NamedTuple):
    """An adapter of quad1 on a UDP link, the autopilot's socket, and the ground; ``refused`` is what it refused."""

    adapter: Adapter
    session: zenoh.Session
    ground: Ground
    frames: Samples
    autopilot: socket.socket
    refused: list[str]
    blocked: threading.Event
    """set: no frame may be sent"""

    async def came(self, *frames: bytes) -> list[tuple[str, bytes]]:
        """Send these from the autopilot, and wait until so many more are on the ground."""
        before = len(self.frames.items)
        for frame in frames:
            self.autopilot.send(frame)
        await self.frames.until(lambda: len(self.frames.items) >= before + len(frames), f"{len(frames)} frames")
        return self.frames.items[before:]

    def put(self, data: bytes, msg: str, sys: object = 1, comp: object = 1) -> None:
        self.ground.put(keys.TX, data, sys=sys, comp=comp, msg=msg)

    async def all_refused(self, count: int) -> None:
        """Wait until so many were refused; what was put before is done with then."""
        while len(self.refused) < count:
            await self.came(heartbeat())

    async def received(self) -> bytes:
        """The next datagram that the autopilot is sent."""
        return await asyncio.to_thread(self.autopilot.recv, 65536)


@pytest.fixture
async def rig(net: Net) -> AsyncIterator[Rig]:
    session, endpoint = net.router()
    ground = net.ground(endpoint)
    frames = ground.samples("zmav/*/*/mav/rx/**")
    await net.linked(session, rx(1, 1, "HEARTBEAT"))
    link = open_link("udpin:127.0.0.1:0")
    assert isinstance(link, UdpInLink)
    adapter = Adapter(session, "demo", "quad1", link, DIALECT, Bus())
    listening, refused, blocked = threading.Event(), list[str](), threading.Event()

    def may_send(frame: Frame) -> None:
        if blocked.is_set():
            raise Clash("refused: two of one name")

    forwarder = FrameForwarder(adapter, prove=anybody, may_send=may_send)
    adapter.bus.on(FrameRefused, lambda told: refused.append(told.text))
    adapter.bus.on(LinkChanged, lambda told: listening.set() if "listening" in told.text else None)
    forwarder.start()
    adapter.start()
    assert await asyncio.to_thread(listening.wait, PATIENCE_S)
    assert link.local_address is not None
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as autopilot:
        autopilot.settimeout(PATIENCE_S)
        autopilot.connect(link.local_address)
        yield Rig(adapter, session, ground, frames, autopilot, refused, blocked)
        forwarder.close()
        adapter.close()
    assert link.state is LinkState.CLOSED


def rx(sys: int, comp: int, msg: str) -> str:
    return f"zmav/demo/quad1/mav/rx/{sys}/{comp}/{msg}"


def heartbeat(sysid: int = 1, compid: int = 1, **more: Any) -> bytes:
    return encode(DIALECT, "HEARTBEAT", HEARTBEAT, sysid=sysid, compid=compid, **more)


def command(system: int = 1, component: int = 1) -> bytes:
    fields = {f"param{n}": 0 for n in range(1, 8)} | {"command": 400, "confirmation": 0}
    fields |= {"target_system": system, "target_component": component}
    return encode(DIALECT, "COMMAND_LONG", fields, sysid=255, compid=190)


def set_mode(system: int) -> bytes:
    fields = {"target_system": system, "base_mode": 1, "custom_mode": 4}
    return encode(DIALECT, "SET_MODE", fields, sysid=255, compid=190)


def unknown(msgid: int, sysid: int = 1, compid: int = 1) -> bytes:
    """A frame of a message that the dialect lacks."""
    return bytes((0xFD, 2, 0, 0, 0, sysid, compid)) + msgid.to_bytes(3, "little") + b"\x01\x02\x12\x34"


def signed(frame: bytes) -> bytes:
    """The frame with a signature (which is not checked) and a true checksum."""
    message = DIALECT.by_id[int.from_bytes(frame[7:10], "little")]
    body = frame[1:2] + b"\x01" + frame[3 : 10 + frame[1]]
    return b"\xfd" + body + checksum(body, message.crc_extra).to_bytes(2, "little") + bytes(range(13))


async def test_every_frame_on_its_key_as_it_came(rig: Rig) -> None:
    sent = {
        rx(1, 1, "HEARTBEAT"): heartbeat(),
        rx(7, 191, "HEARTBEAT"): heartbeat(7, 191, version=1),
        rx(255, 190, "COMMAND_LONG"): command(),
        rx(255, 190, "SET_MODE"): signed(set_mode(1)),
        rx(1, 1, "UNKNOWN_44010"): unknown(44010),
        rx(1, 1, "UNKNOWN_16777215"): unknown(0xFFFFFF),
    }
    assert await rig.came(*sent.values()) == list(sent.items())
    # Again, the other way round: each is known by now.
    assert await rig.came(*reversed(sent.values())) == list(reversed(sent.items()))
    # A datagram of several, and frames cut anywhere.
    rig.autopilot.send(b"".join(sent.values()))
    stream = b"".join(sent.values())
    for at in range(0, len(stream), 7):
        rig.autopilot.send(stream[at : at + 7])
    await rig.frames.until(lambda: len(rig.frames.items) == 24, "all of them")
    assert rig.frames.items[12:] == list(sent.items()) * 2
    assert rig.adapter.names() == ["COMMAND_LONG", "HEARTBEAT", "SET_MODE", "UNKNOWN_16777215", "UNKNOWN_44010"]


GOOD = {
    "command": (command(), "COMMAND_LONG", 1, 1),
    "to all components": (command(1, 0), "COMMAND_LONG", 1, 0),
    "to all systems": (command(0, 0), "COMMAND_LONG", 0, 0),
    "names a system only": (set_mode(1), "SET_MODE", 1, 1),
    "names nobody": (heartbeat(255, 190), "HEARTBEAT", 1, 1),
    "broadcast": (heartbeat(255, 190), "HEARTBEAT", 0, 0),
    "MAVLink 1": (heartbeat(255, 190, version=1), "HEARTBEAT", 0, 0),
    "signed": (signed(command()), "COMMAND_LONG", 1, 1),
    "unknown": (unknown(44011, 255, 190), "UNKNOWN_44011", 1, 1),
}


async def test_fit_frames_reach_the_link_unchanged(rig: Rig) -> None:
    await rig.came(heartbeat())
    for data, msg, system, component in GOOD.values():
        rig.put(data, msg, system, component)
        assert await rig.received() == data
    assert rig.refused == []
    rig.put(b"the end", "COMMAND_LONG")
    await rig.all_refused(1)
    assert (rig.adapter.tx.frames, rig.adapter.tx.refused, rig.adapter.tx.dropped) == (len(GOOD), 1, 0)


BAD = [
    (b"", "HEARTBEAT", 1, 1, "does not begin with"),
    (b"nonsense", "HEARTBEAT", 1, 1, "does not begin with"),
    (heartbeat() + heartbeat(), "HEARTBEAT", 1, 1, "it has 42 bytes, but 21 by its header"),
    (heartbeat()[:-1], "HEARTBEAT", 1, 1, "it has 20 bytes, but 21"),
    (heartbeat()[:5], "HEARTBEAT", 1, 1, "too few"),
    (heartbeat()[:-1] + b"\0", "HEARTBEAT", 1, 1, "the checksum of HEARTBEAT is"),
    (heartbeat()[:2] + b"\x02" + heartbeat()[3:], "HEARTBEAT", 1, 1, "flags 0x02"),
    (heartbeat(), "ATTITUDE", 1, 1, "it holds HEARTBEAT"),
    (unknown(44010), "UNKNOWN_44011", 1, 1, "it holds UNKNOWN_44010"),
    (unknown(44010), "HEARTBEAT", 1, 1, "it holds UNKNOWN_44010"),
    (command(2, 1), "COMMAND_LONG", 1, 1, "its target_system is 2"),
    (command(0, 0), "COMMAND_LONG", 1, 1, "its target_system is 0"),
    (command(1, 1), "COMMAND_LONG", 0, 0, "its target_system is 1"),
    (command(1, 5), "COMMAND_LONG", 1, 1, "its target_component is 5"),
    (command(1, 1), "COMMAND_LONG", 1, 0, "its target_component is 1"),
    (set_mode(2), "SET_MODE", 1, 1, "its target_system is 2"),
    (command(9, 1), "COMMAND_LONG", 9, 1, "no system 9 is on this link"),
    (heartbeat(), "HEARTBEAT", 9, 1, "no system 9 is on this link"),
    (heartbeat(), "HEARTBEAT", 999, 1, "no system 999 is on this link"),
    (heartbeat(), "HEARTBEAT", "one", 1, "must be numbers"),
    (heartbeat(), "HEARTBEAT", 1, "-1", "must be numbers"),
    (heartbeat(), "HEARTBEAT", "01", 1, "must be numbers"),
    (heartbeat(), "HEARTBEAT", "1_0", 1, "must be numbers"),
    (heartbeat(), "HEARTBEAT", "*", "*", "must be numbers"),
]


async def test_unfit_frames_are_refused_counted_and_said(rig: Rig) -> None:
    await rig.came(heartbeat(), unknown(500, sysid=9))  # what nobody can check makes no system
    for data, msg, system, component, _ in BAD:
        rig.put(data, msg, system, component)
    rig.ground.session.delete("zmav/demo/quad1/mav/tx/1/1/HEARTBEAT")
    rig.ground.session.put("zmav/**", b"to everybody")
    rig.put(command(), "COMMAND_LONG")
    rig.put(b"the end", "COMMAND_LONG")
    assert await rig.received() == command()  # the only one
    await rig.all_refused(len(BAD) + 3)
    assert [words for *_, words in BAD if not any(words in said for said in rig.refused)] == []
    for (*_, words), said in zip(BAD, rig.refused, strict=False):
        assert words in said
        assert said.startswith("frame on zmav/demo/quad1/mav/tx/")
    assert (rig.adapter.tx.refused, rig.adapter.tx.frames) == (len(BAD) + 3, 1)


async def test_nothing_passes_that_is_not_admitted(rig: Rig) -> None:
    await rig.came(heartbeat())

    rig.blocked.set()
    for _ in range(3):
        rig.put(command(), "COMMAND_LONG")
    rig.put(b"and nonsense", "COMMAND_LONG")
    await rig.all_refused(4)
    rig.blocked.clear()
    rig.put(heartbeat(255), "HEARTBEAT")
    assert await rig.received() == heartbeat(255)
    assert [("two of one name" in said) for said in rig.refused] == [True] * 3 + [False]


async def test_with_nobody_on_the_link_frames_are_dropped(rig: Rig) -> None:
    rig.put(heartbeat(255), "HEARTBEAT", 0, 0)
    rig.put(b"the end", "HEARTBEAT", 0, 0)
    while not rig.refused:
        await asyncio.sleep(0.01)
    assert (rig.adapter.tx.frames, rig.adapter.tx.refused, rig.adapter.tx.dropped) == (0, 1, 1)
    assert rig.adapter.send("HEARTBEAT") is False


async def test_what_services_use(rig: Rig) -> None:
    a = rig.adapter
    assert a.latest("HEARTBEAT", (1, 1)) is None
    assert a.newest("HEARTBEAT") is None
    heard: list[Frame] = []
    other: list[Frame] = []
    stop, _ = a.listen("HEARTBEAT", heard.append), a.listen("HEARTBEAT", other.append)
    await rig.came(heartbeat(), heartbeat(2), heartbeat(seq=1), unknown(44010))
    stop()
    await rig.came(heartbeat(2, seq=1), unknown(44010))  # a listener is called after the put: by the next frame, it was
    assert [f.data for f in heard] == [heartbeat(), heartbeat(2), heartbeat(seq=1)]
    assert len(other) == 4
    newest, mine = a.newest("HEARTBEAT"), a.latest("HEARTBEAT", (1, 1))  # in this order: an age is as of its asking
    assert mine is not None and newest is not None
    assert (mine.frame.data, mine.total) == (heartbeat(seq=1), 2)
    assert (newest.frame.data, newest.total) == (heartbeat(2, seq=1), 2)
    assert mine.age >= newest.age >= 0.0
    strange = a.newest("UNKNOWN_44010")
    assert strange is not None
    assert strange.frame.data == unknown(44010)


async def test_it_speaks_with_one_row_of_sequence_numbers(rig: Rig) -> None:
    await rig.came(heartbeat())
    rig.adapter.speak_as(7)
    assert rig.adapter.address == (7, 191)
    for seq in range(3):
        rig.adapter.speak_as(7)
        assert rig.adapter.send("HEARTBEAT", type=18)
        frame = parse_frame(await rig.received(), DIALECT)
        assert ((frame.sysid, frame.compid), frame.seq) == ((7, 191), seq)


@pytest.mark.parametrize(("fleet", "name"), [("demo", "Quad 1"), ("demo", ""), ("d/e", "quad1"), ("demo", "*")])
def test_names_that_cannot_stand_in_a_key(net: Net, fleet: str, name: str) -> None:
    session, _ = net.router()
    with pytest.raises(BadKey, match="cannot stand in a key"):
        Adapter(session, fleet, name, open_link("udpin:127.0.0.1:0"), DIALECT, Bus())


async def test_closing_in_any_order(net: Net) -> None:
    session, _ = net.router()
    link: Link = open_link("udpin:127.0.0.1:0")
    never_started = Adapter(session, "demo", "quad2", open_link("udpin:127.0.0.1:0"), DIALECT, Bus())
    adapter = Adapter(session, "demo", "quad1", link, DIALECT, Bus())
    adapter.start()
    session.close()
    for each in (adapter, adapter, never_started):
        each.close()
    assert link.state is LinkState.CLOSED


async def test_frames_are_put_only_where_somebody_reads(net: Net) -> None:
    session, endpoint = net.router()
    link = open_link("udpin:127.0.0.1:0")
    adapter = Adapter(session, "demo", "quad1", link, DIALECT, Bus())
    adapter.start()
    try:
        assert not adapter.read
        for key in ("zmav/*/*/mav/rx/*/*/ATTITUDE", "zmav/demo/**", "zmav/demo/quad1/mav/rx/1/1/HEARTBEAT"):
            ground = net.ground(endpoint)
            ground.samples(key)
            await until(lambda: adapter.read)
            ground.session.close()
            await until(lambda: not adapter.read)
    finally:
        adapter.close()


async def test_what_may_be_answered_hurries_the_link(net: Net) -> None:
    session, _ = net.router()
    adapter = Adapter(session, "demo", "quad1", open_link("udpin:127.0.0.1:0"), DIALECT, Bus())
    adapter.send("HEARTBEAT", **HEARTBEAT)
    assert adapter.spoke == 0.0 and not adapter.link._hurry.acquire(blocking=False), "nothing answers a heartbeat"
    adapter.send("PARAM_REQUEST_LIST", target_system=1, target_component=1)
    assert adapter.spoke > 0.0 and adapter.link._hurry.acquire(blocking=False)
