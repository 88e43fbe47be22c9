"""``zmav fly``: a level from the shell, and what is wrong said before anything flies."""

from __future__ import annotations

import inspect
import math
import re
from typing import TYPE_CHECKING

import pytest

from zmav import wire
from zmav.cli.fly import OWN
from zmav.errors import BadInput, Refused
from zmav.rotation import from_euler
from zmav.vehicle import Lease

if TYPE_CHECKING:
    from tests.cli.conftest import Here, Vehicle


@pytest.mark.usefixtures("hurried")
def test_levels_from_the_shell(vehicle: Vehicle) -> None:
    zmav, sim = vehicle.zmav, vehicle.sim
    zmav("do", "quad1", "arm")
    zmav("do", "quad1", "takeoff", "alt_rel=5")
    north = sim.status().ned_m[0]
    (line,) = zmav("fly", "quad1", "--vel", "1,0,0", "--for", "0.6", "--json").lines
    assert (line["vehicle"], line["sent"]) == ("quad1", 12)
    assert line["counts"]["flown"] >= 6
    assert sim.status().ned_m[0] > north + 1.0  # the simulator runs at eight times the clock
    told = zmav("fly", "quad1", "--rpy", "0", "-0.1", "0", "--thrust", "0.5", "--for", "0.3", "--rate", "30")
    assert re.match(r"quad1: 9 setpoints in \d\.\d s \(", told.out)
    vehicle.until(lambda s: s.lease is None and s.mode == "GUIDED")
    failed = zmav.fails("fly", "quad1", "--torque", "0", "0", "0.1", "--thrust", "0.5", "--for", "0.3")
    assert isinstance(failed.error, Refused)
    assert "ArduPilot takes no torques" in str(failed.error)
    zmav("do", "quad1", "land")
    zmav("do", "quad1", "set_mode", "mode=STABILIZE")
    vehicle.until(lambda s: bool(s.ready and not s.armed and s.mode == "STABILIZE"))


@pytest.mark.parametrize(
    "arguments",
    [
        (),
        ("--vel", "1,0"),
        ("--pos", "1", "0", "-5"),
        ("--at", "1", "2"),
        ("--alt", "3"),
        ("--vel", "nan,0,0"),
        ("--vel", "1,0,0", "--for", "0"),
    ],
)
def test_misuse_is_refused_before_anything_is_done(here: type[Here], arguments: tuple[str, ...]) -> None:
    here("-e", "tcp/127.0.0.1:1").misused("fly", "quad1", *arguments)


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        (("--vel", "1,0,0", "--thrust", "0.5"), "thrust"),
        (("--thrust", "0.5"), "thrust"),
        (("--rc", "1500,high"), "rc"),
        (("--yaw", "1", "--rates", "0", "0", "0", "--thrust", "0"), "rates"),
    ],
)
def test_faults_are_named_before_anything_is_done(here: type[Here], arguments: tuple[str, ...], field: str) -> None:
    error = here("-e", "tcp/127.0.0.1:1").fails("fly", "quad1", *arguments).error
    assert isinstance(error, BadInput)
    assert error.detail["field"] == field


@pytest.mark.parametrize(
    ("roll", "pitch", "yaw"), [(0.0, 0.0, 0.0), (0.3, 0.0, 0.0), (0.0, -0.4, 0.0), (0.0, 0.0, 2.0), (0.3, -0.4, 2.0)]
)
def test_a_quaternion_turns_the_nose_where_it_says(roll: float, pitch: float, yaw: float) -> None:
    """The body's forward and down axes in NED, as the three turns by themselves give them."""
    w, x, y, z = from_euler(roll, pitch, yaw)
    forward = (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y))
    assert forward == pytest.approx(
        (math.cos(pitch) * math.cos(yaw), math.cos(pitch) * math.sin(yaw), -math.sin(pitch))
    )
    assert 1 - 2 * (x * x + y * y) == pytest.approx(math.cos(roll) * math.cos(pitch))


def test_each_field_of_a_setpoint_is_put_or_kept_out() -> None:
    """One that comes to the wire, and not here, would break each 'zmav fly'."""
    put = inspect.signature(Lease.setpoint).parameters
    assert {name for name in wire.Setpoint.__struct_fields__ if name not in OWN} <= set(put)
