"""``zmav doctor`` beside a fleet of real processes: green while all is well, red with the right words for each fault
that is planted. One fleet and one test, because starting it costs more than all that is looked at."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest
import zenoh

import zmav
from mesh.credentials.ca import Authority
from tests.cli.conftest import PATIENCE_S, Process, zmav_here
from tests.mesh.quality.relay import Relay, nothing
from tests.ports import free_udp_ports
from zmav import keys, wire
from zmav.cli import doctor
from zmav.client import Client
from zmav.doctor import survey
from zmav.process import free_port
from zmav.session import SessionSettings, open_session
from zmav.trust.certificate import Role

if TYPE_CHECKING:
    from tests.cli.conftest import Told

WAY = "way alpha/quad1 - alpha/quad2"
OFF_S = 7.0
OTHER = "9.9.9"
SHIFTED = f"""
import importlib.metadata, runpy, sys, time
true, versions = time.time, importlib.metadata.version
time.time = lambda: true() + {OFF_S}
importlib.metadata.version = lambda name: {OTHER!r} if name == "zmav" else versions(name)
sys.argv[0] = "zmav"
runpy.run_module("zmav", run_name="__main__")
"""
"""``zmav`` on a computer whose clock is ahead and whose zmav is another; Zenoh's own clock stays right"""
FLEET = """
fleet = "alpha"

[origin]
lat_deg = -35.363261
lon_deg = 149.165230
alt_amsl = 584.09

[mesh]
lease = 1.0
retry = 0.5

[vehicles.quad1]
link = "{folder}/ttyACM0,921600"
sysid = 1
listen = ["tcp/127.0.0.1:{one}", "udp/127.0.0.1:{radio}?rel=1;mixed_rel=1"]
sim = {{ params = {{ FS_GCS_ENABLE = 1, DISARM_DELAY = 0 }} }}

[vehicles.quad2]
link = "tcp:127.0.0.1:{sim}"
sysid = 2
listen = ["tcp/127.0.0.1:{two}"]
connect = ["{relay}"]
sim = {{ params = {{ FS_GCS_ENABLE = 1, DISARM_DELAY = 0 }} }}

[stations.ground]
listen = ["tcp/127.0.0.1:{ground}"]
connect = ["tcp/127.0.0.1:{one}"]
"""


class Fleet(NamedTuple):
    file: Path
    ground: str
    relay: Relay
    start: Callable[..., Process]

    def doctor(self, *arguments: str, seconds: float = 0.6) -> Told:
        """From the ground, by the fleet file."""
        last = ("--for", str(seconds), "-e", self.ground, "--json")
        return zmav_here("doctor", "--file", str(self.file), *arguments, *last)

    def red(self, *arguments: str, seconds: float = 0.6) -> dict[str, dict[str, Any]]:
        """Its red lines, of which there are some."""
        told = self.doctor(*arguments, seconds=seconds)
        assert told.code == 1, told
        found = {line["subject"]: line for line in told.lines if line["level"] == "red"}
        assert all(line["advice"] for line in found.values()), found
        return found

    async def until(self, z: Client, name: str, true: Callable[[zmav.VehicleState], bool]) -> None:
        await z.vehicle(name).wait_until(true, PATIENCE_S)

    def open(self) -> Client:
        return zmav.open(fleet="alpha", connect=[self.ground])


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Fleet]:
    """Two vehicles, whose simulated autopilots are on a serial port and on TCP, and a router on the ground."""
    one, two, ground, sim = (free_port() for _ in range(4))
    radio = free_udp_ports(1)
    running: list[Process] = []

    def start(*arguments: str, code: str | None = None) -> Process:
        how = ("-m", "zmav") if code is None else ("-c", code)
        running.append(Process(sys.executable, *how, *arguments))
        return running[-1]

    file = tmp_path / "fleet.toml"
    with Relay(radio) as relay, contextlib.ExitStack() as stack:

        def end() -> None:
            for process in running:
                if process.popen.poll() is None:
                    process.popen.terminate()
            for process in running:
                process.wait()

        stack.callback(end)
        file.write_text(
            FLEET.format(folder=tmp_path, one=one, two=two, ground=ground, sim=sim, radio=radio, relay=relay.endpoint)
        )
        start("sim", "--fleet", str(file)).expect("quad2 (system id 2)")
        cache = ("--cache", str(tmp_path / "cache"))
        ups = [start("up", "--file", str(file), "--name", name, *cache) for name in ("quad1", "quad2")]
        ups.append(start("router", "--file", str(file), "--name", "ground"))
        for up, words in zip(ups, ("alpha/quad1: ", "alpha/quad2: ", "router "), strict=True):
            up.expect(words)
        made = Fleet(file, f"tcp/127.0.0.1:{ground}", relay, start)
        asyncio.run(_settled(made))
        yield made


