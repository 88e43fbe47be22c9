"""``zmav router``: a relay and nothing else."""

from __future__ import annotations

import json
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh
from click.testing import CliRunner

from mesh.cli.options import plan_host
from mesh.cli.router import router
from tests.ports import free_udp_ports
from zmav import keys
from zmav.errors import ZmavError
from zmav.session import SessionSettings, open_session

PATIENCE_S = 30.0
Process = subprocess.Popen[str]


def free_endpoint() -> str:
    with socket.create_server(("127.0.0.1", 0)) as s:
        return f"tcp/127.0.0.1:{s.getsockname()[1]}"


@pytest.fixture
def start() -> Iterator[Callable[..., Process]]:
    started: list[Process] = []

    def start(*arguments: str) -> Process:
        command = [sys.executable, "-m", "zmav", "router", *arguments]
        started.append(subprocess.Popen(command, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True))
        return started[-1]

    yield start
    for process in started:
        if process.poll() is None:
            process.kill()
        process.wait()
        assert process.stderr is not None
        process.stderr.close()


def first_words(process: Process) -> str:
    """A line without its time."""
    assert process.stderr is not None
    return process.stderr.readline().split(" ", 2)[2]


def invoked(*arguments: str) -> str:
    """What a router that cannot be says, in this process."""
    result = CliRunner().invoke(router, list(arguments))
    assert isinstance(result.exception, ZmavError), result.output
    return str(result.exception)


def test_it_says_who_and_where_it_is_and_sigterm_ends_it(start: Callable[..., Process]) -> None:
    endpoint = free_endpoint()
    process = start("-l", endpoint, "--fleet", "alpha", "--name", "relay7")
    said = re.fullmatch(rf"router ([0-9a-f]+) on {re.escape(endpoint)}\n", first_words(process))
    assert said is not None
    with open_session(SessionSettings(connect=[endpoint])) as session:
        assert [str(zid) for zid in session.info.routers_zid()] == [said[1]]
        (reply,) = session.get("@/*/router")
        assert reply.ok is not None
        assert json.loads(reply.ok.payload.to_bytes())["locators"] == [endpoint]
        assert names(session) == {"relay7"}
    process.send_signal(signal.SIGTERM)
    assert process.wait(PATIENCE_S) == 0
    assert process.communicate()[1] == ""


def test_it_relays_for_its_clients_to_a_router_that_comes_later(start: Callable[..., Process]) -> None:
    """client - router process - router process - client, and back; the second is not there when the first calls it."""
    far, near = free_endpoint(), free_endpoint()
    assert first_words(start("-l", near, "-e", far)).startswith("router ")
    first_words(start("-l", far))
    with open_session(SessionSettings(connect=[near])) as one, open_session(SessionSettings(connect=[far])) as other:
        for here, there in ((one, other), (other, one)):
            came: list[bytes] = []
            arrived = threading.Event()

            def on_sample(sample: zenoh.Sample, came: list[bytes] = came, arrived: threading.Event = arrived) -> None:
                came.append(sample.payload.to_bytes())
                arrived.set()

            subscriber = there.declare_subscriber("zmav/demo/quad1/state", on_sample)
            reached(here, "zmav/demo/quad1/state")
            put, end = [b"0"], time.monotonic() + PATIENCE_S
            here.put("zmav/demo/quad1/state", put[0])
            while not arrived.wait(0.5):  # what is put while the routers change their ways is lost
                assert time.monotonic() < end
                put.append(b"%d" % len(put))
                here.put("zmav/demo/quad1/state", put[-1])
            subscriber.undeclare()
            assert len(set(came)) == len(came) and set(came) <= set(put)


def reached(session: zenoh.Session, key: str) -> None:
    """Wait until a subscriber of the key is known."""
    known = threading.Event()

    def on_match(status: Any) -> None:
        if status.matching:
            known.set()

    publisher = session.declare_publisher(key)
    listener = publisher.declare_matching_listener(on_match)
    status: Any = publisher.matching_status
    assert status.matching or known.wait(PATIENCE_S)
    listener.undeclare()
    publisher.undeclare()


def test_what_cannot_be_is_said() -> None:
    with socket.create_server(("127.0.0.1", 0)) as held:
        assert "is in use by another program" in invoked("-l", f"tcp/127.0.0.1:{held.getsockname()[1]}")
    assert "<protocol>/<address>" in invoked("-l", "loopback")


