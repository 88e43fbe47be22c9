"""What a hostile or broken link may not do: take the vehicle's place, grow without bound, leak, or stop anything."""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from zmav import adapter, keys
from zmav.links.base import Backoff
from zmav.mavlink import Packer, encode, load_dialect
from zmav.onboard import Onboard

if TYPE_CHECKING:
    from tests.conftest import Net, StartOnboard
    from tests.services.conftest import Bench, StartBench

PATIENCE_S = 30.0
INVENTED, AT_ONCE = 5000, 100


def invented(n: int) -> bytes:
    """The n-th frame of a message that nobody knows, from a system that does not exist."""
    source = bytes((0, 1 + n % 250, n % 7))
    return b"\xfd\x02\0\0" + source + (20_000 + n).to_bytes(3, "little") + b"\x01\x02\x12\x34"


def declared(vehicle: Onboard) -> int:
    """The publishers that its frames have."""
    return len(vehicle.adapter._publishers)


async def flood(b: Bench, frames: list[bytes]) -> None:
    """Send them all, some at a time, so that no datagram is lost for want of room; every one reaches the ground."""
    came = b.ground.samples("zmav/demo/quad1/mav/rx/**")
    await b.state(lambda s: True, "a moment")
    for first in range(0, len(frames), AT_ONCE):
        some = frames[first : first + AT_ONCE]
        for frame in some:
            b.peer.raw(frame)
        wanted = set(some)
        await came.until(lambda wanted=wanted: wanted <= {raw for _, raw in came.items}, "these")  # type: ignore[misc]
        came.items.clear()


async def test_invented_ids_take_no_room_from_the_vehicle(bench: StartBench) -> None:
    b = await (await bench()).connected()
    own = declared(b.vehicle)
    await flood(b, [invented(n) for n in range(INVENTED)])
    assert declared(b.vehicle) == own + adapter.MAX_UNKNOWN
    assert b.vehicle.adapter.splitter.counters.unknown == INVENTED
    # What the vehicle says for the first time now has its place all the same.
    b.peer.send("ATTITUDE", yaw=0.5)
    await b.state(lambda s: s["attitude"] and s["attitude"]["yaw"] == 0.5, "attitude")
    assert declared(b.vehicle) == own + adapter.MAX_UNKNOWN + 1
    assert (await b.ground.do("arm", ready_timeout=0)).result == {"armed": True}
    assert not [e for e in b.events.objects() if e["kind"] in ("fault", "clash")]


async def test_invented_systems_are_bounded_too(bench: StartBench) -> None:
    b = await (await bench()).connected()
    fields = {"type": 2, "autopilot": 3, "base_mode": 1, "custom_mode": 4, "system_status": 4}
    frames = [encode(b.peer.dialect, "HEARTBEAT", fields, sysid=2 + n % 250, compid=1 + n // 250) for n in range(1250)]
    await flood(b, frames)
    assert declared(b.vehicle) == adapter.MAX_STREAMS
    state = await b.state(lambda s: True, "another state")
    assert (state["sysid"], state["connected"], state["clash"]) == (1, True, None)


class Dropper:
    """A TCP server that sends a heartbeat and half of another, and hangs up, so many times; then it stays."""

    def __init__(self, times: int) -> None:
        self.packer = Packer(load_dialect(), 1, 1)
        self.server = socket.create_server(("127.0.0.1", 0))
        self.url = f"tcp:127.0.0.1:{self.server.getsockname()[1]}"
        self.last: socket.socket | None = None
        self._times = times
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def heartbeat(self) -> bytes:
        return self.packer.pack("HEARTBEAT", type=2, autopilot=3, base_mode=1)

    def _serve(self) -> None:
        for _ in range(self._times):
            connection, _address = self.server.accept()
            with connection:
                connection.sendall(self.heartbeat() + self.heartbeat()[:10])
        self.last, _address = self.server.accept()
        self.last.settimeout(PATIENCE_S)
        self.last.sendall(self.heartbeat())

    def close(self) -> None:
        self._thread.join(PATIENCE_S)
        if self.last is not None:
            self.last.close()
        self.server.close()


@pytest.fixture
def dropper(monkeypatch: pytest.MonkeyPatch) -> Iterator[Dropper]:
    monkeypatch.setattr(Backoff, "next", lambda self: 0.005)
    server = Dropper(50)
    yield server
    server.close()


def descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def link_threads() -> list[str]:
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("link ")]


async def test_a_link_that_opens_and_closes_fifty_times(net: Net, onboard: StartOnboard, dropper: Dropper) -> None:
    session, endpoint = net.router()
    ground = net.ground(endpoint)
    frames, events = ground.samples("zmav/demo/quad1/mav/rx/**"), ground.samples(keys.EVENT)
    await net.linked(session, keys.RX.key("demo", "quad1", sys=1, comp=1, msg="HEARTBEAT"))
    before = descriptors()
    vehicle = await onboard(session, dropper.url)
    await frames.until(lambda: len(frames.items) >= 51, "every heartbeat")
    assert descriptors() <= before + 5  # the link's, both ends of it
    assert {key for key, _ in frames.items} == {"zmav/demo/quad1/mav/rx/1/1/HEARTBEAT"}
    counters, link = vehicle.adapter.splitter.counters, vehicle.adapter.link
    assert (len(frames.items), counters.frames, counters.garbage, counters.bad_crc) == (51, 51, 500, 0)
    assert (link.counters.opens, link.state.value) == (51, "up")
    assert link_threads() == [f"link {dropper.url}"]
    # The reopened link carries both ways, and the ground was not flooded with what it did.
    assert dropper.last is not None
    assert (await asyncio.to_thread(dropper.last.recv, 4096))[0] == 0xFD
    assert 1 <= sum(e["kind"] == "link" for e in events.objects()) <= 10
    await onboard.close(vehicle)
    assert link_threads() == []
    dropper.close()
    assert descriptors() < before  # its listening socket is gone, too
