"""Cursor on target: what an event says, and taky, other people's TAK server, that passes ours on to its clients."""

from __future__ import annotations

import asyncio
import contextlib
import datetime
import ipaddress
import math
import shutil
import time
import xml.etree.ElementTree as ET
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from click.testing import CliRunner
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec

import zmav
from ground.tak.cli import command
from ground.tak.cot import MOST_POINTS, Cot, places_of
from ground.tak.program import Tak, TakSettings, tls_of
from zmav import keys, wire
from zmav.errors import BadInput, BadUrl
from zmav.process import free_port
from zmav.session import SessionSettings
from zmav.wire import swarm

if TYPE_CHECKING:
    from tests.conftest import Net

PATIENCE_S = 30.0
NOW = 1_800_000_000.0
PLACE = wire.GlobalPosition(lat_deg=47.3977, lon_deg=8.5456, alt_amsl=508.0, alt_rel=20.0)


def state(**more: object) -> wire.VehicleState:
    known = {
        "t": time.time(),
        "fleet": "demo",
        "name": "quad1",
        "instance": "i",
        "connected": True,
        "kind": "copter",
        "autopilot": "ardupilot",
        "armed": True,
        "mode": "GUIDED",
        "position": PLACE,
        "local": (0.0, 0.0, -20.0),
        "velocity": (3.0, 4.0, 0.0),
        "battery": wire.Battery(remaining=0.8),
    }
    return wire.VehicleState(**{**known, **more})  # type: ignore[arg-type]


def read(event: bytes | None) -> ET.Element:
    assert event is not None
    return ET.fromstring(event)


# Events.


def test_a_vehicle() -> None:
    event = read(Cot("demo", None).vehicle(state(), NOW, 10.0))
    assert (event.get("uid"), event.get("type"), event.get("how")) == ("zmav.demo.quad1", "a-f-A-M-H-Q", "m-g")
    assert (event.get("time"), event.get("stale")) == ("2027-01-15T08:00:00.000Z", "2027-01-15T08:00:10.000Z")
    point, track = event.find("point"), event.find("detail/track")
    assert point is not None
    assert track is not None
    assert (point.get("lat"), point.get("hae"), point.get("le")) == ("47.3977000", "508.0", "110.0")
    assert (track.get("course"), track.get("speed")) == ("53.1", "5.00")
    assert "hae is above sea level" in str(event.findtext("detail/remarks"))


def test_heights_above_the_ellipsoid_where_the_geoid_is_known() -> None:
    event = read(Cot("demo", 47.0).vehicle(state(), NOW, 10.0))
    point = event.find("point")
    assert point is not None
    assert (point.get("hae"), point.get("le")) == ("555.0", "10.0")
    assert "hae is above the ellipsoid" in str(event.findtext("detail/remarks"))


@pytest.mark.parametrize("kind", ["copter", "plane", "rover", "boat", "vtol", "heli", "other", None])
def test_every_kind_of_vehicle_is_a_friend(kind: str | None) -> None:
    assert str(read(Cot("demo", None).vehicle(state(kind=kind), NOW, 10.0)).get("type")).startswith("a-f-")


def test_a_vehicle_that_stands_looks_where_it_looks_and_one_without_a_place_is_not_said() -> None:
    still = state(velocity=(0.0, 0.0, 0.0), attitude=wire.Attitude(roll=0.0, pitch=0.0, yaw=-math.pi / 2.0))
    track = read(Cot("demo", None).vehicle(still, NOW, 10.0)).find("detail/track")
    assert track is not None
    assert track.get("course") == "270.0"
    wrong = state(velocity=(0.0, 0.0, 0.0), attitude=wire.Attitude(roll=0.0, pitch=0.0, yaw=1e308))
    assert "nan" not in str(Cot("demo", None).vehicle(wrong, NOW, 10.0))
    assert Cot("demo", None).vehicle(state(position=None), NOW, 10.0) is None


def test_hostile_words_are_text() -> None:
    event = read(Cot("demo", None).vehicle(state(mode='<x/>"&\x00\x1b]]>' * 50), NOW, 10.0))
    words = str(event.findtext("detail/remarks"))
    assert len(words) <= 200
    assert "<x/>" in words


