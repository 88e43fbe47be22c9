"""What is drawn, read back from the recording: places, attitudes, colours, and how often."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import pytest

from ground.view import style
from ground.view.frames import NED_IN_VIEW
from mesh.graph import Graph, Node
from zmav import geo, wire
from zmav.doctor.ways import POOR_COST, Link, Way

Q1 = ("demo", "quad1")
BODY = "/world/ned/vehicles/quad1"
T0 = 1.8e9
ORIGIN = wire.Origin(lat_deg=52.756, lon_deg=-1.246, alt_amsl=60.0)
Make = Callable[..., Any]


def rgba(number: int) -> tuple[int, int, int, int]:
    return number >> 24 & 255, number >> 16 & 255, number >> 8 & 255, number & 255


def global_of(ned: wire.Vector) -> wire.GlobalPosition:
    lat, lon, alt = geo.to_global(ORIGIN, ned)
    return wire.GlobalPosition(lat_deg=lat, lon_deg=lon, alt_amsl=alt, alt_rel=alt - 60.0)


def test_a_vehicle_stands_where_it_is_and_the_view_turns_north_east_down_into_its_own_axes(
    paint: Make, state: Make
) -> None:
    painted = paint()
    painted.step(("state", Q1, state(local=(10.0, 20.0, -5.0))))
    rows = painted.rows()
    assert rows[f"{BODY}/pose"][0].values["Transform3D:translation"] == [[10.0, 20.0, -5.0]]
    turned = rows["/world/ned"][0]
    assert turned.t is None
    matrix = np.array(turned.values["Transform3D:mat3x3"]).reshape(3, 3, order="F")
    assert np.linalg.det(matrix) == pytest.approx(1.0), "a mirror image"
    assert (matrix @ [10.0, 20.0, -5.0]).tolist() == [20.0, 10.0, 5.0], "east, north, up"
    assert np.array(NED_IN_VIEW).tolist() == matrix.tolist()


@pytest.mark.parametrize(
    ("attitude", "body", "ned"),
    [
        ((0.0, 0.0, math.pi / 2), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),  # the nose points east
        ((0.0, math.pi / 2, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)),  # nose up
        ((math.pi / 2, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),  # the right wing down
        ((math.pi / 2, 0.0, math.pi / 2), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)),  # rolled right and heading east
        # All three: the columns of Rz(0.9) Ry(0.5) Rx(0.3), as textbooks of flight dynamics have the matrix.
        ((0.3, 0.5, 0.9), (1.0, 0.0, 0.0), (0.545514, 0.687434, -0.479426)),
        ((0.3, 0.5, 0.9), (0.0, 1.0, 0.0), (-0.660271, 0.704828, 0.259343)),
    ],
)
def test_the_attitude_turns_the_body_into_ned(
    paint: Make, state: Make, attitude: tuple[float, float, float], body: wire.Vector, ned: wire.Vector
) -> None:
    painted = paint()
    roll, pitch, yaw = attitude
    painted.step(("state", Q1, state(attitude=wire.Attitude(roll=roll, pitch=pitch, yaw=yaw))))
    ((x, y, z, w),) = painted.rows()[f"{BODY}/pose"][0].values["Transform3D:quaternion"]
    q, v = np.array((x, y, z)), np.array(body)
    turned = v + 2.0 * np.cross(q, np.cross(q, v) + w * v)
    assert turned == pytest.approx(ned, abs=1e-6)


def test_no_path_is_logged_more_often_than_ten_times_a_second_and_the_newest_wins(paint: Make, state: Make) -> None:
    painted = paint()
    for i in range(40):
        many = [("state", Q1, state(local=(i + k / 10, 0.0, -5.0), t=T0 + i)) for k in range(5)]
        painted.step(*many, ("setpoint", (*Q1, "planner"), wire.Setpoint(lease="l", seq=i, deadline=0, pos=(i, 1, -5))))
    rows = painted.rows()
    times = {name: [row.t for row in found if row.t is not None] for name, found in rows.items()}
    for name, found in times.items():
        closest = min((b - a for a, b in itertools.pairwise(found)), default=1.0)
        assert closest >= 0.099 or name.startswith("/events"), f"{name}: {closest} s apart"
    poses = rows[f"{BODY}/pose"]
    assert len(poses) == 40
    assert poses[3].values["Transform3D:translation"][0][0] == pytest.approx(3.4)


def test_a_setpoint_is_marked_and_its_distance_plotted_until_it_is_stale(paint: Make, state: Make) -> None:
    painted = paint()
    setpoint = wire.Setpoint(lease="l", seq=1, deadline=0.0, pos=(13.0, 24.0, -5.0))
    painted.step(("state", Q1, state()), ("setpoint", (*Q1, "planner"), setpoint))
    painted.step(after=5.0)
    painted.step(after=0.1)
    rows = painted.rows()
    assert rows["/plots/error/quad1"][-1].values["Scalars:scalars"] == [5.0]
    line = rows[f"{BODY}/error"]
    assert line[0].values["LineStrips3D:strips"] == [[[10.0, 20.0, -5.0], [13.0, 24.0, -5.0]]]
    assert [sorted(row.values) for row in rows[f"{BODY}/setpoint"]][-1] == ["Clear:is_recursive"]
    assert len(line) == 2, "it is cleared once and not again"


def test_of_two_senders_the_lease_holders_setpoint_counts(paint: Make, state: Make) -> None:
    painted = paint()
    held = wire.LeaseInfo(holder="planner", expires=T0)
    painted.step(
        ("state", Q1, state(lease=held)),
        ("setpoint", (*Q1, "planner"), wire.Setpoint(lease="l", seq=1, deadline=0, pos=(10.0, 20.0, -6.0))),
    )
    painted.step(("setpoint", (*Q1, "other"), wire.Setpoint(lease="m", seq=1, deadline=0, pos=(0.0, 0.0, -50.0))))
    assert painted.rows()["/plots/error/quad1"][-1].values["Scalars:scalars"] == [1.0]


def test_a_segment_is_drawn_whole_and_followed_by_its_times(paint: Make, state: Make) -> None:
    painted = paint()
    points = [wire.SegmentPoint(t=T0 + t, pos=(10.0 * t, 0.0, -5.0)) for t in (0.0, 1.0, 2.0)]
    painted.step(
        ("state", Q1, state()), ("setpoint", (*Q1, "p"), wire.Setpoint(lease="l", seq=1, deadline=0, segment=points))
    )
    painted.step(after=0.9)
    painted.step(after=9.0)
    rows = painted.rows()
    assert len(rows[f"{BODY}/segment"][0].values["LineStrips3D:strips"][0]) == 3
    assert rows[f"{BODY}/setpoint"][1].values["Points3D:positions"][0] == pytest.approx([10.0, 0.0, -5.0])
    assert "Clear:is_recursive" in rows[f"{BODY}/segment"][-1].values


def test_the_next_holders_segment_takes_the_place_of_the_last_ones_though_both_are_its_first(
    paint: Make, state: Make
) -> None:
    painted = paint()
    for who, east in (("one", 0.0), ("two", 50.0)):
        points = [wire.SegmentPoint(t=T0 + t, pos=(10.0 * t, east, -5.0)) for t in (0.0, 9.0)]
        painted.step(
            ("state", Q1, state(lease=wire.LeaseInfo(holder=who, expires=T0 + 9.0))),
            ("setpoint", (*Q1, who), wire.Setpoint(lease=who, seq=1, deadline=0, segment=points)),
        )
    segment = painted.rows()[f"{BODY}/segment"][-1].values["LineStrips3D:strips"][0]
    assert [place[1] for place in segment] == [50.0, 50.0]


def test_about_another_origin_nothing_is_left_of_the_trail_about_the_one_before(paint: Make, state: Make) -> None:
    painted = paint()
    for i in range(40):
        painted.step(("state", Q1, state(local=None, position=global_of((float(i), 0.0, -5.0)))))
    painted.step(("fleet", ("demo", "origin"), wire.Origin(lat_deg=52.7, lon_deg=-1.2, alt_amsl=60.0)))
    rows = painted.rows()
    for part in ("old", "fresh"):
        assert "Clear:is_recursive" in rows[f"{BODY}/trail/{part}"][-1].values, part


def test_the_trail_is_bounded_and_stays_when_the_vehicle_falls_silent(paint: Make, state: Make) -> None:
    painted = paint()
    for i in range(600):
        painted.step(("state", Q1, state(local=(float(i), 0.0, -5.0))))
    painted.step(after=10.0)
    rows = painted.rows()
    old = [row for row in rows[f"{BODY}/trail/old"] if "LineStrips3D:strips" in row.values]
    assert len(old) == len(rows[f"{BODY}/trail/old"]), "it was cleared"
    assert max(len(row.values["LineStrips3D:strips"][0]) for row in old) <= 401
    assert rgba(old[-1].values["LineStrips3D:colors"][0])[:3] == style.GREY[:3]
    assert rows[f"{BODY}/pose/name"][-1].values["Points3D:labels"] == ["quad1 · silent"]
    assert rgba(rows[f"{BODY}/pose/model"][-1].values["Boxes3D:colors"][0]) == style.GREY
    assert rows["/plots/age/quad1"][-1].values["Scalars:scalars"][0] == pytest.approx(10.0, abs=0.2)


def quality(name: str, **values: Any) -> wire.NeighbourQuality:
    return wire.NeighbourQuality(t=T0, name=name, router="1", peer="2", url="tcp/x:1", state="up", **values)


def test_links_are_coloured_by_grade_and_end_at_their_hosts(paint: Make, state: Make) -> None:
    painted = paint()
    links = (
        Link("ground", "quad1", quality("quad1", cost=100, rtt=0.004, loss_in=0.0, loss_out=0.0)),
        Link("quad1", "quad2", quality("quad2", cost=POOR_COST, rtt=0.2, loss_in=0.3, loss_out=0.0)),
        Link("quad2", "quad3", quality("quad3", cost=100)),
    )
    nodes = {name: Node(name, role="vehicle") for name in ("quad1", "quad2", "quad3")}
    ways = {
        "quad1": Way(("ground", "quad1"), links[:1]),
        "quad2": Way(("ground", "quad1", "quad2"), links[:2]),
    }
    made = Graph(T0, "ground", {"ground": Node("ground", role="router"), **nodes}, links, ways)
    graph = msgspec.json.encode(made)
    painted.step(
        ("state", Q1, state()),
        ("state", ("demo", "quad2"), state("quad2", local=(0.0, 50.0, -9.0))),
        ("graph", (), graph),
    )
    rows = painted.rows()
    mesh = rows["/world/ned/mesh"][0].values
    assert [rgba(c) for c in mesh["LineStrips3D:colors"]] == [style.GRADES["good"], style.GRADES["poor"]]
    assert mesh["LineStrips3D:strips"][1] == [[10.0, 20.0, -5.0], [0.0, 50.0, -9.0]], "where both vehicles are"
    figures = rows["/world/ned/mesh/figures"][0].values
    assert figures["Points3D:labels"] == ["200 ms 30% lost"], "of a good one the plots tell"
    assert figures["Points3D:positions"] == [[5.0, 35.0, -7.0]]
    assert rows["/world/ned/mesh/stations"][0].values["Points3D:labels"] == ["ground"]
    assert rows["/plots/rtt/quad2"][-1].values["Scalars:scalars"] == pytest.approx([204.0])
    assert rows["/plots/loss/quad2"][-1].values["Scalars:scalars"] == pytest.approx([30.0])


def test_without_an_origin_the_first_vehicles_ground_stands_in_and_a_declared_one_replaces_it(
    paint: Make, state: Make
) -> None:
    painted = paint()
    here = global_of((30.0, 40.0, -12.0))
    painted.step(("state", Q1, state(local=None, position=here)))
    assert painted.scene.datum.rank == "provisional"
    painted.step(("fleet", ("demo", "origin"), ORIGIN))
    painted.step(("state", Q1, state(local=None, position=here)))
    rows = painted.rows()
    poses = [row.values["Transform3D:translation"][0] for row in rows[f"{BODY}/pose"]]
    assert poses[0] == pytest.approx([0.0, 0.0, -12.0], abs=0.01)
    assert poses[-1] == pytest.approx([30.0, 40.0, -12.0], abs=0.01)
    said = [row.values["TextLog:text"][0] for row in rows["/events/viewer"]]
    assert "no fleet origin is known" in said[0]
    assert "declared by @fleet/origin" in said[1]


def test_a_vehicle_with_both_positions_betrays_the_origin(paint: Make, state: Make) -> None:
    painted = paint()
    ned = (1500.0, -800.0, -40.0)
    painted.step(("state", Q1, state(local=ned, position=global_of(ned))))
    origin = painted.scene.datum.origin
    assert origin is not None
    assert geo.to_ned(ORIGIN, origin.lat_deg, origin.lon_deg, origin.alt_amsl) == pytest.approx((0, 0, 0), abs=0.01)


def test_the_area_of_a_search_is_an_outline_on_its_floor_and_hides_nobody(paint: Make) -> None:
    """In the planner's own book: no walls, nothing above the ground, whatever height the search flies at."""
    painted = paint()
    corners = [(0.0, 0.0), (100.0, 0.0), (100.0, 80.0)]
    goal = wire.swarm.Search(vehicles=["quad1"], polygon=corners, height=20.0)
    entry = wire.swarm.GoalEntry(id="g1", goal=goal, state="flying", t=1.0)
    book = wire.swarm.Book(t=1.0, planner="p", instance="i", term=1, goals=[entry])
    painted.step(("fleet", ("demo", "goal"), wire.encode(book)))
    rows = painted.rows()
    top = "/world/ned/topics/goal"
    (line,) = rows[f"{top}/lines"]
    (strip,) = line.values["LineStrips3D:strips"]
    assert [tuple(point) for point in strip] == [(n, e, 0.0) for n, e in [*corners, corners[0]]]
    assert not any(row.values for name in ("prisms", "prisms/walls", "boxes") for row in rows.get(f"{top}/{name}", []))


