"""``deploy/containers``: files that agree with each other and the project, and the services run as plain processes."""

from __future__ import annotations

import contextlib
import json
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from ipaddress import ip_address, ip_network
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner

from mesh.cli.config import command as show_config
from tests.deploy.compose import CONTAINERS, FILES, addresses, load, network_of, option, ours, plain
from zmav.cli import zmav
from zmav.config import load_fleet
from zmav.config.table import toml_document
from zmav.process import free_port

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = CONTAINERS.parents[1]
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
DOCKERFILE = (CONTAINERS / "Dockerfile").read_text(encoding="utf-8")
LAST_STAGE = DOCKERFILE[DOCKERFILE.rindex("\nFROM ") :]

composed = pytest.mark.parametrize("name", sorted(FILES))


def test_the_image_is_not_run_by_root() -> None:
    (user,) = re.findall(r"^USER (\S+)$", LAST_STAGE, re.MULTILINE)
    assert user.isdecimal(), "a number: Kubernetes and its like check that it is not root's"
    assert int(user) > 0
    assert f"useradd --uid {user} " in LAST_STAGE


def test_bases_are_pinned_and_good_enough() -> None:
    bases = re.findall(r"^FROM (\S+)", DOCKERFILE, re.MULTILINE)
    assert len(bases) == 2
    assert len(set(bases)) == 1, "a compiled environment moves between two of one kind only"
    found = re.fullmatch(r"python:(3\.\d+)-slim-(\w+)", bases[0])
    assert found, bases[0]
    assert f"Programming Language :: Python :: {found[1]}" in PROJECT["project"]["classifiers"]
    assert set(re.findall(r"/lib/python([\d.]+)/", DOCKERFILE)) == {found[1]}
    assert f'base.name="{bases[0]}"' in LAST_STAGE


def test_the_version_is_the_project_s() -> None:
    version = PROJECT["project"]["version"]
    assert f'image.version="{version}"' in LAST_STAGE
    for name in FILES:
        assert set(re.findall(r"image: zmav:(\S+)", (CONTAINERS / name).read_text())) == {version}
    assert f"-t zmav:{version}" in DOCKERFILE


def test_what_is_copied_is_there_and_is_what_the_package_is_made_of() -> None:
    first = DOCKERFILE[: DOCKERFILE.rindex("\nFROM ")]
    copied = {path for line in re.findall(r"^COPY (.+) \S+$", first, re.MULTILINE) for path in line.split()}
    assert set(PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]) <= copied
    ignored = (CONTAINERS / "Dockerfile.dockerignore").read_text(encoding="utf-8").splitlines()
    assert "*" in ignored
    for path in copied:
        assert (ROOT / path).exists()
        assert f"!{path}" in ignored, f"the build would not see {path}"


def test_what_is_installed_is_in_the_lock_by_hash_and_built_by_no_root() -> None:
    first = DOCKERFILE[: DOCKERFILE.rindex("\nFROM ")].replace("\\\n", " ")
    commands = [part.split() for part in first.split("&&") if "-m pip " in part]
    assert len(commands) == 4
    for command in commands:
        if "-r" in command:
            assert {"--require-hashes", "--only-binary"} <= set(command)
        else:
            assert "--no-deps" in command, "ours alone"
            assert ("--no-index" in command) != ("--no-build-isolation" in command)
    assert first.index("\nUSER build\n") < first.index(" pip ")


@composed
def test_no_secret_is_written_in_the_file(name: str) -> None:
    """Anyone who reads this repository would know it."""
    text = (CONTAINERS / name).read_text(encoding="utf-8")
    for line in re.findall(r"^.*(?:TOKEN|SECRET|PASSWORD|KEY)\w*:.*$", text, re.MULTILINE):
        assert re.search(r": \$\{\w+:\?", line), f"it starts without one being given: {line}"


@composed
def test_what_must_be_given_says_that_down_asks_for_it_too(name: str) -> None:
    """Compose reads the whole file for every command, and would have nobody end what he began in another shell."""
    for words in re.findall(r"\$\{\w+:\?([^}]*)\}", (CONTAINERS / name).read_text(encoding="utf-8")):
        assert "'down'" in words and "any word will do" in words, words


