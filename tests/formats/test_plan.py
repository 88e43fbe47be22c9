"""QGroundControl's .plan: what is read, what is written, and what is refused by its JSON path."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zmav.errors import BadInput
from zmav.formats import fence, plan, plans
from zmav.formats.items import Plan, command_name, command_number
from zmav.mavlink import load_dialect
from zmav.wire import MissionItem

ENUMS = load_dialect().enums
FRAMES = ("MAV_FRAME_GLOBAL", "MAV_FRAME_GLOBAL_RELATIVE_ALT", "MAV_FRAME_GLOBAL_TERRAIN_ALT", "MAV_FRAME_MISSION")
WAYPOINT, JUMP, RALLY = "MAV_CMD_NAV_WAYPOINT", "MAV_CMD_DO_JUMP", "MAV_CMD_NAV_RALLY_POINT"


def simple(command: Any = 16, jump_id: int | None = None, **more: Any) -> dict[str, Any]:
    """A SimpleItem as QGroundControl writes it."""
    item = {
        "AMSLAltAboveTerrain": None,
        "Altitude": 50,
        "AltitudeMode": 1,
        "autoContinue": True,
        "command": command,
        "frame": 3,
        "params": [0, 0, 0, None, 47.39, 8.54, 50],
        "type": "SimpleItem",
        **more,
    }
    return item if jump_id is None else {**item, "doJumpId": jump_id}


def survey(*items: dict[str, Any]) -> dict[str, Any]:
    """A survey, of which the generated items matter."""
    return {
        "type": "ComplexItem",
        "complexItemType": "survey",
        "angle": 90,
        "polygon": [[47.0, 8.0]],
        "TransectStyleComplexItem": {"CameraCalc": {"version": 1}, "Items": list(items), "version": 1},
    }


def file(*items: dict[str, Any], **more: Any) -> dict[str, Any]:
    """A whole .plan."""
    return {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "QGroundControl",
        "geoFence": {"circles": [], "polygons": [], "version": 2},
        "rallyPoints": {"points": [], "version": 2},
        "mission": {
            "cruiseSpeed": 15,
            "firmwareType": 12,
            "globalPlanAltitudeMode": 1,
            "hoverSpeed": 5,
            "items": list(items),
            "plannedHomePosition": [47.3977, 8.5456, 488.1],
            "vehicleType": 2,
            "version": 2,
        },
        **more,
    }


def read(document: Any) -> Plan:
    return plan.read(json.dumps(document).encode(), ENUMS, "survey.plan")


# Reading.


def test_simple_items() -> None:
    got = read(
        file(
            simple(22, 1),
            simple(16, 2, params=[1.5, 2, 3, 4, -35.1, 149.2, 12.5], autoContinue=False),
            simple(20, 3, frame=2),
        )
    )
    assert got.mission == [
        MissionItem(command="MAV_CMD_NAV_TAKEOFF", params=[0, 0, 0, None], x=47.39, y=8.54, z=50),
        MissionItem(command=WAYPOINT, params=[1.5, 2, 3, 4], x=-35.1, y=149.2, z=12.5, autocontinue=False),
        MissionItem(
            command="MAV_CMD_NAV_RETURN_TO_LAUNCH",
            frame="MAV_FRAME_MISSION",
            params=[0, 0, 0, None],
            x=47.39,
            y=8.54,
            z=50,
        ),
    ]
    assert (got.home, got.firmware, got.vehicle) == ((47.3977, 8.5456, 488.1), 12, 2)
    assert (got.fence, got.rally) == ([], [])


def test_the_items_generated_for_a_survey_are_taken() -> None:
    got = read(file(simple(22, 1), survey(simple(16, 2, params=[0] * 6 + [7]), simple(206, 3, frame=2)), simple(20, 4)))
    assert got.mission is not None
    assert [(i.command, i.z) for i in got.mission] == [
        ("MAV_CMD_NAV_TAKEOFF", 50),
        (WAYPOINT, 7),
        ("MAV_CMD_DO_SET_CAM_TRIGG_DIST", 50),
        ("MAV_CMD_NAV_RETURN_TO_LAUNCH", 50),
    ]


def test_jumps_go_to_items_by_their_doJumpId() -> None:
    items = [simple(22, 1), survey(simple(16, 5), simple(16, 6)), simple(177, 9, frame=2, params=[6, 3, 0, 0, 0, 0, 0])]
    got = read(file(*items)).mission
    assert got is not None
    assert (got[3].command, got[3].params[:2]) == (JUMP, [2.0, 3])


def test_an_item_without_a_doJumpId_takes_its_place_from_no_other() -> None:
    got = read(file(simple(22, 2), simple(16), simple(16), simple(177, 4, params=[2, 1, 0, 0, 0, 0, 0]))).mission
    assert got is not None and got[3].params[0] == 0.0
    got = read(file(simple(22, 2), simple(16), simple(16), simple(177, 4, params=[3, 1, 0, 0, 0, 0, 0]))).mission
    assert got is not None and got[3].params[0] == 2.0


def test_fence_and_rally_points() -> None:
    ring = [[47.1, 8.1], [47.2, 8.1], [47.2, 8.2], [47.1, 8.2]]
    got = read(
        file(
            geoFence={
                "circles": [{"circle": {"center": [47.15, 8.15], "radius": 33.5}, "inclusion": False, "version": 1}],
                "polygons": [{"inclusion": True, "polygon": ring, "version": 1}],
                "breachReturn": [47.12, 8.12, 30],
                "version": 2,
            },
            rallyPoints={"points": [[47.11, 8.11, 25]], "version": 2},
        )
    )
    assert got.fence is not None
    assert fence.shapes(got.fence) == [
        fence.Polygon(tuple((x, y) for x, y in ring), True),
        fence.Circle((47.15, 8.15), 33.5, False),
        fence.Return((47.12, 8.12, 30)),
    ]
    assert [i.params for i in got.fence] == [[4.0]] * 4 + [[33.5], []]
    assert got.rally == [MissionItem(command=RALLY, x=47.11, y=8.11, z=25)]


def test_only_a_fence() -> None:
    document = file()
    del document["mission"], document["rallyPoints"]
    got = read(document)
    assert (got.mission, got.fence, got.rally, got.home) == (None, [], None, None)


def test_a_command_of_another_dialect_is_passed_on() -> None:
    got = read(file(simple(31999)))
    assert got.mission is not None
    assert got.mission[0].command == "UNKNOWN_31999"


def without(document: dict[str, Any], *path: Any) -> dict[str, Any]:
    """The same document without a part of it."""
    copy = json.loads(json.dumps(document))
    inside = copy
    for each in path[:-1]:
        inside = inside[each]
    del inside[path[-1]]
    return copy  # type: ignore[no-any-return]


@pytest.mark.parametrize(
    ("document", "path", "words"),
    [
        (without(file(), "fileType"), "$", "missing required field `fileType`"),
        (file(fileType="Params"), "$.fileType", "'Params', expected 'Plan'"),
        (file(version=2), "$.version", "version 2, expected 1"),
        (file(geoFence={"version": 1, "polygon": []}), "$.geoFence.version", "version 1, expected 2"),
        (file(mission={"version": 1, "items": []}), "$.mission.version", "newer QGroundControl"),
        (file(simple(), simple(params=[0] * 4)), "$.mission.items[1].params", "4 values, expected 7"),
        (file(simple(params=[0, 0, 0, "x", 0, 0, 0])), "$.mission.items[0].params[3]", "Expected `float | null`"),
        (file(simple(command="16")), "$.mission.items[0].command", "Expected `int`"),
        (file(simple(command=-1)), "$.mission.items[0].command", "no command has the number -1"),
        (file(simple(frame=99)), "$.mission.items[0].frame", "no frame has the number 99"),
        (file(simple(type="Simple")), "$.mission.items[0].type", "Invalid value 'Simple'"),
        (file({"type": "ComplexItem", "complexItemType": "StructureScan"}), "$.mission.items[0]", "StructureScan"),
        (file(survey(simple(), simple(frame=99))), "$.mission.items[0].TransectStyleComplexItem.Items[1].frame", "99"),
        (file(simple(177, 1, params=[7, 1, 0, 0, 0, 0, 0])), "$.mission.items[0].params[0]", "7.0, which no item has"),
        (
            file(simple(16, 1), simple(16, 1), simple(177, 3, params=[1, 1, 0, 0, 0, 0, 0])),
            "$.mission.items[2].params[0]",
            "1.0, which two items have: give each its own",
        ),
        (
            file(simple(), simple(177, 2, params=[1.7, 1, 0, 0, 0, 0, 0])),
            "$.mission.items[1].params[0]",
            "jumps to the doJumpId 1.7, which no item has",
        ),
        (file(rallyPoints={"version": 2, "points": [[1, 2]]}), "$.rallyPoints.points[0]", "length 3"),
        ([], "$", "Expected `object`"),
    ],
)
def test_what_is_wrong_is_named_by_its_path(document: Any, path: str, words: str) -> None:
    with pytest.raises(BadInput) as caught:
        read(document)
    assert caught.value.detail["field"] == path
    assert words in caught.value.message
    assert caught.value.message.startswith(f"survey.plan: {path}: ")


@pytest.mark.parametrize("data", [b"", b"{", b"\xff\xfe{}", b'{"x":' + b"[" * 100_000])
def test_what_is_no_json_is_told(data: bytes) -> None:
    with pytest.raises(BadInput, match=r"^x\.plan: \$: not JSON"):
        plan.read(data, ENUMS, "x.plan")


# Writing.


def test_what_qgroundcontrol_needs_is_written() -> None:
    items = [
        MissionItem(command=WAYPOINT, params=[1, None], x=47.1, y=8.1, z=30.5),
        MissionItem(command=WAYPOINT, frame="MAV_FRAME_GLOBAL", x=47.1, y=8.1, z=530),
        MissionItem(command=WAYPOINT, frame="MAV_FRAME_GLOBAL_TERRAIN_ALT", x=47.1, y=8.1, z=20),
        MissionItem(command=JUMP, frame="MAV_FRAME_MISSION", params=[1, 2]),
    ]
    written = json.loads(plan.write(Plan(mission=items, firmware=12), ENUMS))
    assert set(written) == {"fileType", "geoFence", "groundStation", "mission", "rallyPoints", "version"}
    mission = written["mission"]
    assert (mission["version"], mission["firmwareType"], mission["vehicleType"]) == (2, 12, 2)
    assert mission["plannedHomePosition"] == [47.1, 8.1, 0.0]
    got = mission["items"]
    assert [i["doJumpId"] for i in got] == [1, 2, 3, 4]
    assert [i.get("AltitudeMode") for i in got] == [1, 2, 4, None]
    assert [i.get("Altitude") for i in got] == [30.5, 530, 20, None]
    assert got[0]["params"] == [1, None, 0, 0, 47.1, 8.1, 30.5]
    assert got[3]["params"][:2] == [2, 2]  # doJumpIds count from 1
    assert (written["geoFence"]["version"], written["rallyPoints"]["version"], written["version"]) == (2, 2, 1)


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (Plan(mission=[MissionItem(command="X")]), "no command 'X'"),
        (Plan(mission=[MissionItem(command=WAYPOINT, frame="X")]), "no frame 'X'"),
        (Plan(mission=[MissionItem(command=WAYPOINT, params=[0] * 5)]), "5 params"),
        (Plan(rally=[MissionItem(command=RALLY, frame="MAV_FRAME_GLOBAL")]), "rally point 0 is .* in MAV_FRAME_GLOBAL"),
        (Plan(fence=[MissionItem(command=WAYPOINT)]), "not a fence: item 0: .* is no fence item"),
        (Plan(fence=fence.items([fence.Return((0, 0, 0))] * 2)), "one return point"),
        (Plan(fence=[MissionItem(command=fence.VERTEX[True], params=[math.inf])]), "not inf"),
        (Plan(fence=[MissionItem(command=fence.CIRCLE[True], params=[math.nan])]), "radius nan"),
        (Plan(fence=[MissionItem(command=fence.CIRCLE[True], params=[math.inf])]), "radius inf"),
    ],
)
def test_what_a_plan_cannot_hold(bad: Plan, words: str) -> None:
    with pytest.raises(BadInput, match=words):
        plan.write(bad, ENUMS)


# There and back.

finite = st.floats(-1e6, 1e6)
latitudes, longitudes = st.floats(-90, 90), st.floats(-180, 180)
commands = st.sampled_from([name for name in ENUMS["MAV_CMD"] if "FENCE" not in name and name not in (JUMP, RALLY)])
items = st.builds(
    MissionItem,
    command=commands,
    frame=st.sampled_from(FRAMES),
    params=st.lists(st.none() | finite, min_size=4, max_size=4),
    x=latitudes,
    y=longitudes,
    z=finite,
    autocontinue=st.booleans(),
)
vertices = st.tuples(latitudes, longitudes)
shapes = st.one_of(
    st.builds(fence.Polygon, st.lists(vertices, min_size=3, max_size=6).map(tuple), st.booleans()),
    st.builds(fence.Circle, vertices, st.floats(0.1, 1e5), st.booleans()),
)
homes = st.none() | st.tuples(latitudes, longitudes, finite)


@st.composite
def missions(draw: st.DrawFn) -> list[MissionItem]:
    """Items, some of them jumps to others."""
    found = draw(st.lists(items, max_size=8))
    for i in range(len(found)):
        if draw(st.integers(0, 4)) == 0:
            target = float(draw(st.integers(0, len(found) - 1)))
            found[i] = MissionItem(command=JUMP, frame="MAV_FRAME_MISSION", params=[target, 3.0, 0.0, 0.0])
    return found


@given(missions(), st.lists(shapes, max_size=4), st.lists(st.tuples(latitudes, longitudes, finite), max_size=4), homes)
def test_a_plan_comes_back_as_it_went(
    mission: list[MissionItem], around: list[fence.Shape], rally: list[tuple[float, float, float]], home: Any
) -> None:
    polygons = [shape for shape in around if isinstance(shape, fence.Polygon)]
    circles = [shape for shape in around if isinstance(shape, fence.Circle)]
    whole = Plan(
        mission=mission,
        fence=fence.items([*polygons, *circles]),
        home=home,
        rally=[MissionItem(command=RALLY, x=x, y=y, z=z) for x, y, z in rally],
    )
    got = plan.read(plan.write(whole, ENUMS), ENUMS)
    assert (got.mission, got.fence, got.rally) == (whole.mission, whole.fence, whole.rally)
    assert home is None or got.home == home


@given(st.lists(shapes, max_size=5))
def test_fence_items_carry_their_shapes(around: list[fence.Shape]) -> None:
    assert fence.shapes(fence.items(around)) == around


@given(st.integers(0, 0xFFFF))
def test_every_command_has_a_name(number: int) -> None:
    assert command_number(command_name(number, ENUMS), ENUMS) == number


scalars = st.none() | st.booleans() | finite | st.text(max_size=5)
names = st.sampled_from(["fileType", "mission", "items", "version", "params", "type"])
documents = st.recursive(
    scalars, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(names, inner, max_size=4), max_leaves=15
)


@given(documents)
def test_any_json_is_read_or_refused_in_words(document: Any) -> None:
    try:
        read(document)
    except BadInput as e:
        assert e.detail["field"]


def test_files_by_their_names(tmp_path: Path) -> None:
    what = Plan(mission=[MissionItem(command=WAYPOINT, params=[0.0] * 4, x=1.0, y=2.0, z=3.0)])
    for name in ("a.plan", "b.waypoints", "c.TXT"):
        plans.save(tmp_path / name, what, ENUMS)
        assert plans.load(tmp_path / name, ENUMS).mission == what.mission
    with pytest.raises(BadInput, match=r"must end in one of \.plan"):
        plans.load(tmp_path / "a.json", ENUMS)
    with pytest.raises(BadInput, match=r"cannot read .*none\.plan: No such file"):
        plans.load(tmp_path / "none.plan", ENUMS)
    with pytest.raises(BadInput, match="cannot write"):
        plans.save(tmp_path / "no" / "a.plan", what, ENUMS)
    (tmp_path / "bad.plan").write_text("{")
    with pytest.raises(BadInput, match=r"bad\.plan: \$: not JSON"):
        plans.load(tmp_path / "bad.plan", ENUMS)
