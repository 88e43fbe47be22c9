"""Nothing from the network ends the picture: absurd values, hostile payloads, odd names, too many of them."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ground.view import table, topics
from ground.view.frames import FAR, usable
from zmav import wire

Q1 = ("demo", "quad1")
EVENT = wire.Event(t=1.0, kind="mode", severity="info", text="GUIDED")
Make = Callable[..., Any]
HOSTILE = (b"", b"{", b"null", b"[]", b"\xff\xfe", b'{"t": "x"}', b"[" * 100_000, b'{"pos": [1e999, 0, 0]}')


@pytest.mark.parametrize(
    "kind",
    [
        "state",
        "setpoint",
        "event",
        "link",
        "fleet",
        "graph",
        "camera_frame",
        "camera_detection",
        "agent_out",
        "of no kind",
    ],
)
def test_a_payload_that_is_nothing_is_left_out(paint: Make, state: Make, kind: str) -> None:
    painted = paint()
    for payload in HOSTILE:
        painted.step((kind, ("demo", "quad1", "x", "y"), payload), ("state", Q1, state()))
    assert f"/world/ned/vehicles/{Q1[1]}/pose" in painted.rows()
    assert painted.canvas.failed == 0


@pytest.mark.parametrize("local", [(math.inf, 0.0, 0.0), (1e30, 0.0, 0.0), (0.0, 0.0, -2 * FAR)])
def test_a_vehicle_at_an_absurd_place_is_told_of_and_not_drawn_there(
    paint: Make, state: Make, local: wire.Vector
) -> None:
    painted = paint()
    there = wire.GlobalPosition(lat_deg=52.0, lon_deg=-1.0, alt_amsl=60.0, alt_rel=0.0)
    painted.step(("fleet", ("demo", "origin"), wire.Origin(lat_deg=52.0, lon_deg=-1.0, alt_amsl=60.0)))
    text = json.dumps({**json.loads(wire.encode(state(position=there))), "local": local}).replace("Infinity", "1e999")
    for _ in range(3):
        painted.step(("state", Q1, text.encode()))
    painted.step(("state", ("demo", "quad2"), state("quad2")))
    rows = painted.rows()
    assert "/world/ned/vehicles/quad1/pose" not in rows
    assert "/world/ned/vehicles/quad2/pose" in rows
    if "1e999" not in text:  # an infinity is no number of JSON: that state is refused whole
        assert len(rows["/events/quad1"]) == 1, "it is said once"


def test_names_with_odd_characters_are_paths_of_one_part(paint: Make, state: Make) -> None:
    painted = paint(several=True)
    painted.step(("state", ("a/b", "q 1"), state()), ("event", ("a/b", "x/../y"), EVENT))
    names = painted.rows()
    assert r"/world/ned/vehicles/a\/b\/q\ 1/pose" in names
    assert r"/events/a\/b\/x\/..\/y" in names


def test_fifty_vehicles_have_a_path_each_and_names_without_modes(paint: Make, state: Make) -> None:
    painted = paint()
    names = [f"quad{i}" for i in range(50)]
    for _ in range(3):
        painted.step(
            *(("state", ("demo", name), state(name, local=(float(i), 0.0, -5.0))) for i, name in enumerate(names))
        )
    rows = painted.rows()
    assert all(f"/world/ned/vehicles/{name}/pose" in rows for name in names)
    assert rows["/world/ned/vehicles/quad7/pose/name"][-1].values["Points3D:labels"] == ["quad7"]


coordinates = st.floats(allow_nan=False, allow_infinity=False)
vectors = st.tuples(coordinates, coordinates, coordinates)
outlines = st.lists(st.tuples(coordinates, coordinates), max_size=5)
swarm = wire.swarm
bodies = st.one_of(
    st.builds(swarm.Box, low=vectors, high=vectors),
    st.builds(
        swarm.Cylinder,
        center=st.tuples(coordinates, coordinates),
        radius=coordinates,
        floor=coordinates,
        ceiling=coordinates,
    ),
    st.builds(swarm.NoFly, polygon=outlines, floor=coordinates, ceiling=coordinates),
    st.builds(swarm.Geofence, polygon=outlines, floor=coordinates, ceiling=coordinates),
    st.builds(swarm.Ball, center=vectors, radius=coordinates),
)


@given(bodies)
def test_whatever_a_planner_says_only_places_that_can_be_drawn_are_found(body: Any) -> None:
    found = topics.Shapes()
    told = swarm.ObstacleMap(t=1.0, planner="p", instance="i", obstacles=[swarm.Obstacle(name="it", t=1.0, what=body)])
    topics.TOPICS["obstacle"][1](told, found)
    places = [place for place, _ in found.marks] + [point for points, _ in found.lines for point in points]
    places += [corner for box in found.boxes for corner in box]
    places += [(n, e, down) for outline, *downs in found.prisms for n, e in outline for down in downs]
    assert all(usable(place) for place in places)


def test_a_table_forgets_no_newest_value_and_grows_no_further_than_its_places() -> None:
    kept = table.Table()
    reader = kept.reader()
    for i in range(1000):
        kept.put("state", Q1, str(i).encode())
        kept.append("event", Q1, str(i).encode())
    assert len(reader) == 1 + table.LINES
    batch = reader.take()
    assert [item.payload for item in batch.items if item.kind == "state"] == [b"999"]
    assert next(item.payload for item in batch.items if item.kind == "event") == b"500"
    assert batch.lost == 500
    assert reader.take() == table.Batch([])
    assert [item.payload for item in kept.reader().take().items] == [b"999"], (
        "a later painter begins with what is known"
    )


def test_a_table_refuses_what_is_too_large_or_too_much() -> None:
    kept = table.Table(most=3)
    for i in range(5):
        kept.put("state", ("demo", f"quad{i}"), b"x")
    kept.put("state", ("demo", "quad0"), b"y")
    kept.put("state", ("demo", "quad1"), b"x" * (table.LARGEST + 1))
    found = {item.place[1]: item.payload for item in kept.reader().take().items}
    assert found == {"quad0": b"y", "quad1": b"x", "quad2": b"x"}
    assert kept.refused == 3


def test_a_batch_is_served_in_portions() -> None:
    kept = table.Table(portion=10)
    reader = kept.reader()
    for i in range(4):
        kept.put("camera_frame", ("demo", f"quad{i}", "c"), b"x" * 8)
    assert [len(reader.take().items) for _ in range(3)] == [2, 2, 0]
