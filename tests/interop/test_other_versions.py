"""A recorded fleet of version 0.1, and the same as a later version may say it, before today's programs of the ground.

What only tells how something is is read, whatever fields are in it that are not known here; what asks for something
(goals, obstacles) is refused whole where there is one; and nobody falls over. The vehicles are played: their tokens,
samples and answers are those of tests/interop/fleet-0.1.jsonl, with today's times. That today's vehicle refuses a newer
ground's orders and setpoints is in tests/services.
"""

from __future__ import annotations

import asyncio
import base64
import collections
import contextlib
import http.client
import json
import re
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import zenoh
from click.testing import CliRunner

import zmav
from agents.planner.live.checks import read_obstacle
from agents.planner.live.fleet import Fleet
from ground.gcs.bridge import Bridge, BridgeSettings
from ground.gcs.options import Options, parse_endpoint
from ground.gcs.udp import UdpIn
from ground.http.app import make_app
from ground.http.gateway import Gateway
from ground.http.server import bound, serving
from ground.record.folder import Folder
from ground.record.recorder import Recorder, Wanted
from ground.record.storage import RecordingSettings
from tests.waiting import until
from zmav import cli, host, keys, wire
from zmav.errors import BadInput, NotHolder
from zmav.mavlink import Packer, Splitter, load_dialect

if TYPE_CHECKING:
    from tests.conftest import Net

RECORDED = Path(__file__).parent / "fleet-0.1.jsonl"
NAMES = ("quad1", "quad2")
EXTRA = {"of_2031": {"deep": [1, None, "x"]}}
NESTED = ("position", "attitude", "battery", "gps", "clock", "lease", "segment", "lease_end")
EVERY_S = 0.2
OLDEST = "0.0.1"
"""what quad2 says of its zmav: older than any that tests this"""


def lines() -> list[dict[str, Any]]:
    return [json.loads(line) for line in RECORDED.read_text(encoding="utf-8").splitlines()]


def payload(line: dict[str, Any]) -> bytes:
    return base64.b64decode(line["base64"]) if "base64" in line else line["text"].encode()


def later(data: bytes) -> bytes:
    """The same with fields that nobody knows yet, as it is and in what is in it."""
    try:
        value = json.loads(data)
    except ValueError:
        return data
    if not isinstance(value, dict):
        return data
    more = {name: {**value[name], **EXTRA} for name in NESTED if isinstance(value.get(name), dict)}
    return json.dumps({**value, **more, **EXTRA}).encode()


class Played:
    """Says what they said, again and again, and answers as they did, from a router's session."""

    def __init__(self, session: zenoh.Session, endpoint: str, newer: bool) -> None:
        self.session, self.endpoint, self.newer = session, endpoint, newer
        self.asked: list[str] = []
        self._samples: dict[str, list[bytes]] = collections.defaultdict(list)
        self._answers: dict[str, tuple[str, bytes, bool]] = {}
        self._held: list[Any] = []
        for line in lines():
            if line["kind"] == "token":
                self._held.append(session.liveliness().declare_token(line["key"]))
            elif line["kind"] == "put":
                self._samples[line["key"]].append(self._said(line))
            else:
                asked = line["asked"] if "*" not in line["asked"] else line["key"]
                self._answers[asked] = (line["key"], self._said(line), line["kind"] == "error")
        self._held.append(session.declare_queryable("zmav/demo/*/**", self._answer))
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._speak)
        self._thread.start()

    def _said(self, line: dict[str, Any]) -> bytes:
        data = later(payload(line)) if self.newer else payload(line)
        if line["key"] == keys.HOST.key("demo", "quad2"):
            report = json.loads(data)
            report["versions"]["zmav"] = OLDEST
            data = json.dumps(report).encode()
        return data

    def _speak(self) -> None:
        turn = 0
        while not self._over.wait(EVERY_S):
            for key, samples in self._samples.items():
                if not key.endswith("/event") or turn % 10 == 0:
                    self.session.put(key, _now(samples[turn % len(samples)]))
            turn += 1

    def _answer(self, query: zenoh.Query) -> None:
        with query:
            self.asked.append(str(query.key_expr))
            for asked, (key, data, error) in self._answers.items():
                if not query.key_expr.intersects(zenoh.KeyExpr(asked)):
                    continue
                if error:
                    query.reply_err(data, encoding=keys.JSON)
                else:
                    query.reply(key, _now(data), encoding=keys.JSON)

    def close(self) -> None:
        self._over.set()
        self._thread.join()
        for each in self._held:
            each.undeclare()


