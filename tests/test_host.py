"""A computer's health, by a /proc and a /sys that are made here, and what ``zmav doctor`` makes of it."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import msgspec
import pytest

from zmav import host, wire
from zmav.doctor import computer
from zmav.doctor.findings import Level

MB, GB = 1 << 20, 1 << 30


def write(root: Path, **texts: str) -> Path:
    for place, text in texts.items():
        path = root / place.replace("__", "/")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root


def test_this_computer(tmp_path: Path) -> None:
    told = host.report("here", "id", ("/", tmp_path / "not" / "yet", "/"))
    assert wire.decode(wire.encode(told), wire.HostReport, "host") == told
    assert told.versions["zmav"]
    assert told.cpus > 0
    paths = [disk.path for disk in told.disks]
    assert paths[0] == "/"
    assert len(paths) == len(set(paths)) <= 2, "each file system once"
    assert all(0 < disk.free <= disk.size for disk in told.disks)
    free = os.statvfs(tmp_path)
    last = told.disks[-1]
    assert last.free == pytest.approx(free.f_bavail * free.f_frsize, rel=0.2)


def test_a_raspberry_pi(tmp_path: Path) -> None:
    (tmp_path / "sys/class/thermal/thermal_zone0").mkdir(parents=True)
    (tmp_path / "sys/class/thermal/thermal_zone0/temp").write_text("61234\n")
    (tmp_path / "sys/class/thermal/thermal_zone1").mkdir()
    (tmp_path / "sys/class/thermal/thermal_zone1/temp").write_text("200000\n")  # no sensor is there
    firmware = tmp_path / "sys/devices/platform/soc/soc:firmware"
    firmware.mkdir(parents=True)
    (firmware / "get_throttled").write_text("50005\n")
    hwmon = tmp_path / "sys/class/hwmon/hwmon1"
    hwmon.mkdir(parents=True)
    (hwmon / "name").write_text("rpi_volt\n")
    (hwmon / "in0_lcrit_alarm").write_text("1\n")
    write(tmp_path, proc__meminfo="MemTotal:  948280 kB\nMemAvailable: 500000 kB\nHugePages_Total: 0\n")
    told = host.report("pi", "id", (), tmp_path)
    assert (told.temperature, told.throttled, told.under_voltage) == (61.234, 0x50005, True)
    assert (told.memory, told.memory_size) == (500000 * 1024, 948280 * 1024)


def test_a_computer_that_tells_nothing(tmp_path: Path) -> None:
    write(tmp_path, proc__meminfo="nonsense\nMemTotal: many kB\n")
    told = host.report("box", "id", ("/no/such/place",), tmp_path)
    assert (told.temperature, told.throttled, told.under_voltage, told.memory) == (None, None, None, None)


def healthy(**changes: Any) -> wire.HostReport:
    whole = wire.HostReport(
        t=0.0,
        name="pi",
        instance="id",
        versions={},
        system="Linux",
        cpus=4,
        load=1.0,
        memory=2 * GB,
        memory_size=4 * GB,
        temperature=50.0,
        throttled=0,
        under_voltage=False,
        clock_synced=True,
        clock_error=0.002,
        disks=[wire.Disk(path="/", free=10 * GB, size=30 * GB)],
    )
    return msgspec.structs.replace(whole, **changes)


def test_a_computer_that_is_well() -> None:
    (line,) = computer.check_host(healthy(), "alpha/pi")
    assert (line.level, line.subject) == (Level.OK, "alpha/pi computer")
    assert line.found == "Linux, / 10 GB free, memory 2 GB free, load 1.0 of 4, 50 °C, clock kept within 2 ms"


@pytest.mark.parametrize(
    ("changes", "topic", "level", "words"),
    [
        ({"disks": [wire.Disk(path="/", free=100 * MB, size=30 * GB)]}, "disk", Level.RED, "100 MB free of 30 GB"),
        ({"disks": [wire.Disk(path="/", free=1 * GB, size=30 * GB)]}, "disk", Level.ADVICE, "1 GB free of 30 GB"),
        ({"disks": [wire.Disk(path="/", free=9 * GB, size=9, read_only=True)]}, "disk", Level.RED, "read-only"),
        ({"memory": 50 * MB}, "memory", Level.RED, "50 MB free"),
        ({"memory": 300 * MB}, "memory", Level.ADVICE, "300 MB free"),
        ({"load": 6.5}, "load", Level.ADVICE, "6.5 processes want 4 cores"),
        ({"temperature": 81.0}, "heat", Level.ADVICE, "81 °C"),
        ({"throttled": 0x50005}, "power", Level.RED, "now: under-voltage, processor throttled"),
        ({"throttled": 0x50000}, "power", Level.ADVICE, "since it started: under-voltage, processor throttled"),
        ({"under_voltage": True}, "power", Level.RED, "now: under-voltage"),
        ({"clock_synced": False}, "time", Level.ADVICE, "nothing keeps the clock"),
    ],
)
def test_a_computer_in_trouble(changes: dict[str, Any], topic: str, level: Level, words: str) -> None:
    _, line = computer.check_host(healthy(**changes))
    assert (line.topic, line.level) == (topic, level)
    assert words in line.found
    assert line.advice
    assert line.ok is (level is not Level.RED)


def test_versions_of_a_fleet() -> None:
    ours = host.versions()
    assert [line.level for line in computer.check_versions({"a": ours})] == [Level.OK, Level.OK]
    other = {**ours, "eclipse-zenoh": ours["eclipse-zenoh"] + "1"}
    assert [line.level for line in computer.check_versions({"a": other})] == [Level.OK, Level.ADVICE]
    other = {"zmav": "9.0", "eclipse-zenoh": "0.11.0"}
    zmav, zenoh = computer.check_versions({f"a{n}": other for n in range(9)})
    assert (zmav.level, zenoh.level) == (Level.RED, Level.RED)
    assert "9.0: a0, a1, a2, a3, a4 and 4 more" in zmav.found


def test_who_is_older_is_named() -> None:
    ours = host.versions()
    own = ours["zmav"]
    others: dict[str, wire.HostReport | dict[str, str]]
    others = {"alpha/quad1": ours, "alpha/quad2": {**ours, "zmav": "0.0.9"}, "alpha/quad3": {**ours, "zmav": "0.0.10"}}
    line, _ = computer.check_versions(others)
    assert line.found.startswith(f"alpha/quad2 runs zmav 0.0.9, alpha/quad3 runs zmav 0.0.10: this is {own} (")
    assert f"on alpha/quad2, alpha/quad3 pip install zmav=={own}" in line.advice
    line, _ = computer.check_versions({"alpha/quad1": {**ours, "zmav": "1000.0.1"}})
    assert line.found.startswith(f"this computer runs zmav {own}: the newest is 1000.0.1 on alpha/quad1 (")
    assert "here pip install zmav==1000.0.1" in line.advice
    line, _ = computer.check_versions({"alpha/quad1": {**ours, "zmav": f"{own}+field"}})
    assert (line.level, line.found) == (Level.RED, f"{own}: here; {own}+field: alpha/quad1")
