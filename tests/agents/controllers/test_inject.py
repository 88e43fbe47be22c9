"""What is injected: added to the one number that was named, by as much as was asked, and to nothing else."""

from __future__ import annotations

import copy
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.controllers.inject import CHANNELS, Inject, Injection, duration, turned
from agents.controllers.types import LEVELS, Level, Reference, State
from zmav import wire
from zmav.errors import BadInput

START = 1000.0
SMALL = {name: 0.05 * each.most for name, each in CHANNELS.items()}
PLACES = [(level, name) for name, each in CHANNELS.items() for level in each.levels]


def order(
    kind: str = "step", channel: str = "z", amplitude: float = 1.0, seconds: float = 2.0, **rest: float
) -> Inject:
    return Inject(kind=kind, channel=channel, amplitude=amplitude, seconds=seconds, **rest)  # type: ignore[arg-type]


def tilted(level: Level) -> Reference:
    """A reference of which no number is zero."""
    attitude = quaternion(0.2, -0.3, 1.1)
    return Reference(
        level,
        np.array([1.0, 2.0, -3.0]),
        np.array([0.1, 0.2, 0.3]),
        np.array([0.4, 0.5, 0.6]),
        0.7,
        0.05,
        attitude,
        np.array([0.01, 0.02, 0.03]),
        0.5,
    )