def _now(data: bytes) -> bytes:
    """With the time of now: clocks agree."""
    return re.sub(rb'^\{"t": ?[\d.e+]+', b'{"t":%f' % time.time(), data, count=1)


@pytest.fixture(params=["0.1", "newer"])
def fleet(request: pytest.FixtureRequest, net: Net) -> Iterator[Played]:
    session, endpoint = net.router()
    played = Played(session, endpoint, newer=request.param == "newer")
    yield played
    played.close()


def run(fleet: Played, *arguments: str) -> str:
    """What a verb prints; it ends by itself, and with no traceback."""
    done = CliRunner().invoke(cli.zmav, [*arguments, "-e", fleet.endpoint], catch_exceptions=False)
    return done.stdout


def test_the_recording_has_every_kind_of_word() -> None:
    kinds = collections.Counter(keys.match(line["key"])[0].name for line in lines())
    said = {
        "state",
        "event",
        "rx",
        "link",
        "agent_status",
        "fleet",
        "alive",
        "holder",
        "do",
        "swarm",
        "param",
        "mission",
    }
    assert said <= kinds.keys()
    assert {"goal", "charge", "plan", "obstacle"} <= {line["key"].rpartition("/")[2] for line in lines()}
    assert RECORDED.stat().st_size < 200_000


def test_every_payload_of_0_1_is_one_of_todays_types() -> None:
    for line in lines():
        if line["kind"] == "token":
            continue
        kind = wire.ErrorBody if line["kind"] == "error" else keys.match(line["key"])[0].payload
        if kind is wire.LinkQuality and line["key"].rpartition("/")[2] in NAMES:
            kind = wire.NeighbourQuality
        if kind is not None:
            wire.decode(payload(line), kind, line["key"])


async def test_a_script_sees_and_orders(fleet: Played) -> None:
    async with zmav.open(connect=[fleet.endpoint]) as z:
        for vehicle in await z.wait_for(*NAMES):
            assert (vehicle.state.kind, vehicle.state.armed, vehicle.present) == ("copter", True, True)
            assert vehicle.state.local is not None and vehicle.state.lease is not None
            assert vehicle.state.lease.holder == "ground"
            assert (await vehicle.message("ATTITUDE")).fields["roll"] == pytest.approx(0.0, abs=0.5)
            assert (await vehicle.params.get("RTL_ALT")).value
            await vehicle.ping()
            with pytest.raises(NotHolder, match="ground commands quad"):
                await vehicle.goto(pos=(0.0, 0.0, -10.0))


def test_tables_and_monitor(fleet: Played) -> None:
    listed = [json.loads(line) for line in run(fleet, "ls", "--json", "--wait", "3").splitlines()]
    assert sorted(each["name"] for each in listed) == list(NAMES)
    assert "GUIDED" in run(fleet, "ls", "--wait", "3")
    report = json.loads(run(fleet, "top", "--json", "--wait", "5"))
    assert sorted(vehicle["name"] for vehicle in report["vehicles"]) == list(NAMES)
    assert [agent["name"] for agent in report["agents"]] == ["planner"]
    assert all(vehicle["link"] is not None for vehicle in report["vehicles"])


def test_the_doctor_names_who_is_older(fleet: Played) -> None:
    found = [json.loads(line) for line in run(fleet, "doctor", "--json").splitlines()]
    versions = [each for each in found if each["subject"] == "versions zmav"]
    assert len(versions) == 1, found
    (zmavs,) = versions
    ours = host.versions()["zmav"]
    assert f"demo/quad1 runs zmav 0.1.0, demo/quad2 runs zmav {OLDEST}: this is {ours}" in zmavs["found"]
    assert f"on demo/quad1, demo/quad2 pip install zmav=={ours}" in zmavs["advice"]