def test_nothing_is_downloaded_but_from_the_package_index() -> None:
    assert not re.search(r"^ADD |curl|wget|apt-get|git clone", DOCKERFILE, re.MULTILINE)
    assert "--no-cache-dir" in DOCKERFILE


@composed
def test_each_command_line_is_one_that_zmav_takes(name: str) -> None:
    file = load(name)
    for service in ours(file).values():
        arguments: list[str] = list(service["command"])
        assert all(isinstance(each, str) for each in arguments), arguments
        for words in (arguments, *(probe[1:] for probe in [probe_of(service)] if probe[:1] == ["zmav"])):
            parsed(words)


def probe_of(service: dict[str, Any]) -> list[str]:
    """The health check's command, without CMD."""
    test: list[str] = service.get("healthcheck", {}).get("test", ["CMD"])
    assert test[0] == "CMD"
    return test[1:]


def parsed(arguments: list[str]) -> None:
    """Have click parse a command line of zmav, groups included; raises UsageError for what it does not know."""
    group: click.Command = zmav
    context = click.Context(zmav, info_name="zmav")
    rest = arguments
    while isinstance(group, click.Group):
        if not rest or rest[0].startswith("-"):
            break  # 'zmav sim --fleet ...': the group's own options
        _, found, rest = group.resolve_command(context, rest)
        assert found is not None
        group = found
        context = click.Context(group, parent=context, info_name=group.name)
    left = group.parse_args(context, list(rest))
    assert not left or isinstance(group, click.Group), left


def test_a_wrong_command_line_is_noticed() -> None:
    with pytest.raises(click.UsageError):
        parsed(["up", "--fiel", "x"])
    with pytest.raises(click.UsageError):
        parsed(["rooter"])


@composed
def test_services_agents_and_addresses_are_the_fleet_file_s(name: str) -> None:
    file = load(name)
    path = CONTAINERS / FILES[name]
    fleet = load_fleet(path)
    started = {
        option(each["command"], "--name"): key for key, each in ours(file).items() if "--name" in each["command"]
    }
    assert set(started) == {*fleet.vehicles, *fleet.stations}
    assert all(ours(file)[started[vehicle]]["command"][0] == "up" for vehicle in fleet.vehicles)
    given = addresses(file)
    for place, host in fleet.hosts().items():
        host_name = place.partition(".")[2]
        wanted = {radio.address for radio in host.mesh.radios}
        assert wanted == {each[host_name] for each in given.values() if host_name in each}, place
    for service in ours(file).values():
        assert f"./{FILES[name]}:/etc/zmav/fleet.toml:ro" in service["volumes"]
        assert service.get("environment", {})["ZMAV_FLEET"] == fleet.fleet
    assert len({vehicle.sysid for vehicle in fleet.vehicles.values()}) == len(fleet.vehicles)
    for host_name in (*fleet.vehicles, *fleet.stations):
        told = CliRunner().invoke(show_config, ["--file", str(path), "--name", host_name, "--json"])
        assert told.exit_code == 0, told.output
        assert json.loads(told.output)["neighbours"]


@composed
def test_what_has_no_credentials_stays_on_this_machine(name: str) -> None:
    file = load(name)
    assert load_fleet(CONTAINERS / FILES[name]).mesh.insecure
    for network, members in addresses(file).items():
        declared = file["networks"][network]
        assert declared["internal"] is True
        (pool,) = declared["ipam"]["config"]
        taken = [*members.values(), pool["gateway"]]
        assert len(set(taken)) == len(taken)
        assert all(ip_address(each) in ip_network(pool["subnet"]) for each in taken)
    for service in file["services"].values():
        assert all(str(port).startswith("127.0.0.1:") for port in service.get("ports", ()))
    outside = [key for key, service in file["services"].items() if "outside" in (service.get("networks") or ())]
    assert outside == ["ground"], "only what the ground publishes leaves"


