"""Pictures from the network are read as far as they are any."""

from __future__ import annotations

import numpy as np
import pytest

from zmav.errors import BadInput
from zmav.vision.opencv import MOST_PIXELS, decode, encode, jpeg_size


def test_a_picture_is_itself_again() -> None:
    image = np.full((48, 64, 3), (10, 200, 90), np.uint8)
    data = encode(image, 95)
    assert jpeg_size(data) == (64, 48)
    assert np.abs(decode(data).astype(int) - image).max() < 4


def test_what_is_none_or_says_that_it_is_vast_is_refused() -> None:
    data = encode(np.zeros((48, 64, 3), np.uint8), 80)
    at = data.index(b"\xff\xc0")
    vast = bytearray(data)
    vast[at + 5 : at + 9] = (40_000).to_bytes(2, "big") * 2
    with pytest.raises(BadInput, match=f"at most {MOST_PIXELS}"):
        decode(bytes(vast))
    for bad in (b"", b"\xff", b"\xff\xd8", b"nonsense" * 10, data[:at], bytes(100), b"\xff\xd8" + b"\xff" * 9):
        with pytest.raises(BadInput, match="no picture"):
            decode(bad)


@pytest.mark.parametrize("seed", range(5))
def test_a_broken_one_ends_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    data = encode(rng.integers(0, 255, (48, 64, 3), dtype=np.uint8), 70)
    for _ in range(100):
        broken = bytearray(data)
        for place in rng.integers(0, len(data), 6):
            broken[place] = rng.integers(0, 256)
        try:
            assert decode(bytes(broken)).ndim == 3
        except BadInput:
            continue
