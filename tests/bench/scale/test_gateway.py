"""A group's gateway: what crosses it, what stops there."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator
from typing import Any

import pytest
import zenoh

from tests.bench.scale.footprint import Copter
from tests.bench.scale.gateway import Gateway
from tests.bench.scale.group import GROUP, GroupStates
from tests.conftest import Ground, Net
from zmav import keys, wire
from zmav.errors import BadConfig, BadKey


class Hierarchy:
    """One group of two vehicles behind a gateway, and a ground station on the trunk."""

    def __init__(self, net: Net) -> None:
        inside, door = net.router()
        trunk, endpoint = net.router()
        self.inside = inside
        self.copters = [Copter(inside, "demo", name, number) for number, name in enumerate(("quad1", "quad2"))]
        self.near = net.ground(door)
        self.ground = net.ground(endpoint)
        self.gateway = Gateway(self.near.session, trunk, "demo", "north")
        self._beat = 0

    def tick(self, count: int = 2) -> None:
        for _ in range(count):
            for copter in self.copters:
                copter.tick(self._beat)
            self._beat += 1

    async def until(self, true: Any, what: str) -> None:
        for _ in range(600):
            if true():
                return
            self.tick()
            await asyncio.sleep(0.05)
        raise AssertionError(f"never: {what}")


@pytest.fixture
async def hierarchy(net: Net) -> AsyncIterator[Hierarchy]:
    hierarchy = Hierarchy(net)
    async with hierarchy.gateway:
        yield hierarchy


async def test_states_come_out_together_and_in_no_other_way(hierarchy: Hierarchy) -> None:
    groups = hierarchy.ground.samples(GROUP.key("demo", group="*"))
    everything = hierarchy.ground.samples("zmav/**")
    states: list[GroupStates] = []

    def both() -> bool:
        states[:] = [wire.decode(payload, GroupStates, "states") for _, payload in groups.items]
        return any({m.name for m in said.vehicles} == {"quad1", "quad2"} for said in states)

    await hierarchy.until(both, "both vehicles in one aggregate")
    quad1 = next(m for m in states[-1].vehicles if m.name == "quad1")
    assert states[-1].group == "north"
    assert (quad1.mode, quad1.kind, quad1.battery, quad1.faults) == ("GUIDED", "copter", 0.99, [])
    assert quad1.lat_deg == pytest.approx(-35.363261)
    assert everything.items == []  # wildcards do not match what begins with @


async def test_a_vehicle_that_is_named_is_asked_and_one_that_is_not_is_not(hierarchy: Hierarchy) -> None:
    ground = hierarchy.ground

    async def answers(key: str) -> list[str]:
        found = await asyncio.to_thread(lambda: list(ground.session.get(key, timeout=2.0)))
        return [json.loads(reply.ok.payload.to_bytes())["name"] for reply in found if reply.ok]

    hierarchy.tick()
    while await answers("zmav/demo/quad2/state") != ["quad2"]:  # until the gateway has heard of it
        hierarchy.tick()
    assert (await ground.do("ping")).status == "done"
    assert await answers("zmav/demo/*/state") == []
    assert await answers("zmav/**") == []
    assert hierarchy.gateway.refused == 4  # at the door of either vehicle


async def test_setpoints_and_frames_go_in_and_nothing_else_does(hierarchy: Hierarchy) -> None:
    ground, (quad1, quad2) = hierarchy.ground, hierarchy.copters
    key = keys.SETPOINT.key("demo", "quad2", agent="planner")
    hierarchy.tick()
    await hierarchy.until(lambda: _put(ground, key, quad2), "a setpoint")
    ground.put(keys.STATE, b"{}")  # it says nothing of itself from outside
    ground.session.put(keys.TX.key("demo", "quad1", sys=1, comp=1, msg="HEARTBEAT"), b"frame")
    await hierarchy.until(lambda: bool(quad1.heard), "a frame")
    assert quad1.heard == ["zmav/demo/quad1/mav/tx/1/1/HEARTBEAT"]
    assert set(quad2.heard) == {key}
    assert hierarchy.gateway.bad == 0


def _put(ground: Ground, key: str, copter: Copter) -> bool:
    ground.session.put(key, b"{}")
    return bool(copter.heard)


async def test_telemetry_comes_out_while_it_is_wanted(hierarchy: Hierarchy) -> None:
    ground = hierarchy.ground
    frames = ground.samples("zmav/demo/*/mav/rx/**")
    states = ground.samples("zmav/demo/*/state")
    shown: list[tuple[str, zenoh.SampleKind]] = []
    every = keys.WANT.key("demo", "*", msg="*", hz="*", instance="*")
    tokens = hierarchy.inside.liveliness()
    watch = tokens.declare_subscriber(every, lambda sample: shown.append((str(sample.key_expr), sample.kind)))
    wants = [keys.WANT.key("demo", "quad2", msg=msg, hz="4", instance="me") for msg in ("ATTITUDE", "state")]
    held = [ground.session.liveliness().declare_token(key) for key in wants]
    await hierarchy.until(lambda: bool(frames.items and states.items), "a frame and a state")
    assert {key for key, _ in frames.items} == {"zmav/demo/quad2/mav/rx/1/1/ATTITUDE"}
    assert {key for key, _ in states.items} == {"zmav/demo/quad2/state"}
    assert shown == [(wants[0], zenoh.SampleKind.PUT)]  # the vehicle is to send it so often; its state it says anyway
    for token in held:
        token.undeclare()
    await hierarchy.until(lambda: (wants[0], zenoh.SampleKind.DELETE) in shown, "the token's end")
    count = len(frames.items)
    (late,) = await ground.ask("zmav/demo/quad2/state")
    hierarchy.tick(10)
    assert late.ok is not None
    await hierarchy.until(lambda: hierarchy._beat > 60, "some more beats")
    assert len(frames.items) == count
    watch.undeclare()


async def test_it_refuses_to_stand_between_a_network_and_itself(net: Net) -> None:
    session, endpoint = net.router()
    with pytest.raises(BadConfig, match="share a router"):
        Gateway(net.ground(endpoint).session, session, "demo", "north")
    with pytest.raises(BadKey, match="group"):
        Gateway(net.ground(endpoint).session, net.router()[0], "demo", "North")


async def test_what_is_no_state_is_counted(hierarchy: Hierarchy) -> None:
    hierarchy.near.session.put("zmav/demo/quad3/state", b"{")
    hierarchy.near.session.put("zmav/demo/quad3/state", wire.encode(hierarchy.copters[0].state()))
    await hierarchy.until(lambda: hierarchy.gateway.bad == 2, "two bad states")
    with contextlib.suppress(zenoh.ZError):
        assert list(hierarchy.ground.session.get("zmav/demo/quad3/state", timeout=1.0)) == []
