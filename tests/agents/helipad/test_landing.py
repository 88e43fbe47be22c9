"""LANDING_TARGET frames as ArduPilot and PX4 read them."""

from __future__ import annotations

import math

import pytest

from agents.helipad.landing import frame
from zmav.mavlink import decode, describe, load_dialect, parse_frame


def fields(
    autopilot: str,
    offset: tuple[float, float, float],
    turned: tuple[float, float, float] = (0.0, 0.0, 0.0),
    **more: object,
) -> dict[str, object]:
    dialect = load_dialect("ardupilotmega")
    data = frame(dialect, autopilot, 3, 1_000_000, offset, turned, 0.25, **more)  # type: ignore[arg-type]
    assert data is not None
    parsed = parse_frame(data, dialect)
    assert (parsed.sysid, parsed.compid) == (3, 191)
    return {**decode(parsed, dialect), "frame": describe(parsed, dialect).fields["frame"]}


def test_ardupilot_is_told_in_its_own_axes() -> None:
    """Four metres up, the pad a metre ahead and two to the right; the nose to the east."""
    told = fields("ardupilot", (-2.0, 1.0, 4.0), turned=(0.0, 0.0, math.pi / 2.0))
    assert told["frame"] == "MAV_FRAME_BODY_FRD"
    assert (told["x"], told["y"], told["z"]) == pytest.approx((1.0, 2.0, 4.0), abs=1e-6)
    assert told["angle_x"] == pytest.approx(math.atan2(2.0, 4.0))  # to the right
    assert told["angle_y"] == pytest.approx(-math.atan2(1.0, 4.0))  # positive is rearward
    assert told["distance"] == pytest.approx(math.sqrt(21.0))
    assert (told["position_valid"], told["target_num"], told["time_usec"]) == (1, 0, 1_000_000)
    assert told["size_x"] == pytest.approx(0.25 / math.sqrt(21.0))


def test_a_tilted_vehicle_sees_what_is_below_it_to_its_side() -> None:
    """Rolled to the right by 15 degrees: straight down is to the left of its own down."""
    told = fields("ardupilot", (0.0, 0.0, 5.0), turned=(math.radians(15.0), 0.0, 0.0))
    assert (told["x"], told["y"], told["z"]) == pytest.approx(
        (0.0, 5.0 * math.sin(math.radians(15.0)), 5.0 * math.cos(math.radians(15.0))), abs=1e-5
    )
    assert told["distance"] == pytest.approx(5.0)
    pitched = fields("ardupilot", (0.0, 0.0, 5.0), turned=(0.0, 0.2, 0.0))
    assert pitched["x"] == pytest.approx(-5.0 * math.sin(0.2))  # the nose is up: below is behind


def test_px4_is_told_about_its_estimators_origin() -> None:
    told = fields("px4", (-2.0, 1.0, 4.0), local=(10.0, 20.0, -4.5))
    assert told["frame"] == "MAV_FRAME_LOCAL_NED"
    assert (told["x"], told["y"], told["z"]) == pytest.approx((8.0, 21.0, -0.5))


def test_what_cannot_be_told_is_not() -> None:
    dialect = load_dialect("ardupilotmega")
    assert frame(dialect, "px4", 1, 0, (0.0, 0.0, 4.0), (0.0, 0.0, 0.0), 0.25) is None, "its own place is not known"
    assert frame(dialect, "ardupilot", 1, 0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.25) is None, (
        "it divides by the distance"
    )
