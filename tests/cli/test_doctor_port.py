"""What ``zmav doctor`` says of a serial port and of the fleet file that names it: each trouble is planted for real."""

from __future__ import annotations

import contextlib
import os
import random
import sys
import termios
import threading
import tty
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from mesh.credentials.ca import Authority
from tests.cli.conftest import Process, Told, zmav_here
from tests.cli.test_doctor import heartbeat
from zmav.doctor import serial
from zmav.doctor.findings import Level
from zmav.links.serial import SerialLink
from zmav.trust.certificate import Role

TABLE = '[vehicles.quad1]\nlink = "{link}"\nsysid = 1\nlisten = ["tcp/127.0.0.1:1"]\n'


class Autopilot:
    """At the other end of a pseudo-terminal: MAVLink where the port is set to its baud rate, noise at any other."""

    def __init__(self, path: Path, baud: int | None) -> None:
        self.path, self._baud = path, baud
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.device = os.ttyname(self._slave)
        path.symlink_to(self.device)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._speak)
        if baud is None:
            os.close(self._slave)  # its driver holds it; here nobody else than a test's program shall

    def __enter__(self) -> Autopilot:
        if self._baud is not None:
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        if self._baud is not None:
            self._thread.join()
            os.close(self._slave)
        os.close(self._master)

    def _speak(self) -> None:
        noise, seq = random.Random(1), 0
        speed = getattr(termios, f"B{self._baud}")
        while not self._over.wait(0.02):
            seq += 1
            right = termios.tcgetattr(self._master)[5] == speed
            with contextlib.suppress(BlockingIOError):
                os.write(self._master, heartbeat(1, 2, 3, seq % 256) if right else noise.randbytes(100))


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A rate is heard through soon: the autopilots here send fifty times a second."""
    monkeypatch.setattr(SerialLink, "listen", 0.5)


@pytest.fixture
def silent(tmp_path: Path) -> Iterator[Autopilot]:
    with Autopilot(tmp_path / "ttyUSB7", None) as autopilot:
        yield autopilot


def examine(*arguments: str) -> tuple[Told, dict[str, dict[str, Any]]]:
    """What is told, and the red lines."""
    told = zmav_here("doctor", "--for", "0.5", "--json", *arguments)
    assert told.error is None, told
    red = {line["subject"]: line for line in told.lines if line["level"] == "red"}
    assert told.code == (1 if red else 0)
    assert all(line["advice"] for line in red.values()), red
    return told, red


def red(*arguments: str) -> dict[str, dict[str, Any]]:
    return examine(*arguments)[1]


def test_a_port_that_is_well(tmp_path: Path) -> None:
    with Autopilot(tmp_path / "ttyUSB7", 57600) as autopilot:
        told, wrong = examine("--link", f"{autopilot.path},57600")
    assert not wrong
    found = {line["subject"]: line["found"] for line in told.lines}
    assert found["device"] == f"{autopilot.path} -> {autopilot.device}"
    assert found["holder"].startswith("nobody has it open")
    assert found["system 1/1"] == "ardupilot copter"


def test_the_wrong_baud_rate(tmp_path: Path) -> None:
    with Autopilot(tmp_path / "ttyUSB7", 57600) as autopilot:
        wrong = red("--link", f"{autopilot.path},115200")
    assert list(wrong) == ["link"]
    assert wrong["link"]["found"] == "MAVLink is heard at 57600 baud, and not at 115200"
    assert f'link = "{autopilot.path},57600"' in wrong["link"]["advice"]


def test_a_silent_port(silent: Autopilot) -> None:
    wrong = red("--link", f"{silent.path},57600")
    assert list(wrong) == ["traffic"]
    assert wrong["traffic"]["found"] == "not a byte"


def test_a_port_that_another_program_has(silent: Autopilot) -> None:
    """It is told which, and the port is left to it."""
    code = "import signal, sys; port = open(sys.argv[1], 'rb', 0); print('open', flush=True); signal.pause()"
    holder = Process(sys.executable, "-c", code, str(silent.path))
    try:
        holder.expect("open")
        told, wrong = examine("--link", f"{silent.path},57600")
    finally:
        holder.popen.kill()
        holder.wait()
    assert list(wrong) == ["holder"]
    assert f"pid {holder.popen.pid} ({sys.executable} -c" in wrong["holder"]["found"]
    assert f"kill {holder.popen.pid}" in wrong["holder"]["advice"]
    assert "traffic" not in {line["topic"] for line in told.lines}, "it was listened to"


def test_a_port_that_the_user_may_not_open(silent: Autopilot) -> None:
    user = ("--user", "nobody") if os.geteuid() == 0 else ()
    Path(silent.device).chmod(0o600 if user else 0)
    wrong = red("--link", f"{silent.path},57600", *user)
    assert list(wrong) == ["permission"]
    assert f"may not open {silent.path}" in wrong["permission"]["found"]
    assert "usermod -aG" in wrong["permission"]["advice"]
    assert "there is no user" in red("--link", str(silent.path), "--user", "no-such-user")["permission"]["found"]


@pytest.mark.parametrize("path", ["/dev/null", __file__, "/dev"])
def test_what_is_no_serial_port(path: str) -> None:
    assert "is not a serial port" in red("--link", f"serial:{path}:57600")["device"]["found"]


# Who has it, who else wants it: by a /proc that is made here.


def process(proc: Path, pid: int, *words: str, holds: str = "") -> None:
    (proc / str(pid) / "fd").mkdir(parents=True)
    (proc / str(pid) / "cmdline").write_bytes(b"".join(word.encode() + b"\0" for word in words))
    if holds:
        (proc / str(pid) / "fd" / "3").symlink_to(holds)


@pytest.mark.parametrize(
    ("holding", "level", "words", "advice"),
    [
        ([("python3", "/usr/bin/zmav", "up", "--name", "quad1")], Level.OK, "held by zmav up (pid 100)", ""),
        ([("zmav", "up"), ("python", "-m", "zmav", "up")], Level.RED, "two 'zmav up'", "kill 100"),
        ([("/usr/bin/zmav", "doctor")], Level.RED, "pid 100 (/usr/bin/zmav doctor)", "kill 100"),
        ([("/sbin/agetty", "-o", "ttyAMA0")], Level.RED, "agetty", "serial-getty@"),
        ([("/usr/sbin/ModemManager",)], Level.RED, "ModemManager", "systemctl mask --now ModemManager"),
        ([()], Level.RED, "pid 100 (?)", "systemctl status 100"),
    ],
)
def test_who_has_it(
    silent: Autopilot, tmp_path: Path, holding: list[tuple[str, ...]], level: Level, words: str, advice: str
) -> None:
    proc = tmp_path / "proc"
    process(proc, 7, "bash")
    for number, command in enumerate(holding):
        process(proc, 100 + number, *command, holds=silent.device)
    found, free = serial.check_device(str(silent.path), None, proc)
    (line,) = [each for each in found if each.topic == "holder"]
    assert (line.level, free) == (level, False)
    assert words in line.found
    assert advice in line.advice


def test_a_console(silent: Autopilot, tmp_path: Path) -> None:
    proc = tmp_path / "proc"
    process(proc, 7, "bash")
    (proc / "consoles").write_text(f"tty0  -WU (EC  p  )    4:7\n{Path(silent.device).name}  -W- (EC p a) 4:64\n")
    found, free = serial.check_device(str(silent.path), None, proc)
    (line,) = [each for each in found if each.topic == "console"]
    assert (line.level, free) == (Level.RED, False)
    assert "serial-getty@" in line.advice


def test_a_modem_manager_that_may_probe_it(tmp_path: Path) -> None:
    proc = tmp_path / "proc"
    process(proc, 7, "/usr/sbin/ModemManager")
    probe = serial.look_for_modem_manager
    (line,) = probe("/dev/ttyACM0", Path("/dev/null").stat(), proc)
    assert (line.level, "pid 7" in line.found, "ID_MM_DEVICE_IGNORE" in line.advice) == (Level.ADVICE, True, True)
    udev = tmp_path / "udev"
    udev.mkdir()
    (udev / "c1:3").write_text("S:autopilot\nE:ID_MM_PORT_IGNORE=1\n")  # /dev/null's numbers
    assert list(probe("/dev/ttyACM0", Path("/dev/null").stat(), proc, udev)) == [], "a rule keeps it off"
    assert list(probe("/dev/ttyAMA0", Path("/dev/null").stat(), proc)) == [], "no modem is behind a UART"


# The fleet file.


def fleet_file(tmp_path: Path, text: str) -> str:
    file = tmp_path / "fleet.toml"
    file.write_text(text)
    return str(file)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (TABLE.format(link="udpin::14550") + "bawd = 57600\n", "unknown field `bawd`"),
        (TABLE.format(link="pigeon:coop"), "vehicles.quad1.link: bad link URL 'pigeon:coop'"),
        (TABLE.format(link="udpin::14550") + 'dialect = "klingon"\n', "vehicles.quad1.dialect"),
        (
            TABLE.format(link="udpin::14550") + '[vehicles.b]\nlink = "udpin::1"\nsysid = 1\n',
            "vehicles.b.sysid is 1; expected a system id of its own",
        ),
        (
            TABLE.format(link="udpin::14550").replace("quad1", "quad2"),
            "no host 'quad1' in the fleet file; it has quad2",
        ),
        (TABLE.format(link="udpin::14550") + '[vehicles.quad1.signing]\nkey_file = "/no/such"\n', "signing.key_file"),
        ("fleet = ", "is not TOML"),
    ],
)
def test_a_fleet_file_that_is_wrong(tmp_path: Path, text: str, words: str) -> None:
    wrong = red("--file", fleet_file(tmp_path, text), "--name", "quad1", "-e", "tcp/127.0.0.1:1")
    assert words in wrong["fleet file"]["found"]


def test_a_fleet_file_that_names_a_device_that_is_not_there(tmp_path: Path) -> None:
    """Nothing runs on this vehicle yet: so the link of the file is looked at here."""
    file = fleet_file(tmp_path, TABLE.format(link="/dev/ttyNOPE7,57600"))
    told, wrong = examine("--file", file, "--name", "quad1")
    assert sorted(wrong) == ["device", "router"]
    assert wrong["device"]["found"] == "/dev/ttyNOPE7 is not there"
    assert "tcp/127.0.0.1:1" in wrong["router"]["found"], "its own router's endpoint is the file's"
    assert {line["subject"]: line["level"] for line in told.lines}["fleet file"] == "ok"


def test_credentials_of_another_vehicle_or_fleet(tmp_path: Path) -> None:
    authority = Authority.create(tmp_path / "ca", "alpha")
    folders = {name: authority.issue(name, role) for name, role in (("quad2", Role.VEHICLE), ("ops", Role.OPERATOR))}
    text = 'fleet = "{fleet}"\n' + TABLE.format(link="udpin:127.0.0.1:0")

    def told(fleet: str, member: str) -> str:
        file = fleet_file(tmp_path, text.format(fleet=fleet))
        wrong = red("--file", file, "--name", "quad1", "--credentials", str(folders[member]))
        return str(wrong.get("fleet file", {}).get("found"))

    assert told("alpha", "quad2") == "the credentials are quad2's, and this host is quad1"
    assert told("alpha", "ops") == "None", "an operator may look at a vehicle on the vehicle"
    assert told("beta", "ops").endswith("is the fleet beta's, and the credentials are for alpha")


def test_a_name_needs_its_file() -> None:
    assert zmav_here("doctor", "--name", "quad1").code == 2
