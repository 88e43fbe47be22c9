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

from zmav import keys
from zmav.cli.common import listening
from zmav.session import SessionSettings, open_session

PATIENCE_S = 30.0
Router = subprocess.Popen[str]


def free_endpoint() -> str:
    with socket.create_server(("127.0.0.1", 0)) as s:
        return f"tcp/127.0.0.1:{s.getsockname()[1]}"


@pytest.fixture
def start() -> Iterator[Callable[..., Router]]:
    started: list[Router] = []

    def start(*arguments: str) -> Router:
        command = [sys.executable, "-m", "zmav", "router", *arguments]
        started.append(subprocess.Popen(command, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True))
        return started[-1]

    yield start
    for router in started:
        if router.poll() is None:
            router.kill()
        router.wait()
        assert router.stderr is not None
        router.stderr.close()


def first_words(router: Router) -> str:
    assert router.stderr is not None
    return router.stderr.readline()


def test_it_says_who_and_where_it_is_and_sigterm_ends_it(start: Callable[..., Router]) -> None:
    endpoint = free_endpoint()
    router = start("-l", endpoint)
    said = re.fullmatch(rf"router ([0-9a-f]+) on {re.escape(endpoint)}\n", first_words(router))
    assert said is not None
    with open_session(SessionSettings(connect=[endpoint])) as session:
        assert [str(zid) for zid in session.info.routers_zid()] == [said[1]]
        (reply,) = session.get("@/*/router")
        assert reply.ok is not None
        assert json.loads(reply.ok.payload.to_bytes())["locators"] == [endpoint]
    router.send_signal(signal.SIGTERM)
    assert router.wait(PATIENCE_S) == 0
    assert router.communicate()[1] == ""


def test_it_relays_between_its_clients_and_the_routers_it_is_linked_to(start: Callable[..., Router]) -> None:
    """client - router process - router process - client, and back."""
    far, near = free_endpoint(), free_endpoint()
    first_words(start("-l", far))
    first_words(start("-l", near, "-e", far))
    with open_session(SessionSettings(connect=[near])) as one, open_session(SessionSettings(connect=[far])) as other:
        for here, there in ((one, other), (other, one)):
            came: list[bytes] = []
            arrived = threading.Event()

            def on_sample(sample: zenoh.Sample, came: list[bytes] = came, arrived: threading.Event = arrived) -> None:
                came.append(sample.payload.to_bytes())
                arrived.set()

            subscriber = there.declare_subscriber("zmav/demo/quad1/state", on_sample)
            reached(here, "zmav/demo/quad1/state")
            here.put("zmav/demo/quad1/state", b"words")
            assert arrived.wait(PATIENCE_S)
            subscriber.undeclare()
            assert came == [b"words"]


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


def test_a_neighbour_that_is_not_there_yet_is_waited_for(start: Callable[..., Router]) -> None:
    far, near = free_endpoint(), free_endpoint()
    assert first_words(start("-l", near, "-e", far)).startswith("router ")
    other = first_words(start("-l", far)).split()[1]
    with open_session(SessionSettings(connect=[near])) as session:
        end, seen = time.monotonic() + PATIENCE_S, set[str]()
        while other not in seen:
            assert time.monotonic() < end, f"only {seen} answer"
            replies = session.get("@/*/router", timeout=0.3)
            seen = {str(reply.ok.key_expr).split("/")[1] for reply in replies if reply.ok is not None}


def test_it_keeps_to_loopback_unless_told_otherwise() -> None:
    assert listening(SessionSettings()).listen == ("tcp/127.0.0.1:7447",)
    assert listening(SessionSettings(), ["udp/10.0.0.1:7447"]).listen == ["udp/10.0.0.1:7447"]
    assert listening(SessionSettings(listen=["tcp/0.0.0.0:1"]), ["udp/10.0.0.1:7447"]).listen == ["tcp/0.0.0.0:1"]
    assert listening(SessionSettings(file="zenoh.json5")).listen == ()
    assert {listening(SessionSettings(mode=mode)).mode for mode in (None, "client", "peer")} == {"router"}


@pytest.mark.parametrize("taken", [True, False], ids=["in use", "no endpoint"])
def test_what_cannot_be_is_said(start: Callable[..., Router], taken: bool) -> None:
    with socket.create_server(("127.0.0.1", 0)) as held:
        endpoint = f"tcp/127.0.0.1:{held.getsockname()[1]}" if taken else "loopback"
        router = start("-l", endpoint)
        assert router.wait(PATIENCE_S) == 1
    said = router.communicate()[1]
    assert said.startswith("zmav: ")
    assert ("is in use by another program" if taken else "<protocol>/<address>") in said
    assert "Traceback" not in said


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


def free_datagram_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        number: int = s.getsockname()[1]
        return number


@pytest.fixture
def fleet(tmp_path: Path) -> tuple[Path, str]:
    """A fleet file of three routers on this computer, and where programs reach the first."""
    local, file = free_endpoint(), tmp_path / "fleet.toml"
    text = FLEET.replace("PROFILE", "wds").replace("LOCAL", local)
    file.write_text(text.replace("PORT_A", f"{free_datagram_port()}").replace("PORT_B", f"{free_datagram_port()}"))
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
    start: Callable[..., Router], fleet: tuple[Path, str]
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
    for router in (one, other):
        router.send_signal(signal.SIGTERM)
    for router in (one, other):
        assert router.wait(PATIENCE_S) == 0
        assert router.communicate()[1] == ""


def test_without_a_fleet_file_it_says_its_name(start: Callable[..., Router]) -> None:
    endpoint = free_endpoint()
    first_words(start("-l", endpoint, "--fleet", "alpha", "--name", "relay7"))
    with open_session(SessionSettings(connect=[endpoint])) as session:
        assert names(session) == {"relay7"}


@pytest.mark.parametrize("away", ["-e udp/192.0.2.1:7447?rel=1", "-l tcp/0.0.0.0:0"])
def test_it_goes_beyond_loopback_only_when_it_is_told_to(start: Callable[..., Router], away: str) -> None:
    refused = start("-l", free_endpoint(), *away.split())
    assert refused.wait(PATIENCE_S) == 1
    assert "would let others in unguarded" in refused.communicate()[1]
    allowed = start("-l", free_endpoint(), *away.split(), "--insecure")
    assert first_words(allowed).startswith("router ")


def test_a_radio_is_waited_for_and_a_port_in_use_is_still_said(start: Callable[..., Router], tmp_path: Path) -> None:
    file = tmp_path / "fleet.toml"
    with socket.create_server(("127.0.0.1", 0)) as held:
        taken = f"tcp/127.0.0.1:{held.getsockname()[1]}"
        file.write_text(ABSENT.replace("LOCAL", taken))
        router = start("--file", str(file), "--name", "a")
        assert router.wait(PATIENCE_S) == 1
        assert f"{taken} is in use by another program" in router.communicate()[1]
    router = start("--file", str(file), "--name", "a")
    assert first_words(router).startswith("router ")
    assert first_words(router) == "nosuch0 is not there or has no address yet: waiting for it\n"
    assert first_words(router) == "nosuch1 has not the address 192.0.2.9 yet: waiting for it\n"
    router.send_signal(signal.SIGTERM)
    assert router.wait(PATIENCE_S) == 0


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
