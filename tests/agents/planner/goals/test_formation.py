"""Shapes: the spacing held, the heading, what is refused, and how far vehicles are from a shape."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np
import pytest

from agents.planner.goals import formation
from tests.agents.planner.goals import team
from zmav import wire
from zmav.config.body import USUAL
from zmav.errors import BadInput

DOWNWASH = 1.5


def goal(count: int, shape: str = "vee", **more: Any) -> wire.swarm.Formation:
    numbers = {"at": (10.0, 20.0, -30.0), "spacing": 5.0, **more}
    return wire.swarm.Formation(vehicles=[f"v{i}" for i in range(count)], shape=shape, **numbers)  # type: ignore[arg-type]


def places(asked: wire.swarm.Formation) -> Any:
    return formation.places(asked, [USUAL["copter"]] * len(asked.vehicles), DOWNWASH)


@pytest.mark.parametrize("count", [2, 3, 7, 16, 40])
@pytest.mark.parametrize("shape", ["line", "vee", "column", "circle", "grid"])
def test_the_nearest_neighbours_are_the_spacing_apart(shape: str, count: int) -> None:
    found = places(goal(count, shape))
    assert found.shape == (count, 3)
    assert team.nearest(found, DOWNWASH)[0] == pytest.approx(5.0, rel=1e-6)


def test_a_shape_looks_to_its_heading_with_the_leader_at_its_place() -> None:
    east = places(goal(5, "vee", heading=math.pi / 2.0))
    assert east[0] == pytest.approx([20.0, 10.0, 30.0])
    assert (east[1:, 0] < 20.0 - 3.0).all(), "the others are west of a leader that looks east"
    assert east[1, 1] < 10.0 < east[2, 1], "the second is on the right, which is south"


def test_custom_points_are_forward_right_down() -> None:
    found = places(goal(2, "custom", points=[(0.0, 0.0, 0.0), (4.0, 3.0, -2.0)], heading=0.0))
    assert found[1] - found[0] == pytest.approx([3.0, 4.0, 2.0])


def test_places_nearer_than_the_vehicles_may_be_are_refused_with_the_pair() -> None:
    points = [(0.0, 0.0, 0.0), (9.0, 0.0, 0.0), (9.0, 0.0, 2.0)]
    with pytest.raises(BadInput, match=r"v1 and v2, are 1\.33 m apart.*need 2\.00 m") as e:
        places(goal(3, "custom", points=points, labelled=True))
    assert e.value.detail["field"] == "points"
    with pytest.raises(BadInput, match="number 1 and number 2"):
        places(goal(3, "line", spacing=1.0))


def test_unlabelled_places_must_fit_the_two_widest() -> None:
    bodies = [wire.swarm.Body(radius=r, speed=5.0, accel=2.5, climb=2.0, descend=2.0) for r in (3.0, 1.0, 1.0, 3.0)]
    ends = goal(4, "line", spacing=3.0, labelled=True)
    with pytest.raises(BadInput, match="v0 and v1"):
        formation.places(ends, bodies, DOWNWASH)
    apart = goal(4, "custom", points=[(0, 0, 0), (0, 4.5, 0), (0, 9, 0), (0, 20, 0)], labelled=True)
    assert len(formation.places(apart, bodies, DOWNWASH)) == 4
    apart.labelled = False
    with pytest.raises(BadInput, match=r"need 6\.00 m"):
        formation.places(apart, bodies, DOWNWASH)


@pytest.mark.parametrize(
    ("more", "field"),
    [
        ({"shape": "custom", "points": [(0.0, 0.0, 0.0)]}, "points"),
        ({"points": [(0.0, 0.0, 0.0)]}, "points"),
    ],
)
def test_what_is_no_formation_is_named(more: dict[str, Any], field: str) -> None:
    with pytest.raises(BadInput) as e:
        places(goal(3, **{"shape": "vee", **more}))
    assert e.value.detail["field"] == field


def test_the_error_of_a_shape_is_what_it_is_bent_by() -> None:
    offsets = formation.offsets_of(goal(4, "line"), 4)
    still = formation.placed(offsets, np.zeros(3), 0.0)
    bent = formation.placed(offsets, np.ones(3), 1.0)
    bent[:2, 2] += 1.0
    errors = team.shape_error(offsets, np.stack((still, bent)))
    assert errors == pytest.approx([0.0, 0.5], abs=1e-9)


def test_a_shape_without_room_for_what_positions_may_be_off_is_refused_and_says_how_much_that_is() -> None:
    asked, wide = goal(3, "line", spacing=5.0), [msgspec.structs.replace(USUAL["copter"], radius=3.5)] * 3
    with pytest.raises(BadInput, match=r"need 7\.00 m, 5\.00 m of them for what their positions may be off \(--tight"):
        formation.places(asked, wide, DOWNWASH, rooms=[2.5] * 3)
    with pytest.raises(BadInput) as refused:
        formation.places(asked, wide, DOWNWASH)
    assert "tight" not in refused.value.message
