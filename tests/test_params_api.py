"""``vehicle.params``: what a script sees of a vehicle's parameters, and what differs between vehicles."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest

import zmav
from zmav import keys, wire
from zmav.errors import BadInput, NoSuchVehicle
from zmav.sim import VehicleSpec, World
from zmav.vehicle.params import Difference, differences, own_params, values

if TYPE_CHECKING:
    from tests.conftest import Net, StartOnboard

PATIENCE_S = 30.0


class Scene(NamedTuple):
    z: zmav.Client
    quads: list[zmav.Vehicle]
    world: World
    replies: list[int]
    """bytes of each reply to a query on ``param``"""


MakeScene = Callable[[int], Awaitable[Scene]]


@pytest.fixture
async def make_scene(net: Net, onboard: StartOnboard, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[MakeScene]:
    """Simulated copters, their agents in one router, and a client that has heard of them."""
    async with contextlib.AsyncExitStack() as stack:

        async def make(count: int) -> Scene:
            specs = [VehicleSpec(params={"WPNAV_SPEED": 1000.0 + 100.0 * i}) for i in range(count)]
            world = stack.enter_context(World(specs, endpoint="tcp:0", speed=4.0, ready_s=0.5))
            session, endpoint = net.router()
            for i, url in enumerate(world.urls, 1):
                await onboard(session, url, f"quad{i}")
            z = await stack.enter_async_context(zmav.open(connect=[endpoint]))
            quads = await z.wait_for(*(f"quad{i}" for i in range(1, count + 1)), timeout=PATIENCE_S)
            for quad in quads:
                await quad.wait_until(lambda s: s.connected, PATIENCE_S)
            replies: list[int] = []
            ask = z.ask

            async def counted(key: str, *how: Any) -> Any:
                answers = await ask(key, *how)
                if key.endswith("/param"):
                    replies.extend(len(a.payload) for a in answers if isinstance(a, zmav.client.Answer))
                return answers

            monkeypatch.setattr(z, "ask", counted)
            return Scene(z, quads, world, replies)

        yield make


async def test_list_waits_for_the_whole_set_and_costs_a_line_the_second_time(make_scene: MakeScene) -> None:
    scene = await make_scene(1)
    (quad,) = scene.quads
    table = await quad.params.list()
    assert (table.complete, table.count, len(table.params), table.autopilot) == (True, 1354, 1354, "ardupilot")
    scene.replies.clear()
    again = await quad.params.list()
    assert (again.params, again.unchanged) == (table.params, False)
    assert sum(scene.replies) < 300
    await quad.params.set("WPNAV_SPEED", 600)
    after = await quad.params.list()
    assert values(after) == {**values(table), "WPNAV_SPEED": 600.0}
    await quad.params.set("WPNAV_SPEED", 650)
    scene.replies.clear()
    quad.params.note(wire.Param(name="WPNAV_SPEED", value=650.0, type="REAL32"))
    assert values(await quad.params.list()) == {**values(table), "WPNAV_SPEED": 650.0}
    assert sum(scene.replies) < 300


async def test_get_set_load_refresh(make_scene: MakeScene) -> None:
    scene = await make_scene(1)
    (quad,) = scene.quads
    assert (await quad.params.get("WPNAV_SPEED")).value == 1000.0
    changed = await quad.params.set("fs_gcs_enable", 1)
    assert changed == wire.ParamChanged(name="FS_GCS_ENABLE", value=1, before=0)
    await quad.params.list()
    news: list[dict[str, Any]] = []
    done = await quad.params.load({"FS_GCS_ENABLE": 1, "WPNAV_SPEED": 700, "FS_THR_ENABLE": 0.5}, news.append)
    assert (done.set, done.unchanged, list(done.failed)) == (["WPNAV_SPEED"], ["FS_GCS_ENABLE"], ["FS_THR_ENABLE"])
    table = await quad.params.refresh()
    assert (values(table)["WPNAV_SPEED"], values(table)["FS_GCS_ENABLE"]) == (700.0, 1)
    with pytest.raises(BadInput, match="did you mean WPNAV_SPEED"):
        await quad.params.get("WPNAV_SPEDD")
    for bad in ("", "a/b", "WP*", "x?y"):
        with pytest.raises(BadInput, match="cannot be a parameter's name"):
            await quad.params.get(bad)
    with pytest.raises(NoSuchVehicle):
        await scene.z.vehicle("quad9").params.list()


async def test_what_differs_in_a_fleet(make_scene: MakeScene) -> None:
    scene = await make_scene(3)
    columns = {quad.name: values(await quad.params.list()) for quad in scene.quads}
    different = {each.name: each.values for each in differences(columns)}
    assert different["WPNAV_SPEED"] == {"quad1": 1000.0, "quad2": 1100.0, "quad3": 1200.0}
    assert different["MAV_SYSID"] == {"quad1": 1, "quad2": 2, "quad3": 3}
    assert own_params("ardupilot", different) == {"MAV_SYSID"}
    assert set(different) == {"WPNAV_SPEED", "MAV_SYSID"}


def test_differences() -> None:
    a = {"SAME": 1, "FLOAT": 0.1, "DIFFERS": 1, "ONLY_A": 1, "NAN": None}
    b = {"SAME": 1.0, "FLOAT": 0.10000000149, "DIFFERS": 2, "ONLY_B": 0, "NAN": None}
    assert differences({"a": a, "b": b}) == [
        Difference("DIFFERS", {"a": 1, "b": 2}),
        Difference("ONLY_A", {"a": 1}),
        Difference("ONLY_B", {"b": 0}),
    ]
    assert [each.name for each in differences({"a": a, "b": b}, only=["DIFFERS", "SAME", "NOWHERE"])] == [
        "DIFFERS",
        "NOWHERE",
    ]
    fifty = {f"quad{i}": {"A": 1 if i != 7 else 2, "B": 3} for i in range(50)}
    (different,) = differences(fifty)
    assert (different.name, len(different.values)) == ("A", 50)


def test_own_params() -> None:
    names = ["STAT_BOOTCNT", "COMPASS_DEV_ID2", "BARO1_GND_PRESS", "INS_ACC_ID", "RTL_ALT", "MAV_SYSID"]
    assert own_params("ardupilot", names) == set(names) - {"RTL_ALT"}
    assert own_params("px4", ["CAL_MAG0_ID", "LND_FLIGHT_T_HI", "MPC_XY_P"]) == {"CAL_MAG0_ID", "LND_FLIGHT_T_HI"}
    assert own_params("generic", names) == set()
    assert keys.PARAM.key("demo", "quad1", param="RTL_ALT") == "zmav/demo/quad1/param/RTL_ALT"