def test_the_planners_topics_are_drawn_and_others_are_told(paint: Make) -> None:
    painted, swarm = paint(), wire.swarm
    bodies: dict[str, Any] = {
        "tower": swarm.Box(low=(10.0, 0.0, -30.0), high=(20.0, 4.0, 0.0)),
        "mast": swarm.Cylinder(center=(7.0, 5.0), radius=2.0, floor=1.0, ceiling=9.0),
        "field": swarm.Geofence(polygon=[(0.0, 0.0), (9.0, 0.0), (9.0, 9.0)], floor=0.0, ceiling=50.0),
        "beyond": swarm.Cylinder(center=(7e9, 5.0), radius=2.0, floor=1.0, ceiling=9.0),
        "gone": None,
    }
    obstacles = [swarm.Obstacle(name=name, t=1.0, what=what) for name, what in bodies.items()]
    about: dict[str, Any] = {"t": 1.0, "planner": "p", "instance": "i"}
    tracks = {
        "quad1": [(0.0, 0.0, 0.0, -5.0), (1.0, 10.0, 0.0, -5.0)],
        "quad2": [(0.0, 1.0, 1.0, -6.0), (1.0, 2.0, 2.0, -6.0)],
    }
    plan = swarm.PlanReport(t=1.0, planner="p", goal="g1", start=1.0, makespan=1.0, clearance=None, tracks=tracks)
    there = swarm.GoTo(vehicles=["quad1"], to=[(1.0, 2.0, -3.0)])
    goals = [swarm.GoalEntry(id=state, goal=there, state=state, t=1.0) for state in ("flying", "done")]
    for topic, document in (
        ("obstacle", swarm.ObstacleMap(obstacles=obstacles, **about)),
        ("plan", plan),
        ("goal", swarm.Book(term=1, goals=goals, **about)),
        ("charge", swarm.Charge(term=1, **about)),
        ("news", b'{"a": "b"}'),
    ):
        painted.step(("fleet", ("demo", topic), document))
    painted.step(("fleet", ("demo", "goal"), b""))
    rows = painted.rows()
    top = "/world/ned/topics"
    box = rows[f"{top}/obstacle/boxes"][0].values
    assert box["Boxes3D:centers"] == [[15.0, 2.0, -15.0]] and box["Boxes3D:half_sizes"] == [[5.0, 2.0, 15.0]]
    prism = rows[f"{top}/obstacle/prisms"][0].values["LineStrips3D:strips"]
    assert np.mean(prism[0][:-1], axis=0) == pytest.approx([7.0, 5.0, -1.0], abs=1e-4)
    assert prism[1][0][2] == -9.0
    assert max(abs(n) for strip in prism for n, _, _ in strip) < 10.0, "what is out of the world is left out"
    (fence,) = rows[f"{top}/obstacle/lines"][0].values["LineStrips3D:strips"]
    assert fence == [[0, 0, 0], [9, 0, 0], [9, 9, 0], [0, 0, 0]]
    lines = rows[f"{top}/plan/lines"][0].values
    assert lines["LineStrips3D:strips"] == [[[0, 0, -5], [10, 0, -5]], [[1, 1, -6], [2, 2, -6]]]
    assert rgba(lines["LineStrips3D:colors"][0])[:3] == style.colour("quad1")[:3]
    drawn = rows[f"{top}/goal/points"]
    assert drawn[0].values["Points3D:positions"] == [[1.0, 2.0, -3.0]]
    assert drawn[0].values["Points3D:labels"] == ["quad1"]
    assert "Clear:is_recursive" in drawn[1].values
    assert [row.values["TextLog:text"][0] for row in rows["/events/fleet"]] == ['fleet: news: {"a": "b"}']


