"""``zmav up`` as the process it is: it comes, waits, says what is wrong, and ends cleanly."""

from __future__ import annotations

import asyncio
import json
import re
import socket
import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import zenoh

import zmav
from zmav import keys
from zmav.sim import World

if TYPE_CHECKING:
    from tests.cli.conftest import Here, StartProcess
    from tests.conftest import Net

PATIENCE_S = 30.0


def port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as s:
        number: int = s.getsockname()[1]
        return number


def watch(endpoint: str, *wanted: Callable[[zmav.VehicleState], bool], fleet: str = "demo") -> list[zmav.VehicleState]:
    """States of quad1 as they are wanted, one after the other."""

    async def wait() -> list[zmav.VehicleState]:
        async with zmav.open(fleet=fleet, connect=[endpoint]) as z:
            return [await z.vehicle("quad1").wait_until(true, PATIENCE_S) for true in wanted]

    return asyncio.run(wait())


def test_sigterm_ends_it_cleanly_and_takes_its_token_along(start: StartProcess, net: Net) -> None:
    endpoint = f"tcp/127.0.0.1:{port()}"
    with World(copters=1, endpoint="tcp:0", ready_s=0.5) as world:
        up = start("up", "--link", world.urls[0], "-l", endpoint)
        up.expect(f"demo/quad1: {world.urls[0]} on {endpoint}")
        ground, _ = net.router(endpoint)
        came: list[tuple[str, zenoh.SampleKind]] = []
        heard = threading.Event()

        def on_token(sample: zenoh.Sample) -> None:
            came.append((str(sample.key_expr), sample.kind))
            heard.set()

        watch(endpoint, lambda s: s.connected and s.uid is not None)
        tokens = ground.liveliness().declare_subscriber("zmav/**", on_token, history=True)
        assert heard.wait(PATIENCE_S)
        up.expect("notice: ardupilot copter with system id 1")
        assert up.stop() == 0
        assert "Traceback" not in up.stderr
        assert list(ground.liveliness().get("zmav/**", timeout=1.0)) == []
        tokens.undeclare()
        keys_seen = {key for key, _ in came}
        assert len(keys_seen) == 1
        token = keys.match(keys_seen.pop())[1]
        assert (token["vehicle"], token["role"]) == ("quad1", "vehicle")
        assert (token["sys"], token["autopilot"]) == ("1", "ardupilot")
        assert came[-1][1] == zenoh.SampleKind.DELETE


def test_each_line_of_its_log_has_a_time(start: StartProcess) -> None:
    up = start("up", "--link", "tcp:127.0.0.1:1", "-l", f"tcp/127.0.0.1:{port()}")
    up.expect("demo/quad1: ")
    up.expect("warning: link down: ")
    assert up.stop() == 0
    assert all(re.match(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d{3} \S", line) for line in up.err), up.err


@pytest.mark.parametrize(("verb", "mode"), [("up", "client"), ("up", "peer"), ("router", "client")])
def test_it_is_a_router_and_nothing_else(here: type[Here], verb: str, mode: str) -> None:
    arguments = ("--link", "tcp:127.0.0.1:1") if verb == "up" else ()
    error = here().fails(verb, *arguments, "-m", mode).error
    assert f"-m {mode}: what is opened here is a router" in str(error)


def test_an_autopilot_may_come_late_go_and_come_again(start: StartProcess) -> None:
    endpoint, sim = f"tcp/127.0.0.1:{port()}", port()
    up = start("up", "--link", f"tcp:127.0.0.1:{sim}", "-l", endpoint)
    up.expect("demo/quad1: ")
    (early,) = watch(endpoint, lambda s: True)
    assert (early.connected, early.sysid, early.position, early.ready) == (False, None, None, None)
    up.expect("link down: ")
    with World(copters=1, endpoint=f"tcp:{sim}", ready_s=0.5):
        (there,) = watch(endpoint, lambda s: s.connected and s.position is not None)
        assert (there.sysid, there.autopilot, there.link) == (1, "ardupilot", "up")
    (gone,) = watch(endpoint, lambda s: not s.connected)
    assert (gone.sysid, gone.link) == (1, "down")
    up.expect("critical: autopilot silent")
    with World(copters=1, endpoint=f"tcp:{sim}", ready_s=0.5):
        watch(endpoint, lambda s: s.connected)
        up.expect("notice: autopilot 1 is heard again")
    assert up.stop() == 0


def test_a_listening_port_in_use(start: StartProcess) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        up = start("up", "--link", "tcp:127.0.0.1:1", "-l", endpoint)
        assert up.wait() == 1
        assert f"{endpoint} is in use by another program: choose another with -l" in up.stderr
        assert "Traceback" not in up.stderr


def test_a_link_port_in_use_is_said_and_waited_for(start: StartProcess) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        number = taken.getsockname()[1]
        endpoint = f"tcp/127.0.0.1:{port()}"
        up = start("up", "--link", f"udpin:127.0.0.1:{number}", "-l", endpoint)
        assert f"{number}" in up.expect("warning: link down: ")
        watch(endpoint, lambda s: s.link == "down")
    watch(endpoint, lambda s: s.link == "connecting")
    assert up.stop() == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--link", "carrier-pigeon:coop"], "udpin:HOST:PORT"),
        (["--link", "tcp:127.0.0.1"], "tcp:127.0.0.1"),
        (["--link", "replay:/no/such.tlog"], "/no/such.tlog"),
        (["--link", "tcp:127.0.0.1:1", "--name", "Quad One"], "name 'Quad One' cannot stand in a key"),
        (["--link", "tcp:127.0.0.1:1", "--fleet", "a/b"], "fleet 'a/b' cannot stand in a key"),
        (["--link", "tcp:127.0.0.1:1", "--dialect", "klingon"], "klingon"),
        (["--link", "tcp:127.0.0.1:1", "--origin", "95", "0", "0"], "the origin's lat_deg is 95.0"),
        ([], "give --link, or --file"),
        (["--file", "/no/fleet.toml"], "cannot read the fleet file /no/fleet.toml"),
    ],
    ids=lambda value: value[-1][:12] if isinstance(value, list) and value else None,
)
def test_what_cannot_be_is_said_and_ends_it(here: type[Here], arguments: list[str], words: str) -> None:
    told = here().fails("up", "-l", "tcp/127.0.0.1:0", *arguments)
    assert words in str(told.error)


