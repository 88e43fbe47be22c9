"""The units, the udev rule and the template of deploy/: what can be said of them without a systemd that runs them."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from zmav import cli
from zmav.config import load_fleet

DEPLOY = Path(__file__).resolve().parent.parent.parent / "deploy"
UNITS = sorted((DEPLOY / "systemd").glob("*.service"))
RULES = DEPLOY / "udev" / "70-zmav-autopilot.rules"
systemd_analyze = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd-analyze here")


def settings(unit: Path) -> list[tuple[str, str]]:
    lines = [line for line in unit.read_text(encoding="utf-8").splitlines() if line and line[0] not in "#["]
    return [(name, value) for name, _, value in (line.partition("=") for line in lines)]


def verify(folder: Path, units: dict[str, str]) -> str:
    """What systemd-analyze has to say of units in a folder of their own."""
    for name, text in units.items():
        (folder / name).write_text(text, encoding="utf-8")
    command = ["systemd-analyze", "verify", "--man=no", *(str(folder / name) for name in units)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60.0)
    said = [line for line in done.stderr.splitlines() if any(name.partition("@")[0] in line for name in units)]
    return "\n".join(said)


def here(unit: Path) -> str:
    """The unit with a program that there is on this computer."""
    return unit.read_text(encoding="utf-8").replace("/opt/zmav/current/bin/zmav", sys.executable)


@systemd_analyze
def test_systemd_finds_nothing_wrong(tmp_path: Path) -> None:
    names = {unit.name.replace("@.", "@follower."): here(unit) for unit in UNITS}
    assert len(names) == 3
    assert verify(tmp_path, names) == ""


@systemd_analyze
def test_systemd_would_find_something_wrong(tmp_path: Path) -> None:
    broken = here(DEPLOY / "systemd" / "zmav-vehicle.service").replace("WatchdogSec=", "WatchDogSec=")
    assert "WatchDogSec" in verify(tmp_path, {"zmav-vehicle.service": broken})


@systemd_analyze
@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.name)
def test_little_is_exposed(unit: Path, tmp_path: Path) -> None:
    """In tenths: 17 with systemd 252; other versions count a little otherwise. Without hardening it is 92."""
    copy = tmp_path / unit.name.replace("@.", "@follower.")
    copy.write_text(here(unit), encoding="utf-8")
    command = ["systemd-analyze", "security", "--no-pager", "--offline=yes", "--threshold=25", str(copy)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60.0)
    if "unrecognized option" in done.stderr:
        pytest.skip("this systemd-analyze judges no files (systemd before 250)")
    assert done.returncode == 0, done.stdout[-300:] + done.stderr


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.name)
def test_a_serial_port_that_comes_later_is_not_hidden(unit: Path) -> None:
    """DeviceAllow (which ProtectClock brings) names kinds of devices by what the kernel knows when the unit starts."""
    hiding = {"PrivateDevices", "DevicePolicy", "DeviceAllow", "ProtectClock"}
    assert not hiding & {name for name, _ in settings(unit)}


def test_a_vehicle_s_agent_is_started_for_ever_and_writes_to_its_own_folder_only() -> None:
    """A limit of starts would leave a vehicle in flight without its agent for good; a service that can write where root
    copies credentials can lead root elsewhere.
    """
    found = dict(settings(DEPLOY / "systemd" / "zmav-vehicle.service"))
    assert (found["Restart"], found["StartLimitIntervalSec"]) == ("always", "0")
    assert "StartLimitBurst" not in found
    assert 0.0 < float(found["RestartSec"]) <= 2.0
    assert found["StateDirectory"] == "zmav" and "ReadWritePaths" not in found


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.name)
def test_what_it_runs_there_is(unit: Path) -> None:
    (command,) = [value for name, value in settings(unit) if name == "ExecStart"]
    program, *words = command.split()
    assert program == "/opt/zmav/current/bin/zmav"
    verb = [word for word in words if re.fullmatch(r"[a-z]+\d?", word)]
    told = CliRunner().invoke(cli.zmav, [*verb, "--help"])
    assert told.exit_code == 0, told.output
    assert all(word in told.output for word in words if word.startswith("--"))


def test_the_template_is_a_fleet_file_with_and_without_its_comments(tmp_path: Path) -> None:
    text = (DEPLOY / "vehicle.toml").read_text(encoding="utf-8")
    for mark, value in (("@NAME@", "rover1"), ("@FLEET@", "alpha"), ("@LINK@", "/dev/autopilot")):
        assert mark in text
        text = text.replace(mark, value)
    path = tmp_path / "vehicle.toml"
    path.write_text(text, encoding="utf-8")
    fleet = load_fleet(path)
    assert (fleet.fleet, fleet.vehicle("rover1").link, fleet.origin) == ("alpha", "/dev/autopilot", None)
    path.write_text(re.sub(r"^#(?=[a-z\[])", "", text, flags=re.MULTILINE), encoding="utf-8")
    fleet = load_fleet(path)
    assert fleet.origin is not None
    assert fleet.vehicle("rover1").pilot_switch is not None
    assert fleet.vehicle("rover1").mesh.radios[0].interface == "wlan0"


def test_each_udev_rule_is_well_formed() -> None:
    text = re.sub(r"#.*", "", RULES.read_text(encoding="utf-8"))
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    part = re.compile(r'[A-Z]+(\{\w+\})?(==|!=|\+=|=)"[^"]*"')
    assert all(part.fullmatch(each.strip()) for line in lines for each in line.split(", "))
    labels = set(re.findall(r'LABEL="(\w+)"', text))
    assert set(re.findall(r'GOTO="(\w+)"', text)) == labels
    vendors = [set(re.findall(r"[0-9a-f]{4}", line)) for line in lines if "2dae" in line]
    assert len(vendors) == 2
    assert vendors[0] == vendors[1]  # those that ModemManager is kept from are those that get the link
