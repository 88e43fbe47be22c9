"""The hot path by itself: frames in, outputs out, and what ends an engagement; no vehicle, no network, no clock."""

from __future__ import annotations

import math
import time
from typing import Any, cast

import numpy as np
import pytest

from agents.controllers.cycle import CLOCK_STEP, Cycles, Phase
from agents.controllers.estimate import MOST_DT, Estimate
from agents.controllers.packets import Answer, unpack_cycle
from agents.controllers.types import RatesThrust
from zmav import wire
from zmav.errors import BadConfig, BadInput
from zmav.mavlink import encode, load_dialect

DIALECT = load_dialect()
US = (1, 1)
ANSWER = RatesThrust(np.zeros(3), 0.5)


class Sample:
    """As Zenoh hands one over."""

    def __init__(self, data: bytes) -> None:
        self.payload = self
        self._data = data

    def to_bytes(self) -> bytes:
        return self._data


class Process:
    """In place of a controller's: keeps what it was asked."""

    names = ("mine",)

    def __init__(self) -> None:
        self.asked: list[bytes] = []

    def send(self, data: bytes) -> bool:
        self.asked.append(data)
        return True


class Rig:
    """Cycles of a vehicle that stands still ten metres up; ``put`` are its setpoints, ``trips`` what ended it."""

    def __init__(self) -> None:
        self.estimate = Estimate((1, 2, 3, 4))
        self.cycles = Cycles(DIALECT, self.estimate)
        self.cycles.source = US
        self.process = cast("Any", Process())
        self.cycles.fly_by(self.process)
        self.trips: list[str] = []
        self.cycles.on_trip = self.trips.append
        self.put: list[dict[str, Any]] = []
        self.ms = 1000

    def setpoint(self, **fields: Any) -> None:
        """As a lease takes it."""
        self.put.append(fields)

    def frame(self, name: str, source: tuple[int, int] = US, **fields: Any) -> None:
        sample: Any = Sample(encode(DIALECT, name, fields, sysid=source[0], compid=source[1], seq=0))
        self.cycles.on_frame(sample)

    def place(self, **more: float) -> None:
        at = {"x": 0.0, "y": 0.0, "z": -10.0, "vx": 0.0, "vy": 0.0, "vz": 0.0, **more}
        self.frame("LOCAL_POSITION_NED", US, time_boot_ms=self.ms, **at)

    def attitude(self, q: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0), source: tuple[int, int] = US) -> None:
        names = ("q1", "q2", "q3", "q4")
        rates = {"rollspeed": 0.0, "pitchspeed": 0.0, "yawspeed": 0.0}
        self.frame("ATTITUDE_QUATERNION", source, time_boot_ms=self.ms, **dict(zip(names, q, strict=True)), **rates)

    def cycle(self, ms: int = 4) -> None:
        self.ms += ms
        self.place()
        self.attitude()

    def engage(self, ms: int = 4) -> None:
        for _ in range(3):
            self.cycle(ms)
            self.answer(None)
        lease: Any = self
        self.cycles.engage(lease, 10.0)
        assert self.cycles.in_force()

    def answer(self, output: RatesThrust | None = ANSWER) -> None:
        """The process answers what it was asked last."""
        number, *_ = unpack_cycle(self.process.asked[-1])
        self.cycles.on_answer(self.process, Answer(number, output, ()))


@pytest.fixture
def rig() -> Rig:
    return Rig()


def test_an_answer_becomes_a_setpoint(rig: Rig) -> None:
    rig.engage()
    rig.cycle()
    rig.answer()
    assert [each["thrust"] for each in rig.put] == [0.5]
    assert rig.trips == []


def test_what_takes_over_before_the_next_attitude_holds_where_it_is(rig: Rig) -> None:
    """No cycle has had a place yet: it flew to the origin."""
    rig.attitude()
    rig.place()
    lease: Any = rig
    rig.cycles.engage(lease, 10.0)
    rig.ms += 4
    rig.attitude()
    _, _, _, reference, _ = unpack_cycle(rig.process.asked[-1])
    assert reference.pos == pytest.approx((0.0, 0.0, -10.0))


def test_what_was_asked_before_it_takes_over_is_not_waited_for(rig: Rig) -> None:
    """Its answer is no output, and the first cycle that has one would be late for it."""
    rig.engage()
    rig.cycles.end()
    rig.cycle()
    lease: Any = rig
    rig.cycles.engage(lease, 10.0)
    rig.cycle()
    rig.answer()
    assert len(rig.put) == 1
    assert rig.cycles.counters.late == 0


def test_another_systems_attitude_over_the_same_link_is_not_ours(rig: Rig) -> None:
    rig.engage()
    rig.ms += 4
    rig.attitude((0.0, 1.0, 0.0, 0.0), source=(2, 1))
    rig.attitude((0.0, 1.0, 0.0, 0.0), source=(1, 154))
    assert rig.trips == []
    np.testing.assert_array_equal(rig.estimate.state.q, [1.0, 0.0, 0.0, 0.0])


def test_an_answer_to_an_earlier_cycle_is_not_flown(rig: Rig) -> None:
    rig.engage()
    rig.cycle()
    number, *_ = unpack_cycle(rig.process.asked[-1])
    rig.cycles.fly_by(rig.process)
    rig.cycle()
    rig.cycles.on_answer(rig.process, Answer(number, ANSWER, ()))
    assert rig.put == []
    rig.answer()
    assert len(rig.put) == 1


