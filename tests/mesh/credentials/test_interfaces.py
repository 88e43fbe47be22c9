"""The door over real interfaces: hosts in namespaces of their own, a link between them, and programs on both sides."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from mesh.credentials.ca import Authority
from mesh.lab.network import Network
from mesh.lab.scenario import Scenario, check
from zmav.trust.certificate import Role

pytestmark = pytest.mark.root

HOME = """
import json, sys, threading
from zmav.session import SessionSettings, open_session
from zenoh.handlers import Callback
with open_session(SessionSettings(connect=["tcp/127.0.0.1:7447"])) as session:
    heard, ended = [], threading.Event()
    def on_sample(sample):
        heard.append(str(sample.key_expr))
        if sample.payload.to_bytes() == b"end":
            print(json.dumps(heard), flush=True)
            heard.clear()
    session.declare_subscriber("zmav/**", Callback(on_sample, indirect=False))
    print("[]", flush=True)
    sys.stdin.read()
"""
SAY = """
import json, sys, threading, zenoh
from zmav.session import SessionSettings, open_session
def say(name, endpoint, folder):
    with open_session(SessionSettings(connect=[endpoint], credentials=folder)) as session:
        known = threading.Event()
        publisher = session.declare_publisher(f"zmav/alpha/{name}/camera/x/report/x")
        listener = publisher.declare_matching_listener(lambda status: known.set() if status.matching else None)
        assert publisher.matching_status.matching or known.wait(60.0)
        for key in ("quad1/setpoint/x", "quad1/mav/tx/1/1/HEARTBEAT", "quad1/state", "*/state"):
            session.put(f"zmav/alpha/{key}", b"", congestion_control=zenoh.CongestionControl.BLOCK)
        session.put(f"zmav/alpha/{name}/camera/x/report/x", b"end", congestion_control=zenoh.CongestionControl.BLOCK)
        sys.stdin.readline()
for each in sys.argv[1:]:
    say(*json.loads(each))
"""


@pytest.fixture
def network() -> Iterator[Network]:
    tables = {"hosts": {"a": {}, "b": {}}, "media": [{"kind": "link", "between": ["a", "b"]}]}
    with Network(check(msgspec.convert(tables, Scenario))) as network:
        yield network


def test_only_plain_loopback_is_this_hosts_own(network: Network, tmp_path: Path) -> None:
    authority = Authority.create(tmp_path / "ca", "alpha")
    for name, role in (("quad1", Role.VEHICLE), ("view", Role.VIEWER), ("ops", Role.OPERATOR)):
        authority.issue(name, role)
    authority.refresh()
    members, address = authority.folder / "members", network.address("a")
    quic, tls = f"quic/{address}:7447?mixed_rel=1", f"tls/{address}:7447"
    python: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    listen = [f"-l{endpoint}" for endpoint in ("tcp/127.0.0.1:7447", quic, tls, "quic/127.0.0.1:7500?mixed_rel=1")]
    router = [
        sys.executable,
        "-m",
        "zmav",
        "router",
        "--name",
        "quad1",
        "--credentials",
        str(members / "quad1"),
        *listen,
    ]
    with contextlib.ExitStack() as stack:

        def start(host: str, command: list[str], **options: Any) -> subprocess.Popen[str]:
            process = stack.enter_context(network.popen(host, command, **python, **options))
            stack.callback(process.kill)
            return process

        log = start("a", router, stderr=subprocess.STDOUT).stdout
        assert log is not None
        assert " router " in log.readline()
        home = start("a", [sys.executable, "-c", HOME]).stdout
        assert home is not None
        assert json.loads(home.readline()) == []
        orders = {"zmav/alpha/quad1/setpoint/x", "zmav/alpha/quad1/mav/tx/1/1/HEARTBEAT"}
        # On the router's own host, and yet no programs of it: the last two.
        for host, says in (
            ("b", [("view", quic, set()), ("ops", tls, orders)]),
            ("a", [("view", tls, set()), ("view", "quic/127.0.0.1:7500?mixed_rel=1", set())]),
        ):
            words = [json.dumps((name, endpoint, str(members / name))) for name, endpoint, _ in says]
            saying = start(host, [sys.executable, "-c", SAY, *words])
            assert saying.stdin is not None
            for name, _, through in says:
                assert set(json.loads(home.readline())) - {f"zmav/alpha/{name}/camera/x/report/x"} == through
                saying.stdin.write("\n")
                saying.stdin.flush()
            assert saying.wait(60.0) == 0