@composed
def test_services_may_do_no_more_than_they_need(name: str) -> None:
    file = load(name)
    for service in ours(file).values():
        assert service["read_only"] is True
        assert service["cap_drop"] == ["ALL"]
        assert service["security_opt"] == ["no-new-privileges:true"]
        assert "user" not in service
        assert "privileged" not in service
    for key, service in file["services"].items():
        assert network_of(file, key) in file["services"]
        image, colon, tag = service["image"].rpartition(":")
        assert image and colon and tag not in ("", "latest"), service["image"]


def test_autopilots_are_where_their_companions_look() -> None:
    """Each SITL shares its companion's network, with the ports and the system id that the fleet file says."""
    file = load("compose.sitl.yaml")
    fleet = load_fleet(CONTAINERS / "sitl.toml")
    for name, vehicle in fleet.vehicles.items():
        stack = file["services"][f"{name}-autopilot"]
        assert network_of(file, f"{name}-autopilot") == name
        command = stack["command"]
        if "px4" in stack["image"]:
            instance = int(option(command, "-i") or 0)
            assert vehicle.sysid == instance + 1
            assert vehicle.link == f"udpin:127.0.0.1:{14540 + instance}"
        else:
            assert option(command, "--sysid") == str(vehicle.sysid)
            assert vehicle.link == "tcp:127.0.0.1:5760"


