"""``zmav sim --camera``: as a process of its own, and what it says of bad options."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest
from click.testing import CliRunner

from zmav.cli import zmav
from zmav.errors import BadConfig, BadInput, PortInUse


def test_pictures_of_a_running_simulator(tmp_path: Path) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text('ground = "asphalt"\n', encoding="utf-8")
    options = ["--copters", "1", "--rovers", "1", "--pad", "rover1", "--camera", "quad1:30", "--camera-port", "0"]
    process = subprocess.Popen(
        [sys.executable, "-m", "zmav", "sim", *options, "--scene", scene, "--endpoint", "tcp:0"],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env={"TMPDIR": str(tmp_path)},
    )
    try:
        assert process.stdout is not None
        name, _, url = process.stdout.readline().strip().partition(" camera: ")
        assert name == "quad1"
        with urllib.request.urlopen(url, timeout=60.0) as answer:
            assert answer.readline() == b"--zmav-frame\r\n"
            assert answer.readline() == b"Content-Type: image/jpeg\r\n"
        with urllib.request.urlopen(url.replace(".mjpeg", ".json"), timeout=60.0) as answer:
            assert json.load(answer)["rate_hz"] == 30.0
    finally:
        process.send_signal(signal.SIGTERM)
        assert process.wait(60.0) == 0
        assert process.stdout is not None
        process.stdout.close()


@pytest.mark.parametrize(
    ("option", "value", "error", "named"),
    [
        ("--camera", "quad1:fast", BadInput, "NAME:RATE"),
        ("--camera", ":5", BadInput, "NAME:RATE"),
        ("--camera", "quad1:1000", BadInput, "100 Hz"),
        ("--camera", "boat1", BadConfig, "quad1, rover1"),
        ("--pad", "boat1", BadConfig, "quad1, rover1"),
        ("--scene", "/nowhere/scene.toml", BadConfig, "nowhere"),
    ],
)
def test_what_cannot_be(option: str, value: str, error: type[BadInput], named: str) -> None:
    result = CliRunner().invoke(zmav, ["sim", "--copters", "1", "--rovers", "1", "--endpoint", "tcp:0", option, value])
    assert isinstance(result.exception, error)
    assert named in str(result.exception)


def test_a_port_for_pictures_that_is_taken() -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = str(other.getsockname()[1])
        result = CliRunner().invoke(zmav, ["sim", "--camera", "quad1", "--camera-port", port, "--endpoint", "tcp:0"])
    assert isinstance(result.exception, PortInUse)
    assert port in str(result.exception)