def test_an_alarm_begins_and_ends() -> None:
    cot = Cot("demo", None)
    begins, ends = read(cot.alarm(state(), "battery 5%", NOW, 60.0)), read(cot.alarm(state(), "", NOW, 60.0))
    assert (begins.get("type"), ends.get("type")) == ("b-a-o-tbl", "b-a-o-can")
    assert begins.get("uid") == ends.get("uid") == "zmav.demo.quad1-9-1-1"
    assert begins.findtext("detail/remarks") == "battery 5%"
    found = ends.find("detail/emergency")
    assert found is not None
    assert found.get("cancel") == "true"


def test_a_way_is_thinned_out_and_ends_in_a_marker() -> None:
    track = [(float(t), float(t), 0.0, -20.0) for t in range(101)]
    goal, route = map(read, Cot("demo", None).way("quad1", "g1", places_of(state(), track), NOW, 60.0))
    links = route.findall("detail/link")
    assert len(links) == MOST_POINTS
    point = goal.find("point")
    assert point is not None
    north = (float(str(point.get("lat"))) - PLACE.lat_deg) * 111_200.0
    assert north == pytest.approx(100.0, abs=1.0)
    assert str(links[-1].get("point")).startswith(str(point.get("lat")))
    assert point.get("hae") == "508.0"
    assert places_of(state(local=None), track) == []


# taky.


def authority(folder: Path) -> Path:
    """A certificate for 127.0.0.1 that signs itself, and its key."""
    key, now = ec.generate_private_key(ec.SECP256R1()), datetime.datetime.now(datetime.timezone.utc)
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "taky")])
    day = datetime.timedelta(days=1)
    made = x509.CertificateBuilder().subject_name(name).issuer_name(name).public_key(key.public_key())
    made = made.serial_number(1).not_valid_before(now - day).not_valid_after(now + day)
    made = made.add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
    names = x509.SubjectAlternativeName([x509.IPAddress(ipaddress.ip_address("127.0.0.1"))])
    signed = made.add_extension(names, critical=False).sign(key, hashes.SHA256())
    plain = serialization.NoEncryption()
    secret = key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, plain)
    (folder / "key.pem").write_bytes(secret)
    (folder / "cert.pem").write_bytes(signed.public_bytes(serialization.Encoding.PEM))
    return folder / "cert.pem"


class Taky:
    """taky as a process of its own; :meth:`client` is one of its clients, plain."""

    def __init__(self, port: int) -> None:
        self.port = port
        self.events: list[ET.Element] = []

    def of(self, kind: str, uid: str = "") -> list[ET.Element]:
        return [e for e in self.events if str(e.get("type")).startswith(kind) and (not uid or e.get("uid") == uid)]


def program() -> str:
    """taky has a virtual environment of its own: its package brings a ``tests`` that would hide ours."""
    found = shutil.which("taky")
    if found is None:
        pytest.skip("no taky is on the path (python -m venv V && V/bin/pip install taky; PATH=$PATH:V/bin)")
    return found


@contextlib.asynccontextmanager
async def taky(folder: Path, tls: bool = False, port: int = 0) -> AsyncIterator[Taky]:
    server = Taky(port or free_port())
    lines = [
        "[taky]",
        "hostname=taky",
        "bind_ip=127.0.0.1",
        f"root_dir={folder}",
        "[cot_server]",
        f"port={server.port}",
    ]
    lines += ["mon_ip=127.0.0.1", f"mon_port={free_port()}"]
    lines += ["[dp_server]", f"upload_path={folder}", "[ssl]", f"enabled={str(tls).lower()}"]
    if tls:
        lines += [
            "client_cert_required=false",
            f"cert={folder}/cert.pem",
            f"key={folder}/key.pem",
            f"ca={folder}/cert.pem",
        ]
    (folder / "taky.conf").write_text("\n".join(lines))
    words = [program(), "-l", "debug", "-c", str(folder / "taky.conf")]
    process = await asyncio.create_subprocess_exec(*words, cwd=folder)
    try:
        yield server
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.terminate()
        await process.wait()


