"""Names, system ids and starts of all kinds of vehicles, and the words for places, winds and speeds."""

from __future__ import annotations

import itertools
import math

import pytest

from zmav.errors import BadConfig, BadInput
from zmav.sim import Home, VehicleSpec
from zmav.sim.lineup import gather, line_up
from zmav.sim.spec import kind_of
from zmav.sim.values import parse_home, parse_speed, parse_wind

MIXED = {"copter": 2, "hexa": 1, "rover": 2, "plane": 2, "px4": 2}


def lined_up(specs: list[VehicleSpec], yaw_deg: float = 0.0) -> list[VehicleSpec]:
    return line_up(specs, Home(yaw_deg=yaw_deg), 10.0)


def test_kinds_are_counted_each_and_ids_all() -> None:
    specs = lined_up(gather([], MIXED))
    assert [spec.name for spec in specs] == [
        "quad1",
        "quad2",
        "hexa1",
        "rover1",
        "rover2",
        "plane1",
        "plane2",
        "px4-1",
        "px4-2",
    ]
    assert [spec.sysid for spec in specs] == list(range(1, 10))


def test_what_was_given_is_kept_and_gone_around() -> None:
    specs = [VehicleSpec(sysid=2), VehicleSpec(name="quad1"), VehicleSpec(), VehicleSpec(sysid=1), VehicleSpec()]
    found = lined_up(specs)
    assert [(spec.name, spec.sysid) for spec in found] == [
        ("quad2", 2),
        ("quad1", 3),
        ("quad3", 4),
        ("quad4", 1),
        ("quad5", 5),
    ]


@pytest.mark.parametrize("yaw_deg", [0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0])
def test_all_stand_apart_and_the_runway_is_clear(yaw_deg: float) -> None:
    specs = lined_up(gather([], {"copter": 20, "rover": 20, "plane": 5, "px4": 20}), yaw_deg)
    starts = {spec.name or "": spec.start_ned_m or (0.0, 0.0, 0.0) for spec in specs}
    assert min(math.dist(a, b) for a, b in itertools.combinations(starts.values(), 2)) >= 10.0 - 1e-9
    forward = math.cos(math.radians(yaw_deg)), math.sin(math.radians(yaw_deg))
    for spec in specs:
        if kind_of(spec) != "plane":
            continue
        # Nobody else within 15 m of the line along which it takes off.
        n, e, _ = starts[spec.name or ""]
        for name, (north, east, _) in starts.items():
            ahead = (north - n) * forward[0] + (east - e) * forward[1]
            aside = (north - n) * forward[1] - (east - e) * forward[0]
            assert name == spec.name or ahead <= 0.0 or abs(aside) > 15.0, (spec.name, name)


@pytest.mark.parametrize(
    ("specs", "counts", "field"),
    [
        ([VehicleSpec(name="Quad One")], {}, "name"),
        ([VehicleSpec(name="a"), VehicleSpec(name="a")], {}, "name"),
        ([], {"rover": -1}, "rovers"),
        ([], {"px4": -1}, "px4"),
        ([], {"copter": 200, "px4": 56}, "vehicles"),
        ([VehicleSpec(autopilot="ardurover", airframe="plane")], {}, "airframe"),
        ([VehicleSpec(autopilot="ardusub")], {}, "autopilot"),
    ],
)
def test_what_cannot_be_is_named(specs: list[VehicleSpec], counts: dict[str, int], field: str) -> None:
    with pytest.raises(BadInput) as caught:
        lined_up(gather(specs, counts))
    assert caught.value.detail["field"] == field


@pytest.mark.parametrize(
    ("text", "north", "east", "gusts"),
    [
        ("0", 0.0, 0.0, "none"),
        ("5", 0.0, 5.0, "none"),  # from the west
        ("5@0", -5.0, 0.0, "none"),  # from the north
        ("5@180,gusty", 5.0, 0.0, "moderate"),
        ("3.5@90,severe", 0.0, -3.5, "severe"),
        ("4,light", 0.0, 4.0, "light"),
    ],
)
def test_winds_are_called_by_where_they_come_from(text: str, north: float, east: float, gusts: str) -> None:
    wind, found = parse_wind(text)
    assert wind == pytest.approx((north, east, 0.0), abs=1e-9)
    assert found == gusts


@pytest.mark.parametrize("text", ["", "strong", "5@", "5@west", "5,", "5,windy", "-1", "nan", "5@400", "1e9"])
def test_other_winds_are_refused(text: str) -> None:
    with pytest.raises(BadConfig, match="expected SPEED") as caught:
        parse_wind(text)
    assert caught.value.detail == {"field": "wind", "value": text, "expected": caught.value.detail["expected"]}


def test_homes_and_speeds() -> None:
    assert parse_home("47.4,8.5,488,90") == Home(47.4, 8.5, 488.0, 90.0)
    assert (parse_speed("4"), parse_speed("max"), parse_speed("0")) == (4.0, math.inf, math.inf)
    for text in ("47.4,8.5,488", "here", "91,0,0,0", "nan,0,0,0", "0,0,20000,0", "0,0,0,400"):
        with pytest.raises(BadConfig, match="expected"):
            parse_home(text)
    for text in ("fast", "-1", "nan", "inf"):
        with pytest.raises(BadConfig, match="expected a number"):
            parse_speed(text)
