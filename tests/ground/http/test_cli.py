"""``zmav http``: what it refuses to start with, and how it ends."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import urllib.request
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from click.testing import CliRunner

from ground.http.cli import command
from zmav.errors import BadConfig, PortInUse

if TYPE_CHECKING:
    from tests.ground.http.conftest import Serve


def start(*arguments: str) -> None:
    """Raises what the verb does."""
    CliRunner().invoke(command, arguments, catch_exceptions=False, standalone_mode=False)


@pytest.fixture(autouse=True)
def no_token(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ZMAV_HTTP_TOKEN", raising=False)


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.5", "drone.local"])
def test_beyond_loopback_it_asks_for_a_token(host: str) -> None:
    with pytest.raises(BadConfig, match=r"give a token, in \$ZMAV_HTTP_TOKEN or by --token-file"):
        start("--host", host)


def test_a_token_file_must_hold_one(tmp_path: Path) -> None:
    with pytest.raises(BadConfig, match="No such file"):
        start("--token-file", str(tmp_path / "none"))
    (tmp_path / "empty").write_text("\n")
    with pytest.raises(BadConfig, match="is empty"):
        start("--token-file", str(tmp_path / "empty"))


def test_a_port_in_use_is_said() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(PortInUse, match="choose another with --port"):
            start("--port", str(taken.getsockname()[1]))


def test_without_the_extra_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    with pytest.raises(BadConfig, match=r"pip install 'zmav\[ground\]'"):
        start()


def test_it_serves_until_it_is_told_to_end(serve: Serve, tmp_path: Path) -> None:
    (tmp_path / "token").write_text("s3cret\n")
    endpoint = serve().endpoint
    arguments = ["http", "--port", "0", "-e", endpoint, "--token-file", str(tmp_path / "token"), "--read-only"]
    environment = {name: text for name, text in os.environ.items() if name != "ZMAV_CREDENTIALS"}
    with subprocess.Popen(
        [sys.executable, "-m", "zmav", *arguments], stderr=subprocess.PIPE, text=True, env=environment
    ) as process:
        try:
            assert process.stderr is not None
            line = process.stderr.readline()
            said = re.fullmatch(r"fleet demo at (http://127\.0\.0\.1:\d+/), with a token, only reading\n", line)
            assert said, line
            with urllib.request.urlopen(f"{said[1]}vehicles?token=s3cret", timeout=30.0) as reply:
                assert reply.status == 200
            process.send_signal(signal.SIGTERM)
            assert process.wait(30.0) == 0
            assert process.stderr.read() == ""
        finally:
            process.kill()