async def _settled(fleet: Fleet) -> None:
    """Until both vehicles are ready, their parameters read and the link between them measured."""
    async with fleet.open() as z:
        for name in ("quad1", "quad2"):
            await fleet.until(z, name, lambda s: bool(s.ready and s.uid))
            await z.vehicle(name).params.list()
        await linked(z, lambda q: q.state == "up" and q.rtt is not None and not q.loss_in and not q.loss_out)


async def linked(z: Client, true: Callable[[wire.NeighbourQuality], bool]) -> None:
    """Wait for what quad1 says of its link to quad2."""
    key = keys.LINK.key("alpha", "quad1", link="quad2")

    async def wait() -> None:
        async with z.subscribe(key, lambda sample: wire.decode_link(sample.payload.to_bytes())) as qualities:
            async for quality in qualities:
                if isinstance(quality, wire.NeighbourQuality) and true(quality):
                    return

    await asyncio.wait_for(wait(), PATIENCE_S)


def test_a_fleet_is_green_and_then_red_with_the_right_words(
    fleet: Fleet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    well(fleet)
    failsafe(fleet)
    cut(fleet)
    strangers(fleet, tmp_path, monkeypatch)
    liars(fleet)
    credentials(fleet, tmp_path)


def well(fleet: Fleet) -> None:
    """From the ground, and on the vehicle, whose serial port is left to its 'zmav up'."""
    told = fleet.doctor()
    lines = {line["subject"]: line for line in told.lines}
    assert told.code == 0, [line for line in told.lines if not line["ok"]]
    assert lines["vehicles"]["found"] == "2 present (all of the fleet file)"
    for subject in (
        "router ground",
        "weakest",
        "alpha/quad2 clock",
        "alpha/ground computer",
        "versions zmav",
        "firmware",
    ):
        assert lines[subject]["level"] == "ok", lines
    assert "alpha/quad1 - alpha/quad2" in lines["weakest"]["found"] or "ground" in lines["weakest"]["found"]
    assert lines["versions zmav"]["found"].endswith("on this host and 3 that tell")
    told = zmav_here("doctor", "--file", str(fleet.file), "--name", "quad1", "--for", "1.2", "--json")
    assert told.code == 0, [line for line in told.lines if not line["ok"]]
    lines = {line["subject"]: line for line in told.lines}
    assert lines["holder"]["found"].startswith("held by zmav up (pid ")
    assert "traffic" not in lines, "it was listened to"
    page = zmav_here("doctor", "--file", str(fleet.file), "--for", "1.2", "-e", fleet.ground)
    assert [line for line in page.out.splitlines() if line and not line.startswith(" ")][1:-1] == [
        "routers and links",
        "alpha/ground",
        "alpha/quad1",
        "alpha/quad2",
        "fleet",
    ]
    assert len(page.out.splitlines()) < 60


def failsafe(fleet: Fleet) -> None:
    """A parameter that leaves a vehicle flying."""
    told = zmav_here("param", "set", "quad1", "FS_GCS_ENABLE=0", "--fleet", "alpha", "-e", fleet.ground)
    assert told.code == 0, told
    found = fleet.red()
    assert list(found) == ["alpha/quad1 failsafe"]
    assert found["alpha/quad1 failsafe"]["found"].startswith("FS_GCS_ENABLE is 0: nothing happens")
    told = zmav_here("param", "set", "quad1", "FS_GCS_ENABLE=1", "--fleet", "alpha", "-e", fleet.ground)
    assert told.code == 0, told


def cut(fleet: Fleet) -> None:
    """The radio between two routers is gone, and then it is back."""

    async def until(state: str) -> None:
        async with fleet.open() as z:
            await linked(z, lambda q: q.state == state)

    fleet.relay.cut()
    asyncio.run(until("down"))
    found = fleet.red()
    assert found[WAY]["found"].startswith("down, ")
    assert "zmav mesh graph" in found[WAY]["advice"]
    assert found["vehicles"]["found"] == "not heard: quad2"
    fleet.relay.drop = [nothing, nothing]
    asyncio.run(until("up"))


def strangers(fleet: Fleet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A third vehicle of quad1's system id, whose clock is off and whose zmav is another; then it dies."""
    sim, endpoint = free_port(), f"tcp/127.0.0.1:{free_port()}"
    fleet.start("sim", "--copters", "1", "--seed", "3", "--endpoint", f"tcp:{sim}")
    up = fleet.start(
        "up",
        "--link",
        f"tcp:127.0.0.1:{sim}",
        "--name",
        "quad3",
        "--fleet",
        "alpha",
        "-l",
        endpoint,
        "-e",
        fleet.ground,
        "--cache",
        str(tmp_path / "cache3"),
        code=SHIFTED,
    )

    async def there(true: Callable[[zmav.VehicleState], bool]) -> None:
        async with fleet.open() as z:
            await fleet.until(z, "quad3", true)
            await fleet.until(z, "quad1", lambda s: s.clash is not None)
            await z.vehicle("quad3").params.list()

    asyncio.run(there(lambda s: s.sysid == 1 and s.uid is not None and s.clash is not None))
    found = fleet.red()
    assert "quad3" in found["system ids"]["found"]
    assert "all have 1" in found["system ids"]["found"]
    assert "MAV_SYSID" in found["system ids"]["advice"]
    assert "system id 1" in found["alpha/quad1 identity"]["found"]
    assert float(found["alpha/quad3 clock"]["found"].split()[0]) == pytest.approx(1e3 * OFF_S, abs=500.0)
    assert "chrony" in found["alpha/quad3 clock"]["advice"]
    assert f"{OTHER}: alpha/quad3" in found["versions zmav"]["found"]
    assert "install one version" in found["versions zmav"]["advice"]

    look = survey.look

    async def look_and_kill(z: Client, *arguments: Any) -> survey.Survey:
        """Heard by this very examination, and gone in the middle of it."""
        await fleet.until(z, "quad3", lambda s: True)
        up.popen.kill()
        await asyncio.to_thread(up.wait)
        return await look(z, *arguments)

    monkeypatch.setattr(doctor, "look", look_and_kill)
    found = fleet.red(seconds=2.5)
    assert found["alpha/quad3 presence"]["found"].startswith("no state for ")
    monkeypatch.undo()


def liars(fleet: Fleet) -> None:
    """Anyone who fills the key space with nonsense, wrong answers and names made to hurt, ends no examination."""
    evil = "zmav/alpha/quad9\x1b[2j/state"
    with open_session(SessionSettings(connect=[fleet.ground])) as session:
        said: list[Any] = []

        def nonsense(query: zenoh.Query) -> None:
            with query:
                query.reply(str(query.key_expr).replace("*", "liar"), b'{"version": 3, "sessions": [[]]}')

        for key in ("@/deadbeef/router", keys.HOST.key("alpha", "liar"), keys.LINK.key("alpha", "liar", link="*")):
            said.append(session.declare_queryable(key, nonsense))
        token = session.liveliness().declare_token(evil.replace("state", "alive/vehicle/1/px4/-/x"))
        over = threading.Event()

        def shout() -> None:
            state = wire.VehicleState(t=time.time(), fleet="alpha", name="x\x1b[2j", instance="\x07", connected=True)
            while not over.wait(0.05):
                session.put(evil, wire.encode(state))
                session.put(keys.LINK.key("alpha", "liar", link="autopilot"), b"[" * 5000)
                session.put(keys.AGENT_STATUS.key("alpha", "liar", agent="a"), json.dumps({"t": "\x1b[2j"}))

        thread = threading.Thread(target=shout)
        thread.start()
        told = zmav_here("doctor", "--fleet", "alpha", "--for", "1.2", "-e", fleet.ground)
        whole = zmav_here("doctor", "--fleet", "alpha", "--for", "1.2", "-e", fleet.ground, "--json")
        over.set()
        thread.join()
        token.undeclare()
    assert told.error is None
    assert told.code == 1
    assert "\x1b[2j" not in told.out
    assert "RED names: " in told.out
    assert "ready to arm" in whole.out, "the others are told of all the same"


def credentials(fleet: Fleet, tmp_path: Path) -> None:
    """Ours end soon, and the fleet runs without any."""
    authority = Authority.create(tmp_path / "ca", "alpha")
    authority.issue("quad1", Role.VEHICLE)
    folder = authority.issue("ops", Role.OPERATOR, days=10)
    found = fleet.red("--credentials", str(folder))
    assert "soon" in found["credentials"]["found"]
    assert "zmav mesh ca renew" in found["credentials"]["advice"]
    assert "shows no certificate" in found["alpha/quad1 certificate"]["found"]
    assert "no router tells" in found["roster"]["found"]


def test_a_full_disk(tmp_path: Path) -> None:
    """A small file system of its own is all but full."""
    if os.geteuid() != 0:
        pytest.skip("only root can mount a small file system")
    folder = tmp_path / "small"
    folder.mkdir()
    mount = Process("mount", "-t", "tmpfs", "-o", "size=16M", "tmpfs", str(folder))
    if mount.wait() != 0:
        pytest.skip(f"no file system can be mounted here: {mount.stderr}")
    try:
        told = zmav_here("doctor", "--disk", str(folder), "-e", "tcp/127.0.0.1:1", "--json")
    finally:
        assert Process("umount", str(folder)).wait() == 0
    (disk,) = [line for line in told.lines if line["topic"] == "disk" and str(folder) in line["found"]]
    assert disk["level"] == "red"
    assert disk["found"].startswith("16 MB free of 16 MB")
    assert "recordings" in disk["advice"]
