"""The authority's verbs and a router's process: what is revoked while it runs is out a moment later."""

from __future__ import annotations

import socket
import subprocess
import sys
from typing import TYPE_CHECKING, Any

from click.testing import CliRunner

from mesh.cli.ca import command
from zmav.process import free_port
from zmav.trust.certificate import Role
from zmav.trust.credentials import Credentials

if TYPE_CHECKING:
    from tests.mesh.credentials.conftest import Fleet

PATIENCE_S = 30.0


def ca(*arguments: str) -> str:
    result = CliRunner().invoke(command, arguments, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


def test_a_router_acts_on_a_roster_that_is_published(fleet: Fleet) -> None:
    fleet.issue(quad1=Role.VEHICLE, ops=Role.OPERATOR, view=Role.VIEWER)
    fleet.authority.refresh()
    tcp, quic = f"tcp/127.0.0.1:{free_port()}", f"quic/127.0.0.1:{free_port(socket.SOCK_DGRAM)}?mixed_rel=1"
    folders = {name: str(folder) for name, folder in fleet.members.items()}
    started = [sys.executable, "-m", "zmav", "router", "-l", tcp, "-l", quic, "--credentials", folders["quad1"]]
    pipes: dict[str, Any] = {"stdin": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(started, **pipes) as router:
        try:
            assert router.stderr is not None
            assert " router " in router.stderr.readline()
            assert list(fleet.open("view", quic).get("@/*/router", timeout=10.0))
            folder = ("--ca", str(fleet.authority.folder))
            ca("revoke", "view", *folder)
            via = ("-e", quic, "--credentials", folders["ops"])
            assert "quad1 has number 4" in ca("roster", "--publish", *folder, *via)
            said = [router.stderr.readline().split(" ", 2)[2] for _ in range(4)]  # without their times
            assert said[0] == "roster 4: 2 members, 1 revoked\n"
            assert said[1].startswith("starting again: ")
            turned_out, up = sorted(
                said[2:], key=lambda line: line.startswith("router ")
            )  # its old session calls at once
            assert up.startswith("router ")
            assert turned_out == "view has a certificate, but is not on the roster: nothing but rosters passes\n"
            assert list(fleet.open("ops", quic).get("@/*/router", timeout=10.0))
            assert list(fleet.open("view", quic).get("@/*/router", timeout=1.0)) == []
            (fleet.members["ops"] / "roster.json").write_bytes(fleet.first_roster)
            topic, lie = "zmav/alpha/@fleet/roster", b'{"name": "quad1", "number": 1000000, "t": 0}'
            fleet.open("ops", quic).declare_queryable(topic, lambda query: query.reply(topic, lie))
            assert "number 4, in the place of 0" in ca("roster", "--fetch", *via)
            assert Credentials.load(folders["ops"]).roster.number == 4
        finally:
            router.terminate()
            assert router.wait(PATIENCE_S) == 0
        assert router.stderr.read() == ""
