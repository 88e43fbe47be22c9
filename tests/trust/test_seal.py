"""The seal of setpoints: both sides come to one secret, nobody else does, and nothing under it can be changed."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zmav.errors import BadInput
from zmav.trust.seal import Exchange, is_sealed, seal

KEY, PAYLOAD = "zmav/demo/quad1/setpoint/alice", b'{"seq": 1}'
SECRET = bytes(range(32))


def test_both_sides_come_to_the_same_secret_and_others_do_not() -> None:
    holder, vehicle, stranger = Exchange(), Exchange(), Exchange()
    secret = holder.secret(vehicle.public, "demo/quad1", "token")
    assert secret == vehicle.secret(holder.public, "demo/quad1", "token")
    assert len(secret) == 32
    others = {
        stranger.secret(vehicle.public, "demo/quad1", "token"),
        stranger.secret(holder.public, "demo/quad1", "token"),
        holder.secret(vehicle.public, "demo/quad2", "token"),
        holder.secret(vehicle.public, "demo/quad1", "another"),
    }
    assert len(others) == 4
    assert secret not in others


@pytest.mark.parametrize("key", ["", "zz", "00" * 31, "00" * 33, "00" * 32, "é" * 64])
def test_what_is_no_key_is_named(key: str) -> None:
    with pytest.raises(BadInput) as e:
        Exchange().secret(key, "demo/quad1", "token")
    assert e.value.detail["field"] == "key"


def test_nothing_can_be_changed() -> None:
    sealed = seal(SECRET, KEY, PAYLOAD)
    assert len(sealed) == 17
    assert is_sealed(SECRET, KEY, PAYLOAD, sealed)
    for at in range(17):
        changed = bytearray(sealed)
        changed[at] ^= 1
        assert not is_sealed(SECRET, KEY, PAYLOAD, bytes(changed))
    for secret, key, payload in (
        (bytes(32), KEY, PAYLOAD),
        (SECRET, KEY + "2", PAYLOAD),
        (SECRET, KEY, PAYLOAD + b" "),
        (SECRET, KEY, b""),
        (SECRET, KEY[:-1], b"e" + PAYLOAD),
    ):
        assert not is_sealed(secret, key, payload, sealed)
    assert not is_sealed(SECRET, KEY, PAYLOAD, None)


@given(st.binary(max_size=40))
def test_no_guess_is_a_seal(guess: bytes) -> None:
    assert not is_sealed(SECRET, KEY, PAYLOAD, guess)