def test_an_error_goes_to_stderr_and_ends_with_1(start: StartProcess) -> None:
    up = start("up", "-l", "tcp/127.0.0.1:0", "--link", "carrier-pigeon:coop")
    assert up.wait() == 1
    assert up.stdout == ""
    assert up.stderr.startswith("zmav: ")
    assert "udpin:HOST:PORT" in up.stderr
    assert "Traceback" not in up.stderr


FLEET = """
fleet = "alpha"
[origin]
lat_deg = -35.363261
lon_deg = 149.165230
alt_amsl = 584.09
[vehicles.quad1]
link = "LINK"
listen = ["LISTEN"]
"""


def test_a_fleet_file_names_link_listeners_fleet_and_origin(start: StartProcess, tmp_path: Path) -> None:
    endpoint, file = f"tcp/127.0.0.1:{port()}", tmp_path / "fleet.toml"
    with World(copters=1, endpoint="tcp:0", ready_s=0.5) as world:
        file.write_text(FLEET.replace("LINK", world.urls[0]).replace("LISTEN", endpoint))
        up = start("up", "--file", str(file))
        up.expect(f"alpha/quad1: {world.urls[0]} on {endpoint}")
        (state,) = watch(endpoint, lambda s: s.local is not None, fleet="alpha")
        assert state.fleet == "alpha"
        assert state.local == pytest.approx((0.0, 0.0, 0.0), abs=1.0)
        assert up.stop() == 0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (FLEET.replace("listen =", "listens ="), "unknown field `listens`"),
        (FLEET.replace("quad1", "quad2"), "no host 'quad1' in the fleet file; it has quad2"),
        ("fleet: alpha", "is not TOML"),
    ],
    ids=["field", "vehicle", "toml"],
)
def test_a_bad_fleet_file_is_said(here: type[Here], tmp_path: Path, text: str, words: str) -> None:
    file = tmp_path / "fleet.toml"
    file.write_text(text)
    assert words in str(here().fails("up", "--file", str(file)).error)


def test_a_zenoh_configuration_file_says_where_it_listens(start: StartProcess, tmp_path: Path) -> None:
    endpoint, file = f"tcp/127.0.0.1:{port()}", tmp_path / "zenoh.json5"
    file.write_text(json.dumps({"listen": {"endpoints": [endpoint]}}))
    up = start("up", "--link", "tcp:127.0.0.1:1", "-c", str(file))
    up.expect("demo/quad1: ")
    assert watch(endpoint, lambda s: True)[0].name == "quad1"
    assert up.stop() == 0
