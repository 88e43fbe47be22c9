"""``zmav lab`` as a person types it, in one lab for all of these."""

from __future__ import annotations

import os
import shutil
import socket
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from mesh.cli.lab import lab as lab_command
from mesh.lab.remote import Remote, claimed, directory_of_labs
from mesh.lab.status import LabStatus
from zmav.errors import BadConfig, BadInput, LinkDown, ZmavError

pytestmark = pytest.mark.root

PATIENCE_S = 60.0
FILE = """
name = "pair"
[hosts.box1]
program = "none"
[hosts.box2]
[[media]]
kind = "radio"
name = "air"
delay = "1 ms"
"""
Environment = dict[str, str]


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Environment]:
    """A lab that runs; what programs that are to find it have set."""
    folder = tmp_path_factory.mktemp("labs")
    environment = {**os.environ, "XDG_RUNTIME_DIR": str(folder)}
    (folder / "pair.toml").write_text(FILE)
    command = [sys.executable, "-m", "zmav", "lab", "up", str(folder / "pair.toml")]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment)
    assert process.stdout is not None
    try:
        said = [process.stdout.readline(), process.stdout.readline()]
        assert said[0] == f"lab pair: 2 hosts, 1 links; files in {folder}/zmav-lab/pair\n"
        assert said[1].startswith("up in"), said
        yield environment
        assert zmav(environment, "lab", "down").returncode == 0
        assert not (folder / "zmav-lab" / "pair").exists()  # 'down' returns when all is gone
        assert process.wait(PATIENCE_S) == 0
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def zmav(environment: Environment, *arguments: str, **options: Any) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "zmav", *arguments]
    return subprocess.run(command, env=environment, text=True, capture_output=True, timeout=PATIENCE_S, **options)


@pytest.mark.skipif(shutil.which("setpriv") is None, reason="needs setpriv, to be a container's root")
@pytest.mark.parametrize("right", ["net_admin", "sys_admin"])
def test_a_root_without_the_rights_is_told_which(tmp_path: Path, right: str) -> None:
    (tmp_path / "pair.toml").write_text(FILE)
    less = ["setpriv", f"--bounding-set=-{right}", f"--inh-caps=-{right}"]
    command = [*less, sys.executable, "-m", "zmav", "lab", "up", str(tmp_path / "pair.toml")]
    environment = {**os.environ, "XDG_RUNTIME_DIR": str(tmp_path)}
    done = subprocess.run(command, env=environment, text=True, capture_output=True, check=False, timeout=PATIENCE_S)
    assert done.returncode == 1
    assert f"root lacks CAP_{right.upper()} here: " in done.stderr
    assert "Traceback" not in done.stderr


@pytest.fixture
def remote(lab: Environment, monkeypatch: pytest.MonkeyPatch) -> Iterator[Remote]:
    monkeypatch.setenv("XDG_RUNTIME_DIR", lab["XDG_RUNTIME_DIR"])
    with Remote() as remote:
        yield remote


def here(*arguments: str) -> None:
    """``zmav lab`` in this process; errors are raised."""
    lab_command.main(list(arguments), standalone_mode=False)


def test_what_runs_is_shown(remote: Remote, capsys: pytest.CaptureFixture[str]) -> None:
    here("status")
    assert "box1>box2" in capsys.readouterr().out
    here("status", "--json")
    found = msgspec.json.decode(capsys.readouterr().out, type=LabStatus)
    assert [(host.name, host.running) for host in found.hosts] == [
        ("box1", None),
        ("box2", True),
    ]
    assert [(link.name, link.medium) for link in found.links] == [("box1-box2", "air")]
    assert remote.directory.stat().st_mode & 0o077 == 0
    assert stat.S_IMODE((remote.directory / "control.sock").stat().st_mode) == 0o600


def test_links_are_cut_healed_and_changed(remote: Remote) -> None:
    here("cut", "1-2")
    (link,) = remote.status().links
    assert [way.conditions.up for way in link.ways] == [False, False]
    remote.call("heal", link="1>2")
    assert [way.conditions.up for way in remote.status().links[0].ways] == [True, False]
    remote.call("heal", link="all")
    here("set", "2>1", "loss=20%", "delay=0.1", "rate=1M", "ordered=false")
    there, back = (way.conditions for way in remote.status().links[0].ways)
    assert (there.loss, there.delay, there.rate) == (0.0, 0.001, None)
    assert (back.loss, back.delay, back.rate, back.ordered) == (0.2, 0.1, 1e6, False)
    remote.call("set", link="1-2", conditions={"loss": 0, "delay": 0, "rate": 0})