def test_attitudes_that_come_at_once_after_a_pause_are_one_late_cycle(rig: Rig) -> None:
    """The computer stood still, and the answer is still to be read: the controller has not missed thirty cycles."""
    rig.engage(ms=100)
    rig.cycle(ms=100)
    time.sleep(0.1)
    for _ in range(30):
        rig.cycle(ms=1)
    assert rig.trips == []
    rig.answer()
    assert len(rig.put) == 1


def test_attitudes_that_keep_coming_without_an_output_hand_back(rig: Rig) -> None:
    rig.engage()
    rig.cycle()
    for _ in range(30):
        time.sleep(0.004)
        rig.cycle()
    assert rig.trips == ["no output for 8 cycles"]


@pytest.mark.parametrize("q", [(0.0, 0.0, 0.0, 0.0), (0.5, 0.0, 0.0, 0.0), (1.3, 0.0, 0.0, 0.0)])
def test_an_attitude_that_is_none_hands_back(rig: Rig, q: tuple[float, ...]) -> None:
    rig.engage()
    rig.ms += 4
    rig.attitude(q)
    assert "no rotation" in rig.trips[0]


def test_attitudes_without_positions_hand_back(rig: Rig) -> None:
    rig.engage()
    for _ in range(200):
        rig.ms += 4
        rig.attitude()
        if rig.cycles.phase:
            rig.answer()
    assert len(rig.trips) == 1
    assert "no position" in rig.trips[0]
    assert not rig.estimate.ready
    rig.cycle()
    assert rig.estimate.ready


def test_a_silence_or_a_clock_that_jumps_is_no_cycles_length(rig: Rig) -> None:
    rig.engage()
    before = rig.estimate.period
    rig.cycle(ms=4_000_000)
    assert rig.estimate.period < before + 0.02 * MOST_DT
    assert rig.estimate.state.dt <= MOST_DT


def test_a_clock_that_goes_back_is_passed_over(rig: Rig) -> None:
    rig.engage()
    rig.cycle(ms=-900)
    asked = len(rig.process.asked)
    rig.cycle()
    assert len(rig.process.asked) == asked + 1
    assert rig.trips == []


def test_a_clock_that_is_set_does_not_move_what_is_followed(rig: Rig) -> None:
    rig.cycles.set_clock(1e9)
    rig.engage()
    t = rig.estimate.state.t
    rig.cycles.set_clock(1e9 + 5.0)
    rig.cycle()
    assert rig.estimate.state.t - t == pytest.approx(0.004 + CLOCK_STEP, abs=1e-5)
    rig.cycles.end()
    rig.cycles.set_clock(1e9 + 5.0)
    rig.cycle()
    assert rig.estimate.state.t - t == pytest.approx(5.008, abs=1e-5)


def test_a_clock_heard_of_late_does_not_move_it_either(rig: Rig) -> None:
    rig.engage()
    rig.cycles.set_clock(1e9)
    rig.cycle()
    assert rig.estimate.state.t < 100.0


def test_a_place_beyond_a_minute_is_refused_in_words(rig: Rig) -> None:
    rig.engage()
    with pytest.raises(BadInput, match="takes 75 s"):
        rig.cycles.references.goto((40.0, 0.0, -10.0), None, 1.0, 2.0, rig.estimate.state)


def test_channels_that_there_are_not_are_refused() -> None:
    with pytest.raises(BadConfig, match="channels 1 to 18"):
        Estimate((1, 2, 3, 19))


def sticks(rig: Rig) -> None:
    chans = {f"chan{i}_raw": 1500 for i in range(1, 19)}
    rig.frame("RC_CHANNELS", US, time_boot_ms=rig.ms, chancount=18, rssi=0, **chans)


def test_sticks_that_are_not_told_any_more_are_not_flown_on(rig: Rig) -> None:
    sticks(rig)
    rig.cycle()
    assert rig.estimate.state.sticks[2] == 0.5
    for _ in range(300):
        rig.cycle()
    assert math.isnan(rig.estimate.state.sticks[2])


def test_rates_of_a_pilot_whose_radio_went_hand_back(rig: Rig) -> None:
    sticks(rig)
    rig.engage()
    rig.cycles.references.by_sticks("rates", rig.estimate.state, 0.5)
    for _ in range(300):
        rig.cycle()
        if rig.cycles.phase:
            rig.answer()
    assert "radio" in rig.trips[0]


def test_what_fails_in_the_supervisor_itself_hands_back(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    rig.engage()

    def broken(state: object) -> None:
        raise OverflowError("planted")

    monkeypatch.setattr(rig.cycles.references, "at", broken)
    rig.cycle()
    assert "planted" in rig.trips[0]
    assert rig.cycles.phase is Phase.LOOKING_ON


def test_a_trajectory_to_the_end_of_the_world_is_refused_or_flown(rig: Rig) -> None:
    rig.engage()
    for pos in ((1e300, 0.0, 0.0), (0.0, 1e308, -1e308)):
        with pytest.raises(BadInput, match="the way takes"):
            rig.cycles.references.goto(pos, 1e300, 2.0, 2.0, rig.estimate.state)
    point = wire.SegmentPoint(t=rig.estimate.state.t - 1000.0, pos=(0.0, 0.0, 0.0))
    with pytest.raises(BadInput, match="from now"):
        rig.cycles.references.follow([point, point], rig.estimate.state)
    rig.cycle()
    assert rig.trips == []