@composed
def test_docker_compose_reads_it(name: str) -> None:
    asked = ["docker", "compose", "version"]
    if shutil.which("docker") is None or subprocess.run(asked, capture_output=True, check=False).returncode:
        pytest.skip("needs docker with the compose plugin")
    done = subprocess.run(
        ["docker", "compose", "-f", str(CONTAINERS / name), "config", "--quiet"],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr


def test_hadolint_has_nothing_to_say() -> None:
    if shutil.which("hadolint") is None:
        pytest.skip("needs hadolint")
    done = subprocess.run(
        ["hadolint", str(CONTAINERS / "Dockerfile")], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stdout


def is_open(port: int) -> bool:
    """What the image's health check asks."""
    with contextlib.suppress(OSError):
        socket.create_connection(("127.0.0.1", port), 2).close()
        return True
    return False


class Boxes:
    """The services of ``compose.yaml`` as processes of this machine.

    Addresses of the hops become those of loopback (172.30 -> 127.30), the simulator's name 127.0.0.1, and the port on
    which each host's own programs find its router another one for each: all have one network here.
    """

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.file = load("compose.yaml")
        self.port = {host: free_port() for host in ("quad1", "quad2", "rover1", "ground")}
        self.published = {port: str(free_port()) for port in ("8088", "5790")}
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self.fleet = directory / "fleet.toml"
        text = (CONTAINERS / "fleet.toml").read_text(encoding="utf-8").replace("172.30.", "127.30.")
        table: dict[str, Any] = tomllib.loads(
            re.sub("tcp:simulator:[0-9]+", lambda _: f"tcp:127.0.0.1:{free_port()}", text)
        )
        table["mesh"]["port"] = free_port(socket.SOCK_DGRAM)
        for host, port in self.port.items():
            kind = "stations" if host == "ground" else "vehicles"
            table[kind][host]["listen"] = [f"tcp/127.0.0.1:{port}"]
        self.fleet.write_text(toml_document(table), encoding="utf-8")

    def environment(self, service: str) -> dict[str, str]:
        """What Docker would set, and where the router is that loopback would lead to."""
        given: dict[str, str] = self.file["services"][service]["environment"]
        host = network_of(self.file, service)
        return plain(
            ZMAV_CONNECT=f"tcp/127.0.0.1:{self.port.get(host, 1)}", XDG_CACHE_HOME=str(self.directory), **given
        )

    def words(self, service: str) -> list[str]:
        """The service's command line, with this machine's places."""
        places = {
            "/etc/zmav/fleet.toml": str(self.fleet),
            "/tmp/sim.sock": str(self.directory / "sim.sock"),
            "/recordings": str(self.directory / "recordings"),
            "0.0.0.0": "127.0.0.1",
            **self.published,
            "0.0.0.0:5790": f"127.0.0.1:{self.published['5790']}",
        }
        return [places.get(word, word) for word in self.file["services"][service]["command"]]

    def start(self, service: str) -> None:
        """As Docker does: not before what it depends on is healthy."""
        for other, how in self.file["services"][service].get("depends_on", {}).items():
            assert how == {"condition": "service_healthy"}
            until(lambda port=self.port[other]: is_open(port), f"a healthy {other}", self)
        with (self.directory / f"{service}.log").open("wb") as log:
            self.processes[service] = subprocess.Popen(
                [sys.executable, "-m", "zmav", *self.words(service)],
                cwd=self.directory,
                env=self.environment(service),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
            )

    def asked(self, service: str, *words: str) -> str:
        """``docker compose exec SERVICE zmav WORDS``; empty where it fails."""
        done = subprocess.run(
            [sys.executable, "-m", "zmav", *words],
            env=self.environment(service),
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        return done.stdout if done.returncode == 0 else ""

    def log(self) -> str:
        return "\n".join(f"--- {path.name}\n{path.read_text()[-600:]}" for path in self.directory.glob("*.log"))

    def end(self) -> dict[str, int]:
        """How each ended, having been told as 'docker stop' tells it."""
        for process in self.processes.values():
            process.send_signal(signal.SIGTERM)
        try:
            return {name: process.wait(20) for name, process in self.processes.items()}
        finally:
            for process in self.processes.values():
                process.kill()
                process.wait()


@pytest.fixture
def boxes(tmp_path: Path) -> Iterator[Boxes]:
    made = Boxes(tmp_path)
    try:
        yield made
    finally:
        made.end()


def until(there: Any, what: str, boxes: Boxes) -> None:
    last = time.monotonic() + 90.0
    while not there():
        dead = [name for name, process in boxes.processes.items() if process.poll() is not None]
        if dead or time.monotonic() > last:
            raise AssertionError(f"{what}: not there; ended: {dead}\n{boxes.log()}")
        time.sleep(0.1)


@pytest.mark.slow
def test_the_services_commands_are_a_fleet(boxes: Boxes) -> None:
    """Each service of compose.yaml, started as it is written; the ground sees all three, two of them through others."""
    for service in boxes.file["services"]:
        boxes.start(service)

    def seen() -> dict[str, bool]:
        lines = boxes.asked("ground", "ls", "--json").splitlines()
        return {each["name"]: each.get("connected", False) for each in map(json.loads, lines)}

    until(lambda: seen() == dict.fromkeys(("quad1", "quad2", "rover1"), True), "the fleet in 'zmav ls'", boxes)
    until(lambda: "rover1" in boxes.asked("ground", "mesh", "graph", "--json"), "rover1 in the graph", boxes)

    token = boxes.file["services"]["http"]["environment"]["ZMAV_HTTP_TOKEN"]
    page = f"http://127.0.0.1:{boxes.published['8088']}/vehicles"

    def fetched(headers: dict[str, str]) -> bytes:
        with (
            contextlib.suppress(urllib.error.URLError),
            urllib.request.urlopen(urllib.request.Request(page, headers=headers), timeout=10) as answer,
        ):
            return bytes(answer.read())
        return b""

    until(lambda: b"rover1" in fetched({"Authorization": f"Bearer {token}"}), "the fleet over HTTP", boxes)
    with socket.create_connection(("127.0.0.1", int(boxes.published["5790"])), 10) as station:
        station.settimeout(30)
        assert station.recv(1) in (b"\xfd", b"\xfe"), "the GCS bridge speaks MAVLink"
    until(lambda: any((boxes.directory / "recordings").rglob("*.mcap")), "a recording", boxes)
    assert boxes.asked(
        "simulator", *probe_of(boxes.file["services"]["simulator"])[1:3], "--control", str(boxes.directory / "sim.sock")
    )
    ended = boxes.end()
    assert set(ended.values()) <= {0}, f"{ended}\n{boxes.log()}"
