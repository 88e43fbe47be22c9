"""A recording behind the gateway: in a fleet of its own, steered over HTTP, and nobody can be ordered."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from ground.record import mcapfile
from ground.record.folder import Folder
from ground.record.storage import RecordingSettings, Storage
from zmav import wire
from zmav.mavlink import load_dialect

if TYPE_CHECKING:
    from tests.ground.http.conftest import Serve

BEGIN = 1_700_000_000


def recorded(folder: Path) -> Path:
    """Half a minute in which quad1 climbs a metre a second."""
    with Folder(folder) as there:
        storage = Storage(there, RecordingSettings(), load_dialect(), lambda text: None)
        storage.start()
        for tick in range(151):
            t = BEGIN + tick / 5.0
            place = wire.GlobalPosition(lat_deg=-35.3, lon_deg=149.1, alt_amsl=600.0, alt_rel=tick / 5.0)
            about: dict[str, Any] = {"fleet": "demo", "name": "quad1", "instance": "i", "connected": True, "sysid": 1}
            state = wire.VehicleState(t=t, position=place, armed=True, **about)
            storage.put("zmav/demo/quad1/state", wire.encode(state), at=int(t * 1e9))
        storage.close()
    (path,) = folder.glob("*/*.mcap")
    assert mcapfile.last(path) == (BEGIN + 30) * 1_000_000_000
    return path


class Gateway:
    """'zmav http --replay' in a process of its own."""

    def __init__(self, endpoint: str, path: Path) -> None:
        environment = {name: text for name, text in os.environ.items() if not name.startswith("ZMAV_")}
        arguments = ["http", "--port", "0", "-e", endpoint, "--replay", str(path)]
        command = [sys.executable, "-m", "zmav", *arguments]
        self.process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment)
        assert self.process.stderr is not None
        for line in self.process.stderr:
            if found := re.fullmatch(r"fleet demo-replay at (http://127\.0\.0\.1:\d+)/, only reading\n", line):
                self.url = found[1]
                return
        raise AssertionError("it does not serve")

    def ask(self, path: str, body: Any = None) -> tuple[int, Any]:
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(self.url + path, data, {"Content-Type": "application/json"})
        try:
            with urllib.request.urlopen(request, timeout=30.0) as reply:
                return reply.status, json.load(reply)
        except urllib.error.HTTPError as e:
            return e.code, json.load(e)

    def until(self, true: Any) -> None:
        deadline = time.monotonic() + 20.0
        while not true():
            assert time.monotonic() < deadline, self.ask("/replay")
            time.sleep(0.1)


def test_a_recording_is_shown_and_steered_and_takes_no_orders(serve: Serve, tmp_path: Path) -> None:
    gateway = Gateway(serve().endpoint, recorded(tmp_path))
    try:
        status, told = gateway.ask("/replay")
        assert status == 200 and (told["begin"], told["end"], told["error"]) == (BEGIN, BEGIN + 30, "")
        with urllib.request.urlopen(gateway.url + "/", timeout=30.0) as reply:
            page = reply.read().decode()
        assert 'name="zmav-replay" content="yes"' in page and 'name="zmav-read-only" content="yes"' in page

        assert gateway.ask("/replay", {"paused": True, "to": 20})[1]["paused"]
        gateway.until(lambda: gateway.ask("/replay")[1]["at"] == BEGIN + 20)
        status, report = gateway.ask("/report")
        assert [(each["fleet"], each["name"]) for each in report["vehicles"]] == [("demo-replay", "quad1")]

        assert gateway.ask("/replay", {"paused": False, "speed": 10})[1]["speed"] == 10
        gateway.until(lambda: gateway.ask("/replay")[1]["paused"])
        assert gateway.ask("/replay")[1]["at"] == BEGIN + 30

        for path in ("/do/quad1/hold", "/fleet/rtl", "/swarm/pause", "/mission/upload?vehicles=quad1"):
            status, told = gateway.ask(path, {})
            assert status == 403 and told["error"]["kind"] == "read_only", path
        for wrong in ({"speed": 0}, {"speed": 1e9}, {"to": "there"}, {"slower": 1}):
            assert gateway.ask("/replay", wrong)[0] == 400, wrong
        gateway.process.send_signal(signal.SIGTERM)
        assert gateway.process.wait(30.0) == 0
    finally:
        gateway.process.kill()
        gateway.process.communicate()


def test_a_gateway_of_a_fleet_plays_nothing(serve: Serve) -> None:
    served = serve()
    assert served.get("/replay").status == 404 and served.post("/replay", {"paused": True}).status == 404
    assert 'name="zmav-replay" content="no"' in served.get("/").text


@pytest.mark.parametrize("name", ["none.mcap", "."])
def test_what_is_no_recording_is_said_before_anything_is_served(name: str, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "zmav", "http", "--port", "0", "--replay", str(tmp_path / name)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60.0, check=False)
    assert done.returncode != 0 and "no .mcap and no .tlog" in done.stderr
