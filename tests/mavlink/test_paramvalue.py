"""Parameter values in the four bytes they travel in."""

from __future__ import annotations

import math
import struct

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from zmav.errors import BadInput, Unsupported
from zmav.mavlink.paramvalue import (
    ParamEncoding,
    as_field,
    bounds,
    float32,
    raw_of,
    same,
    shortest,
    type_name,
    type_number,
    value_of,
)
from zmav.wire import PARAM_TYPES

BYTEWISE, C_CAST = ParamEncoding.BYTEWISE, ParamEncoding.C_CAST
SMALL_INTEGERS = ("UINT8", "INT8", "UINT16", "INT16", "UINT32", "INT32")


@pytest.mark.parametrize(
    ("value", "kind", "encoding", "raw"),
    [
        (1.5, "REAL32", C_CAST, "0000c03f"),
        (1.5, "REAL32", BYTEWISE, "0000c03f"),
        (3, "INT8", C_CAST, "00004040"),
        (-3, "INT8", BYTEWISE, "fd000000"),
        (513, "UINT16", BYTEWISE, "01020000"),
        (-2, "INT16", BYTEWISE, "feff0000"),
        (2**24 + 1, "INT32", BYTEWISE, "01000001"),
        (2**32 - 1, "UINT32", BYTEWISE, "ffffffff"),
        (-(2**31), "INT32", C_CAST, "000000cf"),
        (2**40, "UINT64", C_CAST, "00008053"),
    ],
)
def test_the_bytes_of_values(value: float, kind: str, encoding: ParamEncoding, raw: str) -> None:
    assert raw_of("P", value, kind, encoding).hex() == raw
    assert value_of(bytes.fromhex(raw), kind, encoding) == value


@given(st.data(), st.sampled_from(SMALL_INTEGERS))
def test_every_integer_survives_bytewise(data: st.DataObject, kind: str) -> None:
    value = data.draw(st.integers(*bounds(kind)))
    found = value_of(raw_of("P", value, kind, BYTEWISE), kind, BYTEWISE)
    assert (found, type(found)) == (value, int)


@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
@example(3.4028234663852886e38)
@example(-3.4028234663852886e38)
def test_every_float_survives_as_a_short_number(value: float) -> None:
    shown = value_of(struct.pack("<f", value), "REAL32", C_CAST)
    assert isinstance(shown, float)
    assert float32(shown) == value
    assert raw_of("P", shown, "REAL32", C_CAST) == struct.pack("<f", value)


@given(st.integers(-999_999, 999_999), st.integers(-6, 6))
def test_a_float_is_shown_as_a_person_writes_it(digits: int, exponent: int) -> None:
    written = float(f"{digits}e{exponent}")
    assert shortest(float32(written)) == written


@given(st.binary(min_size=4, max_size=4))
def test_bytes_reach_the_field_unharmed_or_not_at_all(raw: bytes) -> None:
    try:
        field = as_field(raw)
    except Unsupported:
        assert math.isnan(struct.unpack("<f", raw)[0])
    else:
        assert struct.pack("<f", field) == raw


@pytest.mark.parametrize("raw", ["0000c07f", "0000807f", "000080ff"])
def test_what_is_no_number(raw: str) -> None:
    assert value_of(bytes.fromhex(raw), "REAL32", C_CAST) is None
    assert value_of(bytes.fromhex(raw), "INT32", C_CAST) is None


@pytest.mark.parametrize(
    ("value", "kind"),
    [
        (math.nan, "REAL32"),
        (math.inf, "INT32"),
        (True, "INT8"),
        (256, "UINT8"),
        (-1, "UINT32"),
        (0.5, "INT16"),
        (1e39, "REAL32"),
        (10**400, "REAL32"),
        (10**400, "INT32"),
    ],
)
@pytest.mark.parametrize("encoding", [BYTEWISE, C_CAST])
def test_what_a_type_cannot_hold(value: float, kind: str, encoding: ParamEncoding) -> None:
    with pytest.raises(BadInput) as caught:
        raw_of("P_NAME", value, kind, encoding)
    assert (caught.value.detail["field"], "P_NAME" in str(caught.value)) == ("P_NAME", True)


def test_what_an_encoding_cannot_carry() -> None:
    with pytest.raises(BadInput, match="16777216 is near"):
        raw_of("P", 2**24 + 1, "INT32", C_CAST)
    with pytest.raises(Unsupported):
        raw_of("P", 1, "INT64", BYTEWISE)


def test_type_numbers_are_mavlink_s() -> None:
    assert [type_name(number) for number in range(12)] == [None, *PARAM_TYPES, None]
    assert (type_number("UINT8"), type_number("REAL32")) == (1, 9)


@pytest.mark.parametrize(
    ("one", "other", "equal"),
    [
        (0.1, float32(0.1), True),
        (1, 1.0, True),
        (2**24, 2**24 + 1, False),
        (None, None, True),
        (None, 0, False),
        (0.1, 0.1001, False),
    ],
)
def test_what_is_the_same(one: float | None, other: float | None, equal: bool) -> None:
    assert same(one, other) is equal
