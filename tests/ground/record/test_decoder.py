"""Frames to flat JSON: the same as the general decoder says, for every message of the dialect."""

from __future__ import annotations

import json
import math
import random
from typing import Any

import pytest

from ground.record.decoder import Decoder, is_frame
from zmav.mavlink import Dialect, decode, parse_frame
from zmav.mavlink.frame import build_frame


def plain(value: Any) -> Any:
    """As JSON has it: no NaN, no infinities."""
    if isinstance(value, list):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def test_every_message_is_decoded_as_by_the_general_decoder(dialect: Dialect) -> None:
    decoder, chance = Decoder(dialect), random.Random(6)
    for message in dialect.by_id.values():
        for version in (2, 1) if message.id < 256 else (2,):
            whole = chance.randbytes(message.max_length)
            payload = whole if version == 2 else whole[: message.base_length]
            frame = build_frame(message, payload, 1, 1, 0, version)
            found = decoder.json(frame)
            assert found is not None
            expected = {name: plain(value) for name, value in decode(parse_frame(frame, dialect), dialect).items()}
            assert json.loads(found) == expected
            assert list(json.loads(found)) == [field.name for field in message.fields]


def test_an_unknown_message_has_no_fields(dialect: Dialect) -> None:
    message = dialect.by_name["HEARTBEAT"]
    frame = bytearray(build_frame(message, bytes(9), 1, 1, 0))
    frame[7:10] = (0xFFFFF0).to_bytes(3, "little")
    assert is_frame(bytes(frame))
    assert Decoder(dialect).json(bytes(frame)) is None


@pytest.mark.parametrize("version", [1, 2])
def test_what_is_no_frame(dialect: Dialect, version: int) -> None:
    frame = build_frame(dialect.by_name["HEARTBEAT"], bytes(range(1, 10)), 1, 1, 0, version)
    assert is_frame(frame)
    for other in (b"", frame[:-1], frame + b"\0", frame[1:], b"{}" + frame[2:], frame[:5]):
        assert not is_frame(other)
    if version == 2:
        assert is_frame(frame[:2] + b"\1" + frame[3:] + bytes(13)), "a signed one"
        assert not is_frame(frame[:2] + b"\2" + frame[3:])
