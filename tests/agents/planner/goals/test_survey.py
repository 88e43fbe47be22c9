"""Surveys: lanes by what the camera sees, pictures by the overlaps, and what each vehicle needs for its part."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner

from agents.planner.cli.survey import camera, overlaps, survey
from agents.planner.goals.goals import resolve
from agents.planner.goals.steps import FleetView, Fly, PlanTo
from agents.planner.live.checks import check_goal
from tests.agents.planner.goals.team import fly_all, ground, judge_fly, lasting, team, view
from zmav.errors import BadInput, Refused, Unsupported
from zmav.wire import swarm

AREA = [(0.0, 0.0), (120.0, 0.0), (120.0, 80.0), (0.0, 80.0)]
CAMERA = (1.5, 1.0)


def goal(names: list[str], **more: Any) -> swarm.Survey:
    return swarm.Survey(
        **{"vehicles": names, "polygon": AREA, "height": 30.0, "camera": CAMERA, "pixels": 4500, **more}
    )


def flown(fleet: FleetView, **more: Any) -> Fly:
    _, lanes, _ = resolve(goal(list(fleet.vehicles), **more), fleet, ground())
    assert isinstance(lanes, Fly)
    return lanes


def test_a_survey_is_flown_there_and_back_and_nobody_meets() -> None:
    fleet, world = team(3), ground()
    steps = resolve(goal(list(fleet.vehicles)), fleet, world)
    there, lanes, back = steps
    assert isinstance(there, PlanTo) and isinstance(lanes, Fly) and isinstance(back, PlanTo)
    assert judge_fly(lanes, fleet, world).ok
    assert fly_all(steps, fleet, world) < 1.1 * max(each["seconds"] for each in lanes.figures.values())
    assert "100.0 % seen" in lanes.text and "one every 7.5 m, 1.0 cm a pixel" in lanes.text


def test_lanes_stand_as_far_apart_as_camera_height_and_sidelap_say() -> None:
    """45 m seen at 30 m, of which 65 % again: at most 15.75 m, so six over 80 m."""
    lanes = flown(team(1), angle=0.0)
    (motion,) = lanes.motions.values()
    on_lane = motion[(motion[:, 2] > 10.0) & (motion[:, 2] < 110.0)]
    rows = sorted({round(float(x), 1) for x in on_lane[:, 1]})
    assert len(rows) == 6
    assert rows == pytest.approx([80.0 / 6.0 * (k + 0.5) for k in range(6)], abs=0.1)


def test_a_heading_is_taken() -> None:
    (motion,) = flown(team(1), angle=math.radians(90.0)).motions.values()
    on_lane = motion[(motion[:, 1] > 10.0) & (motion[:, 1] < 70.0)]
    assert len({round(float(y), 1) for y in on_lane[:, 2]}) == math.ceil(120.0 / 15.75)


def test_figures_are_those_of_the_way() -> None:
    fleet = team(2, endurance=600.0)
    lanes = flown(fleet)
    assert set(lanes.figures) == set(fleet.vehicles)
    for name, figures in lanes.figures.items():
        motion = lanes.motions[name]
        way = sum(math.dist(a, b) for a, b in zip(motion[:-1, 1:], motion[1:, 1:], strict=True))
        assert figures["metres"] > way
        assert figures["pictures"] == pytest.approx(way / 7.5, rel=0.1, abs=2.0)
        assert figures["battery"] == pytest.approx(figures["seconds"] / 600.0)
        assert figures["seconds"] > lasting(lanes) * 0.5
    more = flown(fleet, front=0.9).figures
    assert sum(f["pictures"] for f in more.values()) > 2.0 * sum(f["pictures"] for f in lanes.figures.values())


def test_heights_count_from_where_each_took_off() -> None:
    one = view("c1", (0.0, 0.0, -60.0))
    hill = FleetView({"c1": type(one)(**{**vars(one), "home_ned": (0.0, 0.0, -50.0)})})
    (motion,) = flown(hill, height=9.0, overlap=0.3).motions.values()
    assert motion[:, 3] == pytest.approx(59.0)


def test_who_cannot_is_named() -> None:
    fleet = FleetView(
        {
            "c1": view("c1", (-20.0, -20.0, -10.0)),
            "r1": view("r1", (-20.0, -30.0, 0.0), "rover", airborne=False),
            "p1": view("p1", (-60.0, -60.0, -40.0), "plane"),
            "down": view("down", (-30.0, -30.0, 0.0), airborne=False),
        }
    )
    for names, error, text in (
        (["c1", "p1"], Unsupported, "p1 cannot hover, as a survey"),
        (["c1", "r1"], Unsupported, "r1 cannot look down"),
        (["c1", "down"], Refused, "down is on the ground: take off before a survey"),
    ):
        with pytest.raises(error, match=text):
            resolve(goal(names), fleet, ground())


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("camera", (0.0, 1.0)),
        ("camera", (1.5, -1.0)),
        ("camera", (math.inf, 1.0)),
        ("height", 0.0),
        ("height", math.nan),
        ("overlap", 0.95),
        ("front", 1.0),
        ("front", -0.1),
        ("pixels", -1),
        ("polygon", AREA[:2]),
    ],
)
def test_nonsense_is_refused_by_its_field(field: str, value: Any) -> None:
    check_goal(goal(["c1"]))
    with pytest.raises(BadInput, match=rf"goal\.{field}|polygon has 2") as e:
        check_goal(goal(["c1"], **{field: value}))
    assert str(e.value.detail["field"]).startswith(f"goal.{field}")


def test_a_height_above_the_ground_is_one() -> None:
    check_goal(goal(["c1"], above_ground=True))
    for height in (0.0, -5.0):
        with pytest.raises(BadInput, match=r"goal\.height"):
            check_goal(swarm.Search(vehicles=["c1"], polygon=AREA, height=height, above_ground=True))


@pytest.mark.parametrize("height", [0.1, 5000.0])
def test_pictures_that_no_autopilot_triggers_are_refused_before_anybody_moves(height: float) -> None:
    check_goal(goal(["c1"], height=height))
    with pytest.raises(BadInput, match=r"a picture every .* m is not triggered") as e:
        check_goal(goal(["c1"], height=height, trigger=True))
    assert e.value.detail["field"] == "goal.trigger"


def test_a_camera_is_a_sensor_an_angle_or_a_calibration(tmp_path: Path) -> None:
    assert camera("13.2x8.8/8.8") == pytest.approx((1.5, 1.0, 0))
    assert camera("90x53.13deg") == pytest.approx((2.0, 1.0, 0), abs=1e-4)
    file = tmp_path / "down.toml"
    file.write_text("width = 480\nheight = 640\nfocal = [400.0, 400.0]\ncenter = [239.5, 319.5]\n", encoding="utf-8")
    assert camera(str(file)) == pytest.approx((1.6, 1.2, 640))
    for text in ("13.2x8.8", "13.2x8.8/0", "200x80deg", str(tmp_path / "none.toml"), "0x0/8"):
        with pytest.raises(click.BadParameter, match="sensor over a focal length"):
            camera(text)


def test_overlaps_are_shares() -> None:
    assert overlaps("0.8,0.6") == (0.8, 0.6) and overlaps("0.7") == (0.7, 0.7)
    for text in ("75,65", "x", "0.1,0.2,0.3", "nan"):
        with pytest.raises(click.BadParameter, match="shares of a picture"):
            overlaps(text)


@pytest.mark.parametrize(
    ("more", "text"),
    [
        ([], "give one of --height, --above-ground and --gsd"),
        (["--height", "30", "--gsd", "2"], "give one of --height, --above-ground and --gsd"),
        (["--height", "30", "--above-ground", "20"], "give one of --height, --above-ground and --gsd"),
        (["--gsd", "2"], "--gsd needs --pixels"),
        (["--height", "0"], "above the ground"),
        (["--height", "nan"], "above the ground"),
    ],
)
def test_a_survey_without_one_height_is_not_asked_for(more: list[str], text: str) -> None:
    given = ["quad1", "--polygon", "0,0 9,0 9,9", "--camera", "13.2x8.8/8.8", *more]
    result = CliRunner().invoke(survey, given)
    assert result.exit_code == 2 and text in result.output
