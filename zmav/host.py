"""This computer's health, from what the kernel tells anybody: cheap, nothing is started, nothing waited for.

Sources: ``adjtimex(2)``; the kernel's thermal and hwmon pages; ``get_throttled`` of the Raspberry Pi firmware's driver,
whose bits are https://www.raspberrypi.com/documentation/computers/os.html#get_throttled.
"""

from __future__ import annotations

import ctypes
import os
import platform
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

from zmav import wire

PACKAGES = ("zmav", "eclipse-zenoh", "pymavlink", "fastcrc", "pyserial", "numpy", "msgspec")
UNSYNCHRONISED_S = 16.0
"""estimated error from which on nothing keeps the clock; STA_UNSYNC is not asked: chrony may set it to spare the RTC
(as systemd's ntp_synced() judges)"""
THERMAL, HWMON = "sys/class/thermal/thermal_zone*/temp", "sys/class/hwmon/hwmon*"
THROTTLED = "sys/devices/platform/*/*firmware/get_throttled"
CREDIBLE = range(1, 150)
"""°C; sensors that are not there say 0, -273 or thousands"""


def report(name: str, instance: str, paths: Iterable[str | Path] = ("/",), root: Path = Path("/")) -> wire.HostReport:
    """Health of this computer; ``paths`` are on the file systems that matter. ``root``: where /proc and /sys are."""
    memory = _memory(root)
    synced, error = clock_sync()
    try:
        load: float | None = os.getloadavg()[0]
    except OSError:
        load = None
    return wire.HostReport(
        t=time.time(),
        name=name,
        instance=instance,
        versions=versions(),
        system=f"{platform.system()} {platform.release()} {platform.machine()}",
        cpus=len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1,
        disks=list(disks(paths)),
        load=load,
        memory=memory.get("MemAvailable"),
        memory_size=memory.get("MemTotal"),
        temperature=_temperature(root),
        throttled=_throttled(root),
        under_voltage=_under_voltage(root),
        clock_synced=synced,
        clock_error=error,
    )


def versions() -> dict[str, str]:
    """Of Python and of the packages that are installed."""
    from importlib.metadata import PackageNotFoundError, version  # 1.6 MB, which many a vehicle is never asked for

    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def disks(paths: Iterable[str | Path]) -> Iterator[wire.Disk]:
    """Of each file system once; of a folder that is not there yet, the one where it would be made."""
    seen = set()
    for path in map(Path, paths):
        there = _existing(path)
        try:
            device, fs = there.stat().st_dev, os.statvfs(there)
        except OSError:
            continue
        if device not in seen:
            seen.add(device)
            yield wire.Disk(
                path=str(path),
                free=fs.f_bavail * fs.f_frsize,
                size=fs.f_blocks * fs.f_frsize,
                read_only=bool(fs.f_flag & os.ST_RDONLY),
            )


def _existing(path: Path) -> Path:
    for each in (path, *path.absolute().parents):
        if each.exists():
            return each
    return path


def _memory(root: Path) -> dict[str, int]:
    """Bytes by the names of /proc/meminfo."""
    found = {}
    for line in _text(root / "proc/meminfo").splitlines():
        name, _, amount = line.partition(":")
        number, _, unit = amount.strip().partition(" ")
        if number.isdecimal() and unit == "kB":
            found[name] = int(number) * 1024
    return found


def _temperature(root: Path) -> float | None:
    found = [int(text) / 1000 for path in sorted(root.glob(THERMAL)) if (text := _text(path).strip()).isdecimal()]
    return max((degrees for degrees in found if int(degrees) in CREDIBLE), default=None)


def _throttled(root: Path) -> int | None:
    for path in sorted(root.glob(THROTTLED)):
        try:
            return int(_text(path).strip(), 16)
        except ValueError:
            continue
    return None


def _under_voltage(root: Path) -> bool | None:
    for path in sorted(root.glob(HWMON)):
        if _text(path / "name").strip() == "rpi_volt":
            return _text(path / "in0_lcrit_alarm").strip() == "1"
    return None


def _text(path: Path) -> str:
    try:
        return path.read_text(errors="replace")
    except OSError:
        return ""


class _Timex(ctypes.Structure):
    """The beginning of the kernel's struct timex; the rest is not looked at."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("esterror", ctypes.c_long),
        ("status", ctypes.c_int),
        ("rest", ctypes.c_byte * 512),
    )


def clock_sync() -> tuple[bool | None, float | None]:
    """Whether something keeps the clock, and the s that it can then be wrong by; None where that cannot be told."""
    try:
        told = _Timex()
        if ctypes.CDLL(None).adjtimex(ctypes.byref(told)) < 0:
            return None, None
    except (OSError, AttributeError):  # no Linux
        return None, None
    error = told.maxerror / 1e6
    return (True, error) if error < UNSYNCHRONISED_S else (False, None)