async def hear(server: Taky, ca: Path | None = None) -> None:
    """A client of taky's that says nothing, for ever."""
    import ssl

    while True:
        with contextlib.suppress(OSError):
            context = ssl.create_default_context(cafile=str(ca)) if ca is not None else None
            reader, writer = await asyncio.open_connection("127.0.0.1", server.port, ssl=context)
            parser: ET.XMLPullParser[Any] = ET.XMLPullParser(["end"])
            parser.feed(b"<stream>")
            writer.write(b"<event version='2.0' uid='ear' type='t-x-c-t' how='m-g' time='2027-01-15T08:00:00Z' ")
            writer.write(b"start='2027-01-15T08:00:00Z' stale='2037-01-15T08:00:00Z'>")
            writer.write(b"<point lat='0' lon='0' hae='0' ce='1' le='1'/></event>\n")
            while data := await reader.read(65_536):
                parser.feed(data.replace(b"<?xml version='1.0' encoding='utf-8'?>", b""))
                events: Any = parser.read_events()
                found = [event[1] for event in events]
                server.events += [each for each in found if each.tag == "event"]
        await asyncio.sleep(0.2)


async def until(true: Callable[[], object], what: Callable[[], object] | str) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not true():
        assert time.monotonic() < deadline, what() if callable(what) else what
        await asyncio.sleep(0.05)


class Stage:
    """A router, a vehicle that says its state, and ``zmav tak`` beside it."""

    def __init__(self, net: Net) -> None:
        self.net = net
        _, self.endpoint = net.router()
        self.ground = net.ground(self.endpoint)
        self.said: list[str] = []
        self.state = state()

    async def speak(self) -> None:
        while True:
            self.state.t = time.time()
            self.ground.session.put(keys.STATE.key("demo", "quad1"), wire.encode(self.state))
            await asyncio.sleep(0.2)

    def plan(self, goal: str, start: float) -> None:
        """The planner says what it flies for a minute."""
        tracks = {"quad1": [(0.0, 0.0, 0.0, -20.0), (20.0, 80.0, 0.0, -20.0)]}
        more: dict[str, Any] = {"makespan": 60.0, "clearance": None, "tracks": tracks}
        plan = swarm.PlanReport(t=time.time(), planner="ground", goal=goal, start=start, **more)
        self.ground.session.put(keys.FLEET.key("demo", topic="plan"), wire.encode(plan))

    @contextlib.asynccontextmanager
    async def tak(self, url: str, **more: object) -> AsyncIterator[Tak]:
        async with zmav.open(settings=SessionSettings(connect=[self.endpoint])) as z:
            speaking = asyncio.create_task(self.speak())
            settings = TakSettings(**{"url": url, "name": "ground", "every": 0.3, **more})  # type: ignore[arg-type]
            try:
                async with Tak(z, settings, self.said.append) as one:
                    yield one
            finally:
                speaking.cancel()


@pytest.fixture
def stage(net: Net) -> Stage:
    return Stage(net)


async def test_taky_passes_vehicles_alarms_and_goals_on(stage: Stage, tmp_path: Path) -> None:
    async with taky(tmp_path) as server, stage.tak(f"tcp://127.0.0.1:{server.port}") as tak:
        hearing = asyncio.create_task(hear(server))
        uid = "zmav.demo.quad1"
        await until(lambda: server.of("a-f-A-M-H-Q", uid), lambda: (stage.said, server.events))
        stage.state = state(battery=wire.Battery(remaining=0.01))
        await until(lambda: server.of("b-a-o-tbl", f"{uid}-9-1-1"), "an alarm")
        stage.state = state()
        await until(lambda: server.of("b-a-o-can", f"{uid}-9-1-1"), "its end")
        stage.plan("g1", time.time())
        await until(lambda: server.of("b-m-p-w-GOTO", f"{uid}.goal"), "a goal")
        await until(lambda: server.of("b-m-r", f"{uid}.way"), "a way")
        assert tak.status()[0] == "up"
        hearing.cancel()


