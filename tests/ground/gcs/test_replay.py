"""A recording beside the vehicle that it is of: same uid, same system id, and nobody takes the one for the other."""

from __future__ import annotations

import asyncio
import struct
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh

import zmav
from tests.cli.conftest import Here
from tests.ground.gcs.conftest import PATIENCE_S, Scene
from tests.ground.gcs.fleet import Fleet
from zmav import keys, wire
from zmav.errors import BadConfig, Refused
from zmav.mavlink import load_dialect
from zmav.onboard import Onboard, OnboardSettings
from zmav.session import SessionSettings, open_session
from zmav.sim import VehicleSpec

ARM, REQUEST_MESSAGE, AUTOPILOT_VERSION = 400, 512, 148


class Listener:
    """What comes on a key expression; :meth:`until` waits for it."""

    def __init__(self, session: zenoh.Session, key: str) -> None:
        self.came: list[tuple[str, bytes]] = []
        self._news = threading.Condition()
        self._subscriber = session.declare_subscriber(key, self._on_sample)

    def _on_sample(self, sample: zenoh.Sample) -> None:
        with self._news:
            self.came.append((str(sample.key_expr), sample.payload.to_bytes()))
            self._news.notify_all()

    def until(self, true: Any, what: str) -> None:
        with self._news:
            assert self._news.wait_for(lambda: true(self.came), PATIENCE_S), f"never {what}"


@pytest.fixture
def fleet() -> Iterator[Fleet]:
    with Fleet([VehicleSpec()]) as fleet:
        yield fleet


def record(fleet: Fleet, session: zenoh.Session, path: Path) -> None:
    """A few seconds of v1 on the ground, its uid among them, as the recorder writes them."""
    listener = Listener(session, "zmav/demo/v1/mav/rx/**")
    station = fleet.caller()
    station.to("COMMAND_LONG", command=REQUEST_MESSAGE, param1=AUTOPILOT_VERSION)
    names = {"AUTOPILOT_VERSION": 1, "GLOBAL_POSITION_INT": 10, "HEARTBEAT": 3}
    listener.until(
        lambda came: all(sum(key.endswith(name) for key, _ in came) >= n for name, n in names.items()), "all of it"
    )
    station.close()
    frames = [data for key, data in list(listener.came) if "/rx/1/1/" in key]
    stamps = (1_700_000_000_000_000 + 20_000 * n for n in range(len(frames)))
    path.write_bytes(b"".join(struct.pack(">Q", t) + data for t, data in zip(stamps, frames, strict=True)))


def is_the_same(data: bytes, uid: str | None) -> bool:
    """A state of the same autopilot as the live one, as far as anybody can tell."""
    state = wire.decode(data, wire.VehicleState, "state")
    return bool(state.connected and state.position and (state.sysid, state.uid) == (1, uid))


def test_twenty_of_twenty_commands_reach_the_live_one_and_no_position_is_mixed(fleet: Fleet, tmp_path: Path) -> None:
    session = open_session(SessionSettings(connect=[fleet.endpoint]))
    record(fleet, session, tmp_path / "v1.001.tlog")
    v1 = fleet.vehicle(1)

    async def fly() -> None:
        await v1.arm()
        await v1.takeoff(10.0)

    fleet.run(fly())
    over = threading.Event()

    async def stopped() -> None:
        await asyncio.to_thread(over.wait)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ground.record.replay.until_stopped", stopped)
        states = Listener(session, "zmav/*/old/state")
        replay = threading.Thread(
            target=Here("-e", fleet.endpoint), args=("replay", str(tmp_path / "v1.001.tlog"), "--as", "old", "--loop")
        )
        replay.start()
        try:
            uid = v1.state.uid
            states.until(lambda came: any(is_the_same(data, uid) for _, data in came[-3:]), "heard of the recording")
            fleet.world.pause()
            time.sleep(3.0)  # the vehicle's link has a gap: a bridge may look for another way to it
            fleet.world.resume()
            station = fleet.caller()
            results = [
                station.answer("COMMAND_LONG", "COMMAND_ACK", command=ARM, param1=1.0)["result"] for _ in range(20)
            ]
            assert results == [0] * 20
            station.wait(lambda: len(station.fields("GLOBAL_POSITION_INT", 1)) > 40, "positions")
            heights = [fields["relative_alt"] / 1000.0 for fields in station.fields("GLOBAL_POSITION_INT", 1)]
            assert min(heights) > 5.0, "the recording stands on the ground"
            station.close()
        finally:
            over.set()
            replay.join(PATIENCE_S)
    session.close()


async def test_a_bridge_of_a_recording_shows_it_and_takes_no_order(scene: Scene) -> None:
    """Told to play into any fleet, and bridged by name: what a station says goes nowhere."""
    from ground.gcs.bridge import Bridge, BridgeSettings
    from ground.gcs.options import Options, parse_endpoint
    from ground.gcs.tcp import TcpIn

    told = Listener(scene.router, "zmav/*/*/mav/tx/**")
    dialect = load_dialect()
    async with zmav.open(fleet="demo-replay", connect=[scene.router_endpoint]) as z:
        state = wire.VehicleState(
            t=time.time(),
            fleet="demo-replay",
            name="old",
            instance="x",
            replayed=True,
            connected=True,
            sysid=1,
            compid=1,
            uid="u",
        )
        while z.heard("old", "demo-replay") is None:
            scene.router.put(keys.STATE.key("demo-replay", "old"), wire.encode(state))
            await z.news(0.05)
        ends = (parse_endpoint("tcp", "0", Options()),)
        async with Bridge(z, BridgeSettings(endpoints=ends, streams=False), scene.said.append) as bridge:
            await scene.heard("old is there: system 1, a recording, which takes no orders")
            station = await scene.tcp(bridge)
            (end,) = (each for each in bridge.endpoints if isinstance(each, TcpIn))
            assert end is not None
            station.send("COMMAND_LONG", target_system=1, target_component=1, command=ARM, param1=1.0)
            await station.until(lambda: bool(station.named("COMMAND_ACK")), "that it is denied")
            from zmav.mavlink import decode

            assert decode(station.named("COMMAND_ACK")[0], dialect)["result"] == 2
            key = keys.TX.key("demo-replay", "old", sys=1, comp=1, msg="COMMAND_LONG")
            with pytest.raises(Refused, match="a recording takes no frames"):
                z.put(keys.TX, key, b"x")
            with pytest.raises(Refused, match="a recording: it takes no orders"):
                await z.vehicle("old").arm()
    assert told.came == []


def test_no_vehicle_among_recordings_and_no_recording_among_vehicles(scene: Scene, tmp_path: Path) -> None:
    (tmp_path / "x.tlog").write_bytes(b"")
    for link, fleet in (("tcp:127.0.0.1:1", "demo-replay"), (f"replay:{tmp_path / 'x.tlog'}", "demo")):
        with pytest.raises(BadConfig) as told:
            Onboard(scene.router, OnboardSettings(link=link, name="v1", fleet=fleet))
        assert told.value.detail["field"] == "fleet"
