"""Orders that take down what protects a vehicle are the operators', unless the fleet file gives them away."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from mesh.credentials.acl import granted
from zmav import keys, wire
from zmav.config import Rights, load_fleet
from zmav.errors import BadConfig, Forbidden
from zmav.trust.certificate import Role
from zmav.verbs import GRANTABLE, VERBS

if TYPE_CHECKING:
    from tests.trust.conftest import StartGuarded

ORDERS: dict[str, Any] = {
    "mission_clear": wire.MissionClear(kind="fence"),
    "mission_upload": wire.MissionUpload(kind="fence", items=[]),
    "servo": wire.SetServo(output=9, pwm=1500),
}


def test_these_are_the_orders() -> None:
    assert set(ORDERS) == GRANTABLE
    assert all(VERBS[name].writers == (keys.OPERATOR,) for name in GRANTABLE)


@pytest.mark.parametrize("verb", ORDERS)
async def test_a_planner_takes_no_fence_down_and_moves_no_servo(guarded: StartGuarded, verb: str) -> None:
    g = await guarded()
    async with g.client("plan", "planner") as z:
        with pytest.raises(Forbidden, match=rf"plan \(planner\) may not use do {verb} of quad1; allowed: operator"):
            await z.vehicle("quad1").order(verb, ORDERS[verb])


async def test_what_the_fleet_file_gives_it_may(guarded: StartGuarded) -> None:
    g = await guarded(rights=Rights(planner=["servo"]))
    async with g.client("plan", "planner") as z:
        await z.vehicle("quad1").order("servo", ORDERS["servo"])
        with pytest.raises(Forbidden):
            await z.vehicle("quad1").order("mission_clear", ORDERS["mission_clear"])
    async with g.client("view", "viewer") as z:
        with pytest.raises(Forbidden):
            await z.vehicle("quad1").order("servo", ORDERS["servo"])


def test_the_doors_are_made_from_the_same_table() -> None:
    for role, gets in ((Role.PLANNER, True), (Role.VIEWER, False), (Role.OPERATOR, True)):
        key = "zmav/alpha/*/do/servo"
        assert (key in granted(role, "x1", "alpha", given=["servo"])["query"]) == gets
        assert (key in granted(role, "x1", "alpha")["query"]) == (role is Role.OPERATOR)
    own = granted(Role.VEHICLE, "quad1", "alpha", "quad1", ["servo"])["query"]
    assert "zmav/alpha/quad1/do/servo" in own and "zmav/alpha/quad1/do/mission_clear" not in own


def test_nothing_else_can_be_given_away(tmp_path: Path) -> None:
    path = tmp_path / "fleet.toml"
    path.write_text('[rights]\nplanner = ["servo", "mission_upload", "mission_clear"]\n')
    assert set(load_fleet(path).rights.planner) == GRANTABLE
    path.write_text('[rights]\nplanner = ["param_set"]\n')
    with pytest.raises(BadConfig, match="rights"):
        load_fleet(path)
