"""Payloads: strict, and anyone who gets one wrong is told the field, the value and what was expected."""

from __future__ import annotations

import json
import math
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zmav import keys, wire
from zmav.errors import BadInput

SETPOINT = {"lease": "a", "seq": 1, "deadline": 2.0, "pos": [1.0, 2.0, -3.0]}

json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=12,
)


@pytest.mark.parametrize(
    ("kind", "given_", "field", "words"),
    [
        (wire.Takeoff, {}, "alt_rel", "missing required field"),
        (wire.Takeoff, {"alt_rel": "high"}, "alt_rel", "Expected `float`, got `str`"),
        (wire.Takeoff, {"alt_rel": 5, "altitude": 5}, "altitude", "unknown field"),
        (wire.Takeoff, [5], "Takeoff", "Expected `object`, got `array`"),
        (wire.Takeoff, None, "Takeoff", "got `null`"),
        (wire.Setpoint, SETPOINT | {"pos": [1.0, 2.0]}, "pos", "length 3"),
        (wire.Setpoint, SETPOINT | {"pos": [1.0, "x", 2.0]}, "pos[1]", "Expected `float`"),
        (wire.Setpoint, SETPOINT | {"seq": 1.5}, "seq", "Expected `int`"),
        (wire.Setpoint, SETPOINT | {"frame": "enu"}, "frame", "Invalid enum value 'enu'"),
        (wire.Setpoint, {"lease": "a", "seq": 1, "pos": [1, 2, 3]}, "deadline", "missing"),
        (wire.VehicleState, {"t": 1, "fleet": "f", "name": "n", "instance": "i", "gps": {}}, "gps.fix", "missing"),
        (wire.GoTo, {"pos": {"n": 1}}, "pos", "Expected `array | null`"),
    ],
)
def test_what_is_wrong_is_named(kind: type[msgspec.Struct], given_: Any, field: str, words: str) -> None:
    with pytest.raises(BadInput) as caught:
        wire.decode(json.dumps(given_).encode(), kind, "do/it")
    error = caught.value
    assert error.detail["field"] == field
    assert words in error.detail["expected"]
    assert field in error.message and error.message.startswith("do/it: ")
    assert json.dumps(given_).startswith(error.detail["value"])


@pytest.mark.parametrize("data", [b"{}", b'{"a": {"b": 1}, "b": 2, "c": [{"b": 3}]}', b'{"a": ' + b"9" * 5001 + b"}"])
def test_a_name_in_another_object_is_no_repetition(data: bytes) -> None:
    wire.refuse_repeated(data, "do/it")


@pytest.mark.parametrize(
    "data", [b'{"b": 1, "b": 1}', b'{"a": [{"b": 1, "c": {}, "b": 2}]}', b'{"b": 1, "\\u0062": 2}']
)
def test_a_name_that_is_given_twice_is_refused(data: bytes) -> None:
    with pytest.raises(BadInput, match="do/it: b is given twice") as caught:
        wire.refuse_repeated(data, "do/it")
    assert caught.value.detail["field"] == "b"


@pytest.mark.parametrize(
    "data", [b"{", b"alt_rel=5", b"\xff\xfe\x00", b'{"alt_rel":1}x', b'{"id":"\xff","alt_rel":1}', b'{"id":"\\ud800"}']
)
def test_what_is_no_json_is_told(data: bytes) -> None:
    with pytest.raises(BadInput, match="do/takeoff: not JSON"):
        wire.decode(data, wire.Takeoff, "do/takeoff")


def test_no_payload_is_no_arguments() -> None:
    assert wire.decode(b"", wire.Order, "do/hold") == wire.Order()


@pytest.mark.parametrize("kind", [wire.Takeoff, wire.Event, wire.LastMessage, wire.Outcome])
def test_a_bottomless_payload_is_bad_input(kind: type[msgspec.Struct]) -> None:
    for start in (b"", b'{"detail":', b'{"fields":{"x":', b'{"result":{"x":', b'{"zz":'):
        with pytest.raises(BadInput):
            wire.decode(start + b"[" * 200_000, kind, "x")


@given(json_values, st.sampled_from([c.payload for c in keys.CHANNELS.values() if c.payload]))
def test_any_json_is_taken_or_refused_in_words(value: Any, kind: type[msgspec.Struct]) -> None:
    try:
        got = wire.decode(json.dumps(value).encode(), kind, "it")
    except BadInput as e:
        assert e.detail["field"]
        return
    assert isinstance(got, kind)


@given(st.binary(max_size=60))
def test_any_bytes_are_taken_or_refused_in_words(data: bytes) -> None:
    try:
        wire.decode(data, wire.Order, "it")
    except BadInput as e:
        assert len(e.detail["value"]) <= 80


finite = st.floats(allow_nan=False, allow_infinity=False)
vectors = st.tuples(finite, finite, finite)


@given(
    st.builds(
        wire.Setpoint,
        lease=st.text(),
        seq=st.integers(0, 2**53),
        deadline=finite,
        pos=st.none() | vectors,
        vel=st.none() | vectors,
        yaw=st.none() | finite,
    )
)
def test_a_setpoint_arrives_as_it_left(point: wire.Setpoint) -> None:
    assert wire.decode(wire.encode(point), wire.Setpoint, "setpoint") == point


def test_what_json_has_no_word_for_becomes_null() -> None:
    sent = wire.Battery(voltage=math.nan, current=math.inf, remaining=-math.inf, time_left=math.nan)
    assert json.loads(wire.encode(sent)) == {"voltage": None, "current": None, "remaining": None, "time_left": None}


def test_units_and_frames_are_in_the_names() -> None:
    """Degrees only where a name says so, and altitudes that say above what."""
    for kind in (wire.VehicleState, wire.GlobalPosition, wire.Attitude, wire.Setpoint, wire.GoTo, wire.Origin):
        for name in kind.__struct_fields__:
            assert name not in ("lat", "lon", "alt", "altitude", "heading", "yaw_deg", "roll_deg"), (kind, name)


def test_no_number_of_a_request_is_lost_on_the_way() -> None:
    """In JSON NaN is null: not given, which asks for something else."""
    search = wire.swarm.Search(vehicles=["quad1"], polygon=[(0.0, 0.0)], height=9.0, angle=math.nan)
    for asked, field in (
        (wire.GoTo(pos=(0.0, 0.0, -5.0), speed=math.nan), "speed"),
        (wire.Setpoint(lease="a", seq=1, deadline=2.0, vel=(1.0, math.inf, 0.0)), "vel"),
        (wire.Setpoint(lease="a", seq=1, deadline=2.0, vel=(1.0, 0.0, 0.0), yaw=math.nan), "yaw"),
        (wire.swarm.Submit(goal=search), "goal.angle"),
    ):
        with pytest.raises(BadInput, match=f"{field} is .*expected a finite number"):
            wire.encode_request(asked)
    with pytest.raises(BadInput, match="pitch is nan"):
        wire.build({"pitch": math.nan}, wire.PointGimbal, "gimbal_point")
    # MAVLink's own word for a parameter that is not given.
    command = wire.RunCommand(command="MAV_CMD_DO_SET_ROI", params={"param5": math.nan})
    assert json.loads(wire.encode_request(command))["params"] == {"param5": None}