FLEET = """
fleet = "alpha"
[mesh]
profile = "PROFILE"
insecure = true
[stations.a]
listen = ["LOCAL"]
[[stations.a.mesh.radios]]
address = "127.0.0.1"
port = PORT_A
[stations.b]
listen = ["tcp/127.0.0.1:0"]
[[stations.b.mesh.radios]]
address = "127.0.0.1"
port = PORT_B
[stations.absent.mesh]
[[stations.absent.mesh.radios]]
address = "127.0.0.9"
"""


@pytest.fixture
def fleet(tmp_path: Path) -> tuple[Path, str]:
    """A fleet file of three routers on this computer, and where programs reach the first."""
    local, file = free_endpoint(), tmp_path / "fleet.toml"
    text = FLEET.replace("PROFILE", "wds").replace("LOCAL", local)
    file.write_text(text.replace("PORT_A", f"{free_udp_ports(1)}").replace("PORT_B", f"{free_udp_ports(1)}"))
    return file, local


def names(session: zenoh.Session) -> set[str]:
    """The routers whose tokens are seen; each holds the Zenoh id of its router."""
    everyone = keys.ALIVE.key("alpha", "*", role="router", sys="*", autopilot="*", uid="*", instance="*")
    found = set()
    for reply in session.liveliness().get(everyone, timeout=1.0):
        assert reply.ok is not None
        found.add(keys.match(str(reply.ok.key_expr))[1]["vehicle"])
    return found


def test_a_fleet_file_says_where_it_listens_and_whom_it_calls(
    start: Callable[..., Process], fleet: tuple[Path, str]
) -> None:
    """One of three hosts is not there: the others are linked all the same, and end when they are told to."""
    file, local = fleet
    one = start("--file", str(file), "--name", "a")
    zid = first_words(one).split()[1]
    other = start("--file", str(file), "--name", "b")
    first_words(other)
    with open_session(SessionSettings(connect=[local])) as session:
        assert [str(each) for each in session.info.routers_zid()] == [zid]
        end = time.monotonic() + PATIENCE_S
        while names(session) != {"a", "b"}:
            assert time.monotonic() < end, names(session)
    for process in (one, other):
        process.send_signal(signal.SIGTERM)
    for process in (one, other):
        assert process.wait(PATIENCE_S) == 0
        assert process.communicate()[1] == ""


@pytest.mark.parametrize("away", ["-e udp/192.0.2.1:7447?rel=1", "-l tcp/0.0.0.0:0"])
def test_it_goes_beyond_loopback_only_when_it_is_told_to(away: str) -> None:
    option, endpoint = away.split()
    assert f"{endpoint} would let others in unguarded" in invoked(option, endpoint)
    settings = SessionSettings(connect=[endpoint]) if option == "-e" else SessionSettings(listen=[endpoint])
    plan = plan_host(None, "relay7", settings, insecure=True)
    assert endpoint in (*plan.listens, *plan.value("connect/endpoints"))


def test_a_radio_is_waited_for_and_a_port_in_use_is_still_said(start: Callable[..., Process], tmp_path: Path) -> None:
    file = tmp_path / "fleet.toml"
    with socket.create_server(("127.0.0.1", 0)) as held:
        taken = f"tcp/127.0.0.1:{held.getsockname()[1]}"
        file.write_text(ABSENT.replace("LOCAL", taken))
        assert f"{taken} is in use by another program" in invoked("--file", str(file), "--name", "a")
    process = start("--file", str(file), "--name", "a")
    assert first_words(process).startswith("router ")
    assert first_words(process) == "nosuch0 is not there or has no address yet: waiting for it\n"
    assert first_words(process) == "nosuch1 has not the address 192.0.2.9 yet: waiting for it\n"
    process.send_signal(signal.SIGTERM)
    assert process.wait(PATIENCE_S) == 0


ABSENT = """
[mesh]
insecure = true
[stations.a]
listen = ["LOCAL"]
[[stations.a.mesh.radios]]
interface = "nosuch0"
[[stations.a.mesh.radios]]
interface = "nosuch1"
address = "192.0.2.9"
"""
