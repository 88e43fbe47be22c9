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
from mesh.lab.network import LabError, Network, check_able
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
import sys, threading, zenoh
from zmav.session import SessionSettings, open_session
name, endpoint, folder = sys.argv[1:]
with open_session(SessionSettings(connect=[endpoint], credentials=folder)) as session:
    known = threading.Event()
    publisher = session.declare_publisher(f"zmav/alpha/{name}/link/x")
    listener = publisher.declare_matching_listener(lambda status: known.set() if status.matching else None)
    assert publisher.matching_status.matching or known.wait(20.0)
    for key in ("quad1/setpoint/x", "quad1/mav/tx/1/1/HEARTBEAT", "quad1/state", "*/state"):
        session.put(f"zmav/alpha/{key}", b"", congestion_control=zenoh.CongestionControl.BLOCK)
    session.put(f"zmav/alpha/{name}/link/x", b"end", congestion_control=zenoh.CongestionControl.BLOCK)
    session.get("zmav/alpha/quad1/msg/END", timeout=0.1)
"""


@pytest.fixture
def network() -> Iterator[Network]:
    try:
        check_able()
    except LabError as e:
        pytest.skip(str(e))
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
        assert log.readline().startswith("router ")
        home = start("a", [sys.executable, "-c", HOME]).stdout
        assert home is not None
        assert json.loads(home.readline()) == []
        orders = {"zmav/alpha/quad1/setpoint/x", "zmav/alpha/quad1/mav/tx/1/1/HEARTBEAT"}
        for host, name, endpoint, through in (
            ("b", "view", quic, set()),
            ("b", "ops", tls, orders),
            ("a", "view", tls, set()),  # on the router's own host, and yet no program of it
            ("a", "view", "quic/127.0.0.1:7500?mixed_rel=1", set()),
        ):
            said = start(host, [sys.executable, "-c", SAY, name, endpoint, str(members / name)])
            assert set(json.loads(home.readline())) - {f"zmav/alpha/{name}/link/x"} == through
            assert said.wait(20.0) == 0