def test_pictures_are_shown_with_what_was_detected(paint: Make) -> None:
    painted, jpeg = paint(), b"\xff\xd8\xff\xe0" + b"x" * 100 + b"\xff\xd9"
    camera = (*Q1, "down cam")
    symbol = wire.Detection(symbol="H", u=100.0, v=50.0, scale_px=20.0, heading=0.1, score=0.9)
    sight = wire.Detections(
        t=T0, camera="down", seq=1, width=640, height=480, detector="helipad", took=0.0, delay=0.0, found=[symbol]
    )
    painted.step(("camera_frame", camera, jpeg), ("camera_detection", camera, wire.encode(sight)))
    sight.found = []
    painted.step(("camera_frame", camera, b"no jpeg"), ("camera_detection", camera, wire.encode(sight)))
    rows = painted.rows()
    path = r"/camera/quad1/down\ cam"
    assert len(rows[path]) == 1 and bytes(rows[path][0].values["EncodedImage:blob"][0]) == jpeg
    boxes = rows[f"{path}/detection"]
    assert boxes[0].values["Boxes2D:centers"] == [[100.0, 50.0]]
    assert boxes[0].values["Boxes2D:half_sizes"] == [[10.0, 10.0]]
    assert boxes[0].values["Boxes2D:labels"] == ["H"]
    assert "Clear:is_recursive" in boxes[1].values
    assert painted.scene.bad == 1


def test_events_are_told_with_their_severity_and_a_flood_of_them_is_counted(paint: Make) -> None:
    painted = paint()
    events = [wire.Event(t=T0, kind="statustext", severity="critical", text=f"n{i}") for i in range(50)]
    painted.step(*(("event", Q1, event) for event in events))
    painted.step()
    painted.step()
    rows = painted.rows()["/events/quad1"]
    assert [row.values["TextLog:text"][0] for row in rows] == [f"quad1: statustext: n{i}" for i in range(50)]
    assert {row.values["TextLog:level"][0] for row in rows} == {"CRITICAL"}
    assert [sum(row.t == t for row in rows) for t in sorted({row.t for row in rows})] == [20, 20, 10]