def test_a_program_in_a_host_is_as_one_here(lab: Environment) -> None:
    script = "read line; echo got $line from $ZMAV_FLEET; cat /proc/net/dev >&2; kill -TERM $$"
    done = zmav(lab, "lab", "exec", "box1", "sh", "-c", script, input="words\n")
    assert done.returncode == 143
    assert done.stdout == "got words from pair\n"
    assert "wlan0" in done.stderr
    # The zmav beside this Python is found, and finds the host's own router.
    done = zmav(lab, "lab", "exec", "box2", "sh", "-c", "zmav ls; exit 7")
    assert done.returncode == 7
    assert "no vehicle in fleet 'pair'" in done.stderr + done.stdout
    done = zmav(lab, "lab", "exec", "box1", "no-such-program")
    assert done.returncode == 1
    assert done.stderr.startswith("zmav: cannot run 'no-such-program'")


def test_routers_die_and_come_back(remote: Remote) -> None:
    for verb in ("kill", "stop"):
        here(verb, "box2")
        assert remote.status().hosts[1].running is False
        remote.call("start", host="box2")
        assert remote.status().hosts[1].running is True
    with pytest.raises(Exception, match="box2 runs already"):
        remote.call("start", host="box2")
    with pytest.raises(BadConfig, match="nothing runs as 'box1'; there are box2"):
        remote.call("kill", host="box1")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("cut", "1-9"), "no link '1-9'; expected one of box1-box2"),
        (("set", "1-2", "los=1"), "no condition 'los'; there are up, delay, jitter"),
        (("set", "1-2", "loss"), "'loss' is not NAME=VALUE"),
        (("set", "1-2", "loss=much"), "loss is 'much'; expected a share"),
        (("exec", "box3", "true"), "no host 'box3' in the lab; it has box1, box2"),
        (("up", "/nowhere.toml"), "cannot read the lab's file /nowhere.toml"),
    ],
)
def test_what_cannot_be_is_said(remote: Remote, arguments: tuple[str, ...], words: str) -> None:
    with pytest.raises(ZmavError) as caught:
        here(*arguments)
    assert words in str(caught.value)


def test_two_labs_of_one_name_are_refused(lab: Environment, remote: Remote) -> None:
    file = Path(lab["XDG_RUNTIME_DIR"]) / "pair.toml"
    with pytest.raises(BadConfig, match="a lab 'pair' runs already"):
        here("up", str(file))
    other = file.with_name("other.toml")
    other.write_text(FILE.replace('"pair"', '"other"'))
    with pytest.raises(BadConfig, match="a lab 'pair' runs already, and there is one at a time"):
        here("up", str(other))
    assert remote.status().name == "pair"


@pytest.mark.parametrize("name", ["../precious", "", ".", "/precious", "n" * 100])
def test_a_name_leads_nowhere_else(able: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    for folder in (tmp_path / "precious", tmp_path / "zmav-lab" / "precious"):
        folder.mkdir(parents=True, mode=0o700)
    (tmp_path / "zmav-lab").chmod(0o700)
    (tmp_path / "pair.toml").write_text(FILE.replace('"pair"', f'"{name}"'))
    with pytest.raises(BadInput, match=r"use lower-case letters|too long for a socket"):
        here("up", str(tmp_path / "pair.toml"))
    assert (tmp_path / "precious").exists()
    assert (tmp_path / "zmav-lab" / "precious").exists()


def test_a_name_is_taken_until_the_last_who_holds_it_has_gone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with claimed("pair") as (directory, claim):
        held = os.dup(claim)  # as the relay does
        directory.mkdir()  # it begins: nobody answers there yet
        with pytest.raises(BadConfig, match="a lab 'pair' runs already"), claimed("pair", patience=0.0):
            pass
    with pytest.raises(BadConfig, match="a lab 'pair' runs already"), claimed("pair", patience=0.0):
        pass
    assert directory.exists()
    os.close(held)
    with claimed("pair") as (again, _):
        assert again == directory
        assert not again.exists()


def test_the_socket_survives_nonsense(remote: Remote) -> None:
    with pytest.raises(BadInput, match="no verb 'fly'"):
        remote.call("fly")
    with pytest.raises(BadInput, match="not a request"):
        remote.call("cut", links="1-2")
    with socket.socket(socket.AF_UNIX) as raw:
        raw.connect(str(remote.path))
        raw.sendall(b"{]\n")
        assert b"bad_input" in raw.recv(65536)
        raw.sendall(b'{"verb": "status"}\n')
        assert b'"pair"' in raw.recv(65536)
    assert remote.status().name == "pair"


def test_no_lab_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with pytest.raises(LinkDown, match="no lab runs: start one"):
        Remote()
    directory_of_labs().chmod(0o777)
    with pytest.raises(BadConfig, match="not a directory of yours alone"):
        Remote()
