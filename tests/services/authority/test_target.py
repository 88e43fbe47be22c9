"""From the wire to a target: every level, and every fault by its name."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zmav import wire
from zmav.autopilots import Message, autopilot_for
from zmav.errors import BadInput
from zmav.mavlink import Packer, load_dialect
from zmav.services.authority.targets import group_of, resolve

ORIGIN = wire.Origin(lat_deg=-35.0, lon_deg=149.0, alt_amsl=600.0)
NAN, INF = math.nan, math.inf
IDENTITY = (1.0, 0.0, 0.0, 0.0)
SOUND: dict[str, dict[str, Any]] = {
    "position": {"pos": (1.0, 2.0, -3.0), "yaw": 0.5},
    "velocity": {"vel": (1.0, 0.0, 0.0), "yaw_rate": 0.1},
    "acceleration": {"acc": (1.0, 0.0, 0.0)},
    "trajectory": {"pos": (1.0, 2.0, -3.0), "vel": (1.0, 0.0, 0.0)},
    "attitude": {"attitude": IDENTITY, "thrust": 0.5, "rates": (0.1, 0.0, 0.0)},
    "rates": {"rates": (0.1, 0.0, 0.0), "thrust": 0.0},
    "torque": {"torque": (0.1, -1.0, 1.0), "thrust": 1.0},
    "manual": {"manual": wire.ManualControl(x=-1.0)},
    "rc": {"rc": [800, None, 2200]},
    "servo": {"servo": [None, 1500]},
}


def point(**fields: Any) -> wire.Setpoint:
    return wire.Setpoint(lease="x", seq=1, deadline=1.0, **fields)


@pytest.mark.parametrize(("level", "fields"), SOUND.items())
def test_every_level(level: str, fields: dict[str, Any]) -> None:
    target = resolve(point(**fields), ORIGIN)
    assert target.level == level
    for name, value in fields.items():
        if name != "pos":
            assert getattr(target, name) == (tuple(value) if isinstance(value, list) else value)


def test_a_position_is_about_the_origin() -> None:
    target = resolve(point(pos=(0.0, 0.0, -3.0)), ORIGIN)
    assert (target.lat_deg, target.lon_deg, target.alt_amsl, target.alt_rel) == (-35.0, 149.0, 603.0, None)
    north = resolve(point(pos=(111.0, 0.0, 0.0)), ORIGIN).lat_deg
    assert north == pytest.approx(-35.0 + 0.001, abs=2e-6)
    there = {"frame": "global", "lat_deg": 1.0, "lon_deg": 2.0, "alt_rel": 5.0}
    target = resolve(point(**there, vel=(1.0, 0.0, 0.0)), None)
    assert (target.lat_deg, target.lon_deg, target.alt_rel, target.level) == (1.0, 2.0, 5.0, "trajectory")


def test_levels_that_need_no_origin() -> None:
    for level, fields in SOUND.items():
        if "pos" in fields:
            with pytest.raises(BadInput, match="none is declared") as caught:
                resolve(point(**fields), None)
            assert caught.value.detail["field"] == "frame"
        else:
            assert resolve(point(**fields), None).level == level


def test_an_attitude_is_made_a_unit_quaternion() -> None:
    attitude = resolve(point(attitude=(0.995, 0.1, 0.0, 0.0), thrust=0.5), None).attitude
    assert attitude is not None
    assert math.hypot(*attitude) == pytest.approx(1.0, abs=1e-12)
    assert attitude[1] / attitude[0] == pytest.approx(0.1 / 0.995)


THERE = {"frame": "global", "lat_deg": 1.0, "lon_deg": 2.0}
FAULTS: list[tuple[dict[str, Any], str, str]] = [
    ({}, "pos", "neither a position nor a velocity"),
    ({"yaw": 1.0}, "pos", "a yaw alone"),
    ({"thrust": 0.5}, "thrust", "alone is no setpoint"),
    ({"pos": (NAN, 0.0, 0.0)}, "pos", "not finite"),
    ({"pos": (0.0, 2e5, 0.0)}, "pos", "within ±100000"),
    ({"vel": (0.0, INF, 0.0)}, "vel", "not finite"),
    ({"vel": (0.0, 0.0, 1001.0)}, "vel", "within ±1000"),
    ({"acc": (0.0, 1e300, 0.0)}, "acc", "within"),
    ({"vel": (0.0, 0.0, 0.0), "yaw": NAN}, "yaw", "not finite"),
    ({"vel": (0.0, 0.0, 0.0), "yaw_rate": -1e9}, "yaw_rate", "within"),
    ({"lat_deg": 1.0}, "lat_deg", "belongs to frame 'global'"),
    ({"vel": (0.0, 0.0, 0.0), "alt_rel": 1.0}, "alt_rel", "belongs to frame 'global'"),
    ({"frame": "global", "pos": (0.0, 0.0, 0.0)}, "pos", "belongs to frame 'ned'"),
    ({"frame": "global", "vel": (0.0, 0.0, 0.0), "alt_rel": 3.0}, "lat_deg", "alt_rel needs lat_deg"),
    ({**THERE, "lat_deg": 91.0, "alt_rel": 1.0}, "lat_deg", "within ±90"),
    ({**THERE, "lon_deg": NAN, "alt_rel": 1.0}, "lon_deg", "not finite"),
    ({**THERE, "lon_deg": None, "alt_rel": 1.0}, "lon_deg", "within ±180"),
    (THERE, "alt_rel", "one of alt_amsl and alt_rel"),
    ({**THERE, "alt_rel": 1.0, "alt_amsl": 1.0}, "alt_rel", "one of alt_amsl and alt_rel"),
    ({**THERE, "alt_amsl": INF}, "alt_amsl", "not finite"),
    ({"attitude": IDENTITY}, "thrust", "missing"),
    ({"attitude": (1.0, 0.2, 0.0, 0.0), "thrust": 0.5}, "attitude", "length 1"),
    ({"attitude": (0.0, 0.0, 0.0, 0.0), "thrust": 0.5}, "attitude", "length 1"),
    ({"attitude": (NAN, 0.0, 0.0, 0.0), "thrust": 0.5}, "attitude", "length 1"),
    ({"attitude": (1e300, 0.0, 0.0, 0.0), "thrust": 0.5}, "attitude", "length 1"),
    ({"attitude": IDENTITY, "thrust": 1.01}, "thrust", "0 to 1"),
    ({"attitude": IDENTITY, "thrust": NAN}, "thrust", "0 to 1"),
    ({"attitude": IDENTITY, "thrust": 0.5, "frame": "global"}, "frame", "is for positions"),
    ({"rates": (0.0, 0.0, 101.0), "thrust": 0.5}, "rates", "within"),
    ({"rates": (0.0, 0.0, 0.0)}, "thrust", "missing"),
    ({"torque": (0.0, 1.1, 0.0), "thrust": 0.5}, "torque", "within ±1"),
    ({"torque": (0.0, 0.0, 0.0)}, "thrust", "missing"),
    ({"manual": wire.ManualControl(x=1.5)}, "manual.x", "from -1 to 1"),
    ({"manual": wire.ManualControl(z=-0.1)}, "manual.z", "from 0 to 1"),
    ({"manual": wire.ManualControl(r=NAN)}, "manual.r", "from -1 to 1"),
    ({"manual": wire.ManualControl(buttons=1 << 16)}, "manual.buttons", "16 bits"),
    ({"rc": []}, "rc", "1 to 18"),
    ({"rc": [1500] * 19}, "rc", "1 to 18"),
    ({"rc": [None, None]}, "rc", "not null"),
    ({"rc": [1500, 799]}, "rc[1]", "800 to 2200"),
    ({"servo": [2201]}, "servo[0]", "800 to 2200"),
    ({"servo": [1500] * 17}, "servo", "1 to 16"),
    ({"segment": []}, "segment", "many points"),
    # Two levels at a time.
    ({"vel": (0.0, 0.0, 0.0), "thrust": 0.5}, "thrust", "does not go with vel"),
    ({"pos": (0.0, 0.0, 0.0), "attitude": IDENTITY, "thrust": 0.5}, "attitude", "does not go with pos"),
    ({"attitude": IDENTITY, "torque": (0.0, 0.0, 0.0), "thrust": 0.5}, "torque", "does not go with attitude"),
    ({"yaw": 0.0, "attitude": IDENTITY, "thrust": 0.5}, "attitude", "does not go with yaw"),
    ({"manual": wire.ManualControl(), "rc": [1500]}, "rc", "does not go with manual"),
    ({"vel": (0.0, 0.0, 0.0), "segment": []}, "segment", "does not go with vel"),
]


@pytest.mark.parametrize(("fields", "field", "words"), FAULTS)
def test_every_fault_is_named(fields: dict[str, Any], field: str, words: str) -> None:
    with pytest.raises(BadInput, match=words.replace("±", ".")) as caught:
        resolve(point(**fields), ORIGIN)
    assert caught.value.detail["field"] == field
    wire.error_body(caught.value)  # it can cross the wire


def test_a_goto_is_a_position() -> None:
    target = resolve(wire.GoTo(pos=(0.0, 0.0, -5.0), yaw=1.0), ORIGIN)
    assert (target.level, target.alt_amsl, target.yaw) == ("position", 605.0, 1.0)
    for args, field in (
        (wire.GoTo(), "pos"),
        (wire.GoTo(frame="global", lat_deg=1.0, alt_rel=1.0), "lon_deg"),
        (wire.GoTo(pos=(0.0, 0.0, 0.0), yaw=INF), "yaw"),
        (wire.GoTo(pos=(0.0, 0.0, 0.0), lat_deg=1.0), "lat_deg"),
    ):
        with pytest.raises(BadInput) as caught:
            resolve(args, ORIGIN)
        assert caught.value.detail["field"] == field


numbers = st.none() | st.floats() | st.sampled_from([0.0, 1.0, 0.5])
vectors = st.none() | st.tuples(st.floats(), st.floats(), st.floats()) | st.just((1.0, 0.0, 0.0))
pulses = st.none() | st.lists(st.none() | st.integers(-10, 70_000) | st.integers(800, 2200), max_size=20)


@given(
    frame=st.sampled_from(["ned", "global"]),
    pos=vectors,
    vel=vectors,
    acc=vectors,
    rates=vectors,
    torque=vectors,
    lat_deg=numbers,
    lon_deg=numbers,
    alt_amsl=numbers,
    alt_rel=numbers,
    yaw=numbers,
    yaw_rate=numbers,
    thrust=numbers,
    attitude=st.none() | st.tuples(st.floats(), st.floats(), st.floats(), st.floats()) | st.just(IDENTITY),
    manual=st.none() | st.builds(wire.ManualControl, x=st.floats(), z=st.floats(), buttons=st.integers()),
    rc=pulses,
    servo=pulses,
    keep=st.sets(st.sampled_from([*SOUND, "yaw", "thrust", "lat_deg", "lon_deg", "alt_rel"])),
)
def test_whatever_comes_is_refused_or_can_be_sent(keep: set[str], **fields: Any) -> None:
    names = {"frame", *keep, *(name for level in keep for name in SOUND.get(level, {}))}
    given_fields = {name: value for name, value in fields.items() if name in names}
    try:
        target = resolve(point(**given_fields), ORIGIN)
    except BadInput as e:
        assert e.detail["field"]
        return
    assert group_of(point(**given_fields)) != "segment"
    packer = Packer(load_dialect(), 1, 191)
    if target.level != "torque":
        for action in autopilot_for(3, 2).setpoint(target) if len(target.rc or ()) <= 16 else ():
            if isinstance(action, Message):
                packer.pack(action.name, **action.addressed(1, 1))