async def test_by_tls_the_server_proves_itself(stage: Stage, tmp_path: Path) -> None:
    ca = authority(tmp_path)
    key = str(tmp_path / "key.pem")
    async with taky(tmp_path, tls=True) as server:
        url = f"tls://127.0.0.1:{server.port}"
        hearing = asyncio.create_task(hear(server, ca))
        async with stage.tak(url, tls=tls_of(str(ca), key, str(ca))):
            await until(lambda: server.of("a-f-A-M-H-Q"), lambda: stage.said)
        async with stage.tak(url, tls=tls_of(str(ca), key, None)) as stranger:
            await until(lambda: any("not believed: give --ca" in said for said in stage.said), lambda: stage.said)
            assert stranger.events == 0
        hearing.cancel()


async def test_a_server_that_comes_late_and_again_is_connected_to(stage: Stage, tmp_path: Path) -> None:
    port = free_port()
    async with stage.tak(f"tcp://127.0.0.1:{port}") as tak:
        await until(lambda: tak.state == "lost", "a word")
        for _ in range(2):
            async with taky(tmp_path, port=port):
                await until(lambda: tak.state == "up", "a connection")
            await until(lambda: tak.state == "lost", "the end of it")
        assert tak.sent == 2


async def test_what_a_server_says_is_not_looked_at(stage: Stage) -> None:
    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError, asyncio.CancelledError):
            while True:
                writer.write(b"<event type='b-t-f'><detail><remarks>land quad1" + b"<" * 65_536)
                await writer.drain()
                await asyncio.sleep(0.01)

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    async with stage.tak(f"tcp://127.0.0.1:{server.sockets[0].getsockname()[1]}") as tak:
        await until(lambda: tak.ignored > 1_000_000 and tak.events > 5, "events beside a flood")
        assert tak.state == "up"
    server.close()


async def test_by_datagrams(stage: Stage) -> None:
    heard: list[bytes] = []

    class Ear(asyncio.DatagramProtocol):
        def datagram_received(self, data: bytes, addr: object) -> None:
            heard.append(data)

    transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(Ear, local_addr=("127.0.0.1", 0))
    port = transport.get_extra_info("sockname")[1]
    async with stage.tak(f"udp+wo://127.0.0.1:{port}"):
        await until(lambda: len(heard) > 2, lambda: stage.said)
        assert {read(data).get("uid") for data in heard} == {"zmav.demo.quad1"}
        for goal, ago in (("g2", 1.0), ("g1", 30.0)):  # the first was stopped long before its end
            stage.plan(goal, time.time() - ago)
        await until(lambda: any(b"zmav.demo.quad1.way" in data for data in heard), lambda: stage.said)
        stage.plan("g3", time.time())
        await until(lambda: any(b"quad1 g3" in data for data in heard), lambda: stage.said)
    assert not any(b"quad1 g1" in data for data in heard), "it is not what is flown"
    transport.close()


async def test_what_is_said_seldom_is_of_now_until_it_is_said_again(stage: Stage) -> None:
    heard: list[bytes] = []

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        heard.append(await reader.readuntil(b"</event>"))

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    async with stage.tak(f"tcp://127.0.0.1:{server.sockets[0].getsockname()[1]}", every=6.0):
        await until(lambda: heard, lambda: stage.said)
    event = read(heard[0].strip())
    said, stale = (datetime.datetime.fromisoformat(str(event.get(what))[:-1]) for what in ("time", "stale"))
    assert (stale - said).total_seconds() == pytest.approx(15.0)
    server.close()


# The command line.


@pytest.mark.parametrize(
    "url",
    ["nowhere", "http://h:1", "tcp://h", "tcp://h:x", "file:///etc/passwd", "tak://h:1", "tcp://h:0", "tcp://h:65536"],
)
def test_what_is_no_server_is_refused(url: str) -> None:
    result = CliRunner().invoke(command, [url])
    assert isinstance(result.exception, BadUrl)


def test_a_certificate_that_is_not_there_is_refused() -> None:
    for words, says in ((["--cert", "/nowhere.pem"], "no file /nowhere.pem"), ([], "give --cert")):
        result = CliRunner().invoke(command, ["tls://h:1", *words])
        assert isinstance(result.exception, BadInput)
        assert says in str(result.exception)
