"""The README's commands in virtual time, by teams whose receivers drift apart as typical ones do.

Nobody comes nearer than was promised, nobody stops where no plan says so, and what the preview says is what it takes.

More teams: ``python tests/bench/plan_seeds.py``.
"""

from __future__ import annotations

import pytest

from tests.agents.planner.live.seeds import ARDUCOPTER, PROMISED, PX4, PX4_IN_CALM_AIR, Sort, team_rows

pytestmark = pytest.mark.asyncio


@pytest.mark.parametrize(
    ("seed", "sort"), [*((seed, ARDUCOPTER) for seed in range(6)), *((seed, PX4_IN_CALM_AIR) for seed in range(3))]
)
async def test_the_readme_s_commands_keep_what_they_promise(seed: int, sort: Sort) -> None:
    rows = await team_rows(seed, sort)
    assert min(row.nearest for row in rows) >= PROMISED, rows
    assert [row.stops for row in rows] == [()] * len(rows)
    for row in rows[1:]:  # a takeoff is the vehicles' own
        assert row.flown == pytest.approx(row.said, rel=0.15), row


@pytest.mark.parametrize("seed", range(2))
async def test_px4s_in_wind_do_not_come_nearer_than_is_promised(seed: int) -> None:
    rows = await team_rows(seed, PX4)
    assert min(row.nearest for row in rows) >= PROMISED, rows


async def test_room_for_what_positions_are_off_keeps_crews_farther_apart() -> None:
    """... or this would prove nothing: these commands have places 9 m apart and more."""
    least = [
        [min(row.nearest for row in await team_rows(seed, room=room)) for seed in (3, 4)] for room in (False, True)
    ]
    assert max(least[0]) + 1.0 < min(least[1]), least
