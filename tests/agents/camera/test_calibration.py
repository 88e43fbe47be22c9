"""A lens's constants from a file, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from agents.camera.settings import Calibration
from zmav.errors import BadConfig


def test_a_calibration_is_scaled() -> None:
    found = Calibration(width=640, height=480, focal=(500.0, 510.0), center=(319.5, 239.5))
    half = found.scaled(320, 240)
    assert (half.focal, half.center) == ((250.0, 255.0), (159.5, 119.5))
    with pytest.raises(BadConfig, match="another shape"):
        found.scaled(640, 360)


def test_a_calibration_is_read(tmp_path: Path) -> None:
    path = tmp_path / "down.toml"
    path.write_text("width = 640\nheight = 480\nfocal = [500.0, 510.0]\ncenter = [319.5, 239.5]\n")
    assert Calibration.load(path) == Calibration(width=640, height=480, focal=(500.0, 510.0), center=(319.5, 239.5))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("width = 640", "height"),
        ("width = 640\nheight = 480\nfocal = [0.0, 1.0]\ncenter = [1.0, 1.0]", "focal"),
        ("width = 640\nheight = 480\nfocal = [1.0, 1.0]\ncenter = [nan, 1.0]", "finite"),
        ("no toml", "calibration"),
    ],
)
def test_a_broken_calibration_is_named(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "broken.toml"
    path.write_text(text)
    with pytest.raises(BadConfig, match=words):
        Calibration.load(path)
    with pytest.raises(BadConfig, match="cannot read"):
        Calibration.load(tmp_path / "missing.toml")
