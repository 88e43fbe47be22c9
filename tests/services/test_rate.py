"""The floor: what a state is made of is asked for until it flows, and again when the autopilot has forgotten it."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

import pytest

from zmav import keys
from zmav.autopilots.ardupilot import ArduPilot
from zmav.autopilots.px4 import Px4

if TYPE_CHECKING:
    from tests.services.conftest import Peer, StartBench, StartPeer

SET_INTERVAL, PX4 = 511, 12


class Flow:
    """Makes a peer send what it was asked for, twenty times a second, until it is restarted."""

    def __init__(self, peer: Peer, monkeypatch: pytest.MonkeyPatch) -> None:
        self.peer, self.wanted = peer, dict[str, float]()
        before = peer.obey

        def obey(number: int, fields: dict[str, Any]) -> None:
            before(number, fields)
            if number == SET_INTERVAL:
                self.wanted[peer.dialect.name_of(int(fields["param1"]))] = fields["param2"]

        monkeypatch.setattr(peer, "obey", obey)

    async def run(self) -> None:
        while True:
            for name in self.wanted:
                self.peer.send(name)
            await asyncio.sleep(0.05)


async def test_asked_for_until_it_flows_and_again_after_a_restart(
    bench: StartBench, peer: StartPeer, monkeypatch: pytest.MonkeyPatch
) -> None:
    # At 2 Hz a message counts as flowing for one and a half seconds, however busy this machine is.
    floor = dict.fromkeys(ArduPilot.floor, 2.0)
    assert len(floor) >= 4
    monkeypatch.setattr(ArduPilot, "floor", floor)
    one = await peer()
    one.mute = {SET_INTERVAL}
    b = await (await bench(one)).connected()
    await one.until(lambda: len(one.commands(SET_INTERVAL)) >= 2 * len(floor), "second asking")
    asked = [one.dialect.name_of(int(t.fields["param1"])) for t in one.commands(SET_INTERVAL)]
    assert asked[: 2 * len(floor)] == list(floor) * 2

    flow = Flow(one, monkeypatch)
    one.mute = set()
    running = asyncio.create_task(flow.run())
    await b.state(lambda s: {"attitude", "battery", "gps"} <= s["ages"].keys(), "messages")
    assert flow.wanted == dict.fromkeys(floor, 5e5)
    before = len(one.commands(SET_INTERVAL))
    reports = b.ground.samples(keys.LINK, link="autopilot")
    await reports.until(lambda: len(reports.items) >= 2, "two rounds")
    assert len(one.commands(SET_INTERVAL)) == before

    flow.wanted.clear()  # it restarts, and has forgotten what it was asked
    await one.until(lambda: flow.wanted.keys() == floor.keys(), "asking again")
    running.cancel()


async def test_the_rates_are_the_autopilot_s(bench: StartBench) -> None:
    b = await (await bench()).connected()
    await b.peer.until(lambda: len(b.peer.commands(SET_INTERVAL)) >= len(ArduPilot.floor), "asking")
    asked = {
        b.peer.dialect.name_of(int(t.fields["param1"])): 1e6 / t.fields["param2"] for t in b.peer.commands(SET_INTERVAL)
    }
    assert asked == pytest.approx(dict(ArduPilot.floor))
    assert all(t.fields["target_system"] == 1 for t in b.peer.commands(SET_INTERVAL))


async def test_px4_is_asked_for_nothing(bench: StartBench) -> None:
    assert Px4.floor == {}
    b = await (await bench(autopilot=PX4)).connected()
    reports = b.ground.samples(keys.LINK, link="autopilot")
    await reports.until(lambda: len(reports.items) >= 2, "two rounds")
    assert b.peer.commands(SET_INTERVAL) == []