def quaternion(roll: float, pitch: float, yaw: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Of Euler angles (Z-Y-X), by the textbook."""
    (cr, cp, cy), (sr, sp, sy) = ([f(a / 2) for a in (roll, pitch, yaw)] for f in (math.cos, math.sin))
    first, second = (cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy), (cr * sp * cy + sr * cp * sy,)
    return np.array([*first, *second, cr * cp * sy - sr * sp * cy])


def numbers(reference: Reference) -> dict[str, float]:
    """Each channel of a reference, as the signals name it, and what can be fed forward; angles are Euler's."""
    roll, pitch, heading = State(q=reference.attitude).euler
    by_attitude = reference.level in ("altitude", "attitude")
    found = {"roll": roll, "pitch": pitch, "yaw": heading if by_attitude else reference.yaw}
    found["yaw_rate"], found["thrust"] = reference.yaw_rate, reference.thrust
    vectors = {"xyz": reference.pos, "pqr": reference.rates}
    found |= {name: float(v) for names, vector in vectors.items() for name, v in zip(names, vector, strict=True)}
    for start, vector in (("v", reference.vel), ("a", reference.acc)):
        found |= {start + name: float(v) for name, v in zip("xyz", vector, strict=True)}
    return found


@pytest.mark.parametrize(("level", "channel"), PLACES)
def test_a_step_is_added_to_that_channel_and_to_nothing_else(level: Level, channel: str) -> None:
    amplitude = SMALL[channel]
    injection = Injection(order(channel=channel, amplitude=amplitude), level, START)
    reference, before = tilted(level), numbers(tilted(level))
    assert injection.apply(reference, START + 0.5) == amplitude
    after = numbers(reference)
    expected = {**before, channel: before[channel] + amplitude}
    assert after == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(("level", "channel"), PLACES)
def test_whoever_else_holds_the_vectors_sees_no_change(level: Level, channel: str) -> None:
    shared = tilted(level)
    injection = Injection(order(channel=channel, amplitude=SMALL[channel]), level, START)
    for cycle in range(3):  # the same reference again: nothing adds up
        reference = copy.copy(shared)
        injection.apply(reference, START + 0.1 * cycle)
        before = numbers(tilted(level))
        assert numbers(reference)[channel] == pytest.approx(before[channel] + SMALL[channel], abs=1e-12)
    assert numbers(shared) == numbers(tilted(level))


def test_it_begins_and_ends_when_it_is_to() -> None:
    injection = Injection(order(seconds=2.0), "position", START)
    for t, added in ((-0.001, 0.0), (0.0, 1.0), (1.999, 1.0), (2.0, 0.0), (50.0, 0.0)):
        reference = Reference()
        assert injection.apply(reference, START + t) == added
        assert reference.pos[2] == added
    assert not injection.done(START - 1.0)
    assert not injection.done(START + 1.999)
    assert injection.done(START + 2.0)


def test_a_doublet_goes_one_way_and_then_as_long_the_other() -> None:
    injection = Injection(order("doublet", "p", -0.4, 1.0), "rates", START)
    said = [injection.apply(Reference("rates"), START + t) for t in (0.0, 0.999, 1.0, 1.999, 2.0)]
    assert said == [-0.4, -0.4, 0.4, 0.4, 0.0]
    assert duration(injection.args) == 2.0
    assert not injection.done(START + 1.5)


def test_a_controller_of_another_level_gets_nothing() -> None:
    injection = Injection(order(channel="yaw", amplitude=0.1), "position", START)
    reference = tilted("attitude")
    assert injection.apply(reference, START + 1.0) == 0.0
    assert numbers(reference) == numbers(tilted("attitude"))


def test_a_yaw_goes_on_past_south() -> None:
    reference = Reference(yaw=3.1)
    Injection(order(channel="yaw", amplitude=0.5), "position", START).apply(reference, START)
    assert reference.yaw == pytest.approx(3.6 - 2.0 * math.pi)


ANGLE = st.floats(-0.6, 0.6)


@given(
    st.floats(-3.1, 3.1), st.floats(-0.9, 0.9), st.floats(-3.1, 3.1), ANGLE, st.sampled_from(["roll", "pitch", "yaw"])
)
def test_an_angle_is_added_whatever_the_others_are(
    roll: float, pitch: float, yaw: float, angle: float, name: str
) -> None:
    q = turned(quaternion(roll, pitch, yaw), name, angle)
    wanted = {"roll": roll, "pitch": pitch, "yaw": yaw}
    wanted[name] += angle
    assert abs(float(np.dot(q, quaternion(**wanted)))) == pytest.approx(1.0, abs=1e-12)
    assert float(np.linalg.norm(q)) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("channel", [*CHANNELS, "thrust", ""])
def test_a_channel_that_the_reference_lacks_is_refused_with_those_that_it_has(level: Level, channel: str) -> None:
    args = order(channel=channel, amplitude=SMALL.get(channel, 0.1))
    if (level, channel) in PLACES:
        Injection(args, level, START)
        return
    with pytest.raises(BadInput, match=f"level {level} has") as refused:
        Injection(args, level, START)
    assert refused.value.detail["field"] == "channel"
    assert refused.value.detail["value"] == channel
    assert all(name in refused.value.detail["expected"] for where, name in PLACES if where == level)


@pytest.mark.parametrize(
    ("field", "args"),
    [
        ("kind", order("ramp")),
        ("amplitude", order(amplitude=math.nan)),
        ("amplitude", order(amplitude=math.inf)),
        ("amplitude", order(amplitude=0.0)),
        ("amplitude", order(amplitude=-10.1)),
        ("seconds", order(seconds=math.nan)),
        ("seconds", order(seconds=0.0)),
        ("seconds", order(seconds=-1.0)),
        ("seconds", order(seconds=1e4)),
    ],
)
def test_what_is_no_number_or_beyond_what_is_sane_is_refused_by_its_name(field: str, args: Inject) -> None:
    with pytest.raises(BadInput, match=f"inject: {field} is .*; expected") as refused:
        Injection(args, "position", START)
    assert refused.value.detail["field"] == field
    assert refused.value.detail["expected"]


def test_rates_that_would_turn_it_over_are_refused() -> None:
    Injection(order(channel="p", amplitude=2.0, seconds=0.35), "rates", START)
    Injection(order(channel="r", amplitude=1.0, seconds=3.0), "rates", START)  # it may well turn about its own axis
    for args in (
        order(channel="p", amplitude=2.0, seconds=0.5),
        order("doublet", "q", -1.0, 1.0),
    ):
        with pytest.raises(BadInput, match="add up to"):
            Injection(args, "rates", START)


def test_the_order_is_read_from_json_and_its_fields_are_named_when_wrong() -> None:
    said = b'{"kind": "doublet", "channel": "roll", "amplitude": 0.1, "seconds": 20}'
    args = wire.decode(said, Inject, "inject")
    assert (args.kind, args.seconds) == ("doublet", 20.0)
    for wrong, field in ((b'"ramp"', "kind"), (b"null", "kind")):
        with pytest.raises(BadInput, match=field):
            wire.decode(said.replace(b'"doublet"', wrong), Inject, "inject")
    with pytest.raises(BadInput, match="amplitude"):
        wire.decode(b'{"kind": "step", "channel": "z", "seconds": 2}', Inject, "inject")
