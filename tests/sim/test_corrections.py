"""Corrections in the simulator: what the receiver makes of them, step by step, and the faults that they can have."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import pytest

from tests.rtcm import base_at, message
from zmav.mavlink.rtcm import cut, fields
from zmav.sim import VehicleSpec
from zmav.sim.protocol.corrections import FIXED, FLOAT, PLAIN

if TYPE_CHECKING:
    from tests.sim.conftest import Gcs, MakeGcs

BARE = {"ardupilot": 6, "px4": 3}
"""GPS_FIX_TYPE without corrections"""


class Base:
    """Corrects the vehicle on a ground station, once a simulated second."""

    def __init__(self, gcs: Gcs) -> None:
        self.gcs, self._sequence = gcs, itertools.count()
        self.station = 1

    def corrects(self, seconds: int, *messages: bytes) -> int:
        """The fix after so many seconds of corrections."""
        for _ in range(seconds):
            for data in messages or (base_at(station=self.station), message(1077, size=300, station=self.station)):
                for flags, piece in cut(data, next(self._sequence)):
                    self.gcs.send("GPS_RTCM_DATA", **fields(flags, piece))
            self.gcs.world.step(1.0)
        return self.fix()

    def fix(self) -> int:
        told = self.gcs.vehicle.node.fields("GPS_RAW_INT")
        assert told is not None
        return int(told["fix_type"])


@pytest.fixture(params=["ardupilot", "px4"])
def base(request: pytest.FixtureRequest, make_gcs: MakeGcs) -> Base:
    gcs = make_gcs([VehicleSpec(autopilot="px4") if request.param == "px4" else VehicleSpec()])
    gcs.world.step(1.0)
    found = Base(gcs)
    assert found.fix() == BARE[request.param]
    return found


def test_floats_come_first_then_it_has_fixed_and_loses_it_step_by_step(base: Base) -> None:
    assert base.corrects(1) == FLOAT
    assert base.corrects(6) == FIXED
    wanted = base_at(station=1) + message(1077, size=300, station=1)
    assert b"".join(each.data for each in base.gcs.vehicle.node.receiver.messages) == wanted * 7
    base.gcs.world.step(11.0)
    assert base.fix() == FLOAT
    base.gcs.world.step(20.0)
    assert base.fix() == PLAIN
    assert base.corrects(1) == FLOAT
    assert base.corrects(6) == FIXED


def test_another_base_begins_anew(base: Base) -> None:
    assert base.corrects(7) == FIXED
    base.station = 2
    assert base.corrects(1) == FLOAT


def test_a_base_far_away_is_of_no_use(base: Base) -> None:
    assert base.corrects(7, base_at(51.5, -0.1, 100.0), message(1077)) == PLAIN


def test_a_restart_forgets_them(base: Base) -> None:
    assert base.corrects(7) == FIXED
    base.gcs.world.fault(base.gcs.vehicle.name, "reboot")
    base.gcs.world.step(2.0)
    assert base.fix() != FLOAT
    assert not base.gcs.vehicle.node.receiver.messages


class TestFaults:
    def test_they_stop(self, base: Base) -> None:
        assert base.corrects(7) == FIXED
        base.gcs.world.fault(base.gcs.vehicle.name, "rtcm-loss")
        assert base.corrects(12) == FLOAT
        assert base.corrects(20) == PLAIN
        base.gcs.world.clear()
        assert base.corrects(7) == FIXED

    def test_they_are_another_places(self, base: Base) -> None:
        assert base.corrects(7) == FIXED
        base.gcs.world.fault(base.gcs.vehicle.name, "rtcm-foreign")
        assert base.corrects(1) == PLAIN
        base.gcs.world.clear()
        assert base.corrects(1) == FIXED

    def test_they_jump(self, base: Base) -> None:
        base.corrects(7)
        seat, name = base.gcs.vehicle.node.seat, base.gcs.vehicle.name
        before = seat.fix().north
        base.gcs.world.fault(name, "rtcm-jump", north=3.0)
        assert base.corrects(2) == FIXED
        assert seat.fix().north - before == pytest.approx(3.0, abs=0.5)
        base.gcs.world.fault(name, "rtcm-foreign")
        base.corrects(2)
        assert seat.fix().north - before == pytest.approx(0.0, abs=0.5), "without them it does not jump"
        base.gcs.world.clear()


def test_garbage_corrects_nothing(base: Base) -> None:
    bare = base.fix()
    for flags in range(256):
        base.gcs.send("GPS_RTCM_DATA", flags=flags, len=255, data=bytes(flags * i % 256 for i in range(180)))
    base.gcs.world.step(1.0)
    assert base.fix() == bare