async def test_the_gateway(fleet: Played) -> None:
    async with (
        zmav.open(connect=[fleet.endpoint]) as z,
        Gateway(z, False) as gateway,
        serving(make_app(gateway, None), bound("127.0.0.1", 0)) as port,
    ):

        def get(path: str) -> tuple[int, bytes]:
            connection = http.client.HTTPConnection("127.0.0.1", port, timeout=30)
            with contextlib.closing(connection):
                connection.request("GET", path)
                answer = connection.getresponse()
                return answer.status, answer.read()

        await z.wait_for(*NAMES)
        status, text = await asyncio.to_thread(get, "/vehicles")
        assert status == 200 and b"quad1 1 1 ardupilot copter GUIDED 1" in text
        for path in ("/keys/quad1", "/keys/quad1/rates", "/keys/quad2/link/*", "/metrics", "/report"):
            status, text = await asyncio.to_thread(get, path)
            assert status == 200 and b"quad" in text, (path, text)
        status, text = await asyncio.to_thread(get, "/do/quad1/goto?lat_deg=-35&lon_deg=149&alt_rel=10&frame=global")
        assert (status, json.loads(text)["error"]["kind"]) == (409, "not_holder"), text


async def test_a_ground_station(fleet: Played) -> None:
    """QGroundControl's side of the bridge: both autopilots' heartbeats come through."""
    ends = (parse_endpoint("udpin", "0", Options()),)
    async with (
        zmav.open(connect=[fleet.endpoint]) as z,
        Bridge(z, BridgeSettings(endpoints=ends, vehicles=("*",), streams=False), lambda line: None) as bridge,
    ):
        (end,) = (each for each in bridge.endpoints if isinstance(each, UdpIn))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
            station.connect(end.address)
            station.setblocking(False)
            beats, splitter, heard = Packer(load_dialect(), 255, 190), Splitter(load_dialect()), set[int]()

            def both() -> bool:
                station.send(beats.pack("HEARTBEAT", type=6, autopilot=8, system_status=4))
                with contextlib.suppress(BlockingIOError):
                    while True:
                        heard.update(frame.sysid for frame in splitter.feed(station.recv(65535)))
                return heard >= {1, 2}

            await until(both, "frames of both")


async def test_the_recorder(fleet: Played, tmp_path: Path) -> None:
    folder, settings = Folder(tmp_path / "flights"), RecordingSettings(keep_free=0, flush=0.1)
    said: list[str] = []
    try:
        async with (
            zmav.open(connect=[fleet.endpoint]) as z,
            Recorder(z, folder, settings, Wanted(name="desk"), said.append) as recorder,
        ):
            await until(lambda: recorder.storage.counts.written > 100, "samples")
        session = recorder.storage.session
    finally:
        folder.close()
    assert sorted(file.name.split(".")[0] for file in session.glob("*.tlog")) == list(NAMES)
    assert list(session.glob("*.mcap"))


async def test_the_planners_view(fleet: Played) -> None:
    async with zmav.open(connect=[fleet.endpoint]) as z:
        view = Fleet(z)
        await z.wait_for(*NAMES)
        for name in NAMES:
            await view.bodies.ask(name)
        view.watch()
        assert view.names == list(NAMES)
        assert all(view.seen(name) is not None for name in NAMES)
        assert view.hearing().airborne == set(NAMES)


def test_what_asks_for_something_is_refused_with_a_field_that_is_not_known() -> None:
    goals = next(payload(line) for line in lines() if line["key"].endswith("@fleet/goal"))
    wire.decode(goals, wire.swarm.Book, "book")
    with pytest.raises(BadInput, match="of_2031"):
        wire.decode(later(goals), wire.swarm.Book, "book")
    told = json.loads(next(payload(line) for line in lines() if line["key"].endswith("@fleet/obstacle")))
    obstacle = json.dumps(told["obstacles"][0]).encode()
    assert read_obstacle(obstacle).name == "tower"
    with pytest.raises(BadInput, match="of_2031"):
        read_obstacle(later(obstacle))
