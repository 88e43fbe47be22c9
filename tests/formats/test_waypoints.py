"""QGC WPL 110: what is read, what is written, and what is refused by its line."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zmav.errors import BadInput
from zmav.formats import fence, waypoints
from zmav.formats.items import Plan
from zmav.mavlink import load_dialect
from zmav.wire import MissionItem

ENUMS = load_dialect().enums
WAYPOINT, JUMP, RALLY = "MAV_CMD_NAV_WAYPOINT", "MAV_CMD_DO_JUMP", "MAV_CMD_NAV_RALLY_POINT"
HOME = "0\t1\t0\t16\t0\t0\t0\t0\t-35.363262\t149.165237\t584.09\t1"
FILE = f"""QGC WPL 110
{HOME}
1\t0\t3\t22\t0\t0\t0\t0\t0\t0\t10\t1
2\t0\t3\t16\t2.5\t0\t0\tnan\t-35.3631\t149.1652\t12.5\t0
3\t0\t2\t177\t1\t3\t0\t0\t0\t0\t0\t1
"""


def read(text: str) -> Plan:
    return waypoints.read(text.encode(), ENUMS, "field.waypoints")


def test_the_first_row_is_home() -> None:
    got = read(FILE)
    assert got.home == (-35.363262, 149.165237, 584.09)
    assert got.mission == [
        MissionItem(command="MAV_CMD_NAV_TAKEOFF", params=[0, 0, 0, 0], z=10),
        MissionItem(command=WAYPOINT, params=[2.5, 0, 0, None], x=-35.3631, y=149.1652, z=12.5, autocontinue=False),
        MissionItem(command=JUMP, frame="MAV_FRAME_MISSION", params=[0, 3, 0, 0]),  # rows count home, items do not
    ]
    assert (got.fence, got.rally) == (None, None)


@pytest.mark.parametrize(
    "text",
    [
        FILE.replace("\n", "\r\n"),
        "\ufeff" + FILE,
        FILE.replace("\t", "  "),
        FILE.replace(HOME, f"# by hand\n\n{HOME}"),
        FILE.replace("\t22\t0\t", "\t22.000000\t0.00000000\t"),
    ],
)
def test_as_different_programs_write_it(text: str) -> None:
    assert read(text) == read(FILE)


@pytest.mark.parametrize(("text", "count"), [("QGC WPL 110\n", 0), (f"QGC WPL 110\n{HOME}\n", 0), (FILE, 3)])
def test_how_many(text: str, count: int) -> None:
    mission = read(text).mission
    assert mission is not None
    assert len(mission) == count


@pytest.mark.parametrize("kind", ["fence", "rally"])
def test_the_kind_is_seen_by_the_commands(kind: str) -> None:
    rally = [MissionItem(command=RALLY, params=[0.0] * 4, x=1.5, y=2.5, z=20)]
    around = fence.items([fence.Circle((1.5, 2.5), 30.0), fence.Polygon(((0, 0), (0, 1), (1, 0)), False)])
    for item in around:
        item.params += [0.0] * 3
    items = {"fence": around, "rally": rally}[kind]
    got = waypoints.read(waypoints.write(Plan(**{kind: items}), ENUMS), ENUMS)  # type: ignore[arg-type]
    assert getattr(got, kind) == items
    assert got.mission is None


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("", 1, "expected 'QGC WPL 110'"),
        ("QGC WPL 120\n", 1, "expected 'QGC WPL 110'"),
        (FILE.replace("\t10\t1\n", "\t10\n"), 3, "11 columns, expected 12: index current frame"),
        (FILE.replace("-35.3631", "south"), 4, "x: 'south' is not a number"),
        (FILE.replace("-35.3631", "inf"), 4, "x: 'inf' is not a number that it can be"),
        (FILE.replace("2\t0\t3\t16", "3\t0\t3\t16"), 4, "index 3, expected 2"),
        (FILE.replace("2\t0\t3\t16", "2\t0\t77\t16"), 4, "frame: no frame has the number 77"),
        (FILE.replace("2\t0\t3\t16", "2\t0\t3\t99999"), 4, "command: no command has the number 99999"),
        (FILE.replace("2\t0\t3\t16", "2\t0\t3.5\t16"), 4, "frame: 3.5 is not a whole number"),
        (FILE.replace("177\t1", "177\t4"), 5, "jumps to row 4, which there is not"),
        (FILE.replace("177\t1", "177\t0"), 5, "jumps to row 0"),
        (FILE.replace("177\t1", "177\tnan"), 5, "jumps to row nan"),
        (FILE.replace("0\t1\t0\t16", "0\t1\t0\t22"), 2, "first row is home, a waypoint (16), not MAV_CMD_NAV_TAKEOFF"),
    ],
)
def test_what_is_wrong_is_named_by_its_line(text: str, line: int, words: str) -> None:
    with pytest.raises(BadInput) as caught:
        read(text)
    assert caught.value.message.startswith(f"field.waypoints: line {line}: ")
    assert words in caught.value.message
    assert caught.value.detail["field"] == f"line {line}"


def test_bytes_that_are_no_text() -> None:
    with pytest.raises(BadInput, match="line 1: not text"):
        waypoints.read(b"\xff\xfe\x00", ENUMS)


def test_one_kind_a_file() -> None:
    both = Plan(mission=[MissionItem(command=WAYPOINT)], rally=[MissionItem(command=RALLY)])
    with pytest.raises(BadInput, match="one kind, not mission and rally: choose one, or write"):
        waypoints.write(both, ENUMS)


def test_written_as_people_know_it() -> None:
    lines = waypoints.write(read(FILE), ENUMS).decode().splitlines()
    assert lines == FILE.splitlines()


numbers = st.floats(allow_nan=False, allow_infinity=False)
items = st.builds(
    MissionItem,
    command=st.sampled_from([name for name in ENUMS["MAV_CMD"] if name != JUMP]),
    frame=st.sampled_from(list(ENUMS["MAV_FRAME"])),
    params=st.lists(st.none() | numbers, min_size=4, max_size=4),
    x=numbers,
    y=numbers,
    z=numbers,
    autocontinue=st.booleans(),
)


@given(st.lists(items, max_size=6), st.data())
def test_a_file_comes_back_as_it_went(mission: list[MissionItem], data: st.DataObject) -> None:
    if mission:
        target = float(data.draw(st.integers(0, len(mission))))
        mission.append(MissionItem(command=JUMP, frame="MAV_FRAME_MISSION", params=[target, 2.0, 0.0, 0.0]))
    got = waypoints.read(waypoints.write(Plan(mission=mission), ENUMS), ENUMS)
    assert getattr(got, waypoints.kind_of(mission)) == mission


@given(st.text(alphabet="QGCWPL10 \t\n.-nax5", max_size=80))
def test_any_text_is_read_or_refused_in_words(text: str) -> None:
    try:
        read(f"QGC WPL 110\n{text}")
    except BadInput as e:
        assert e.detail["field"].startswith("line ")
