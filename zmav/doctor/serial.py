"""What ``zmav doctor`` says of a serial device before anybody opens it: is it there, who may, who has it.

Everything is read from /proc, /sys and the udev database: nothing is opened, so nothing is taken from who uses it.
"""

from __future__ import annotations

import contextlib
import grp
import os
import pwd
import re
import stat
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from zmav.doctor import topics
from zmav.doctor.findings import Finding

SERVICE_USER = "zmav"
"""who runs the service, where root asks"""
SCAN_S = 3.0
"""s that looking through all processes may take"""
IGNORED = ("E:ID_MM_DEVICE_IGNORE=1", "E:ID_MM_PORT_IGNORE=1")
"""lines of the udev database on a device that ModemManager leaves alone"""
USB = re.compile(r"tty(ACM|USB)\d+\Z")


@dataclass(frozen=True)
class Process:
    pid: int
    words: list[str]
    """its command line"""

    @property
    def command(self) -> str:
        return " ".join(self.words) or "?"

    def is_up(self) -> bool:
        """``zmav up``, by whichever way it was started."""
        at = [i for i, word in enumerate(self.words) if Path(word).name == "zmav"]
        return any(self.words[i + 1 : i + 2] == ["up"] for i in at)


def check_device(path: str, user: str | None = None, proc: Path = Path("/proc")) -> tuple[list[Finding], bool]:
    """Findings about the device, and whether it may be opened now to listen: it is there and nobody has it."""
    try:
        mode = Path(path).stat()
    except FileNotFoundError:
        return [topics.DEVICE.wrong(f"{path} is not there", _others(path))], False
    except OSError as e:
        return [topics.DEVICE.wrong(f"{path} cannot be looked at: {e.strerror}", "run this as root")], False
    if not stat.S_ISCHR(mode.st_mode) or not _is_tty(path):
        return [topics.DEVICE.wrong(f"{path} is not a serial port", _others(path))], False
    real = os.path.realpath(path)
    found = [topics.DEVICE.well(path if real == path else f"{path} -> {real}")]
    found += _permission(path, mode, user)
    held = list(holders(real, proc))
    found += _held(path, held)
    found += _console(real, held, proc)
    found += look_for_modem_manager(real, mode, proc)
    return found, not held and all(finding.ok for finding in found)


def _is_tty(path: str) -> bool:
    """By the driver that stands for it: a device is not opened to ask it."""
    name = Path(os.path.realpath(path))
    return name.name.startswith("tty") or name.parent.name == "pts" or Path(f"/sys/class/tty/{name.name}").exists()


def _others(path: str) -> str:
    """What might be meant."""
    by_id = sorted(Path("/dev/serial/by-id").glob("*")) if Path("/dev/serial/by-id").is_dir() else []
    there = [str(each) for each in by_id] or sorted(str(p) for p in Path("/dev").glob("tty[AU]*") if USB.match(p.name))
    there = [each for each in there if each != path]
    seen = f"there is: {', '.join(there[:4])}" if there else "no USB serial device is there"
    return f"is it plugged in and powered? {seen}"


def _permission(path: str, mode: os.stat_result, user: str | None) -> list[Finding]:
    if user is None and os.geteuid() == 0:
        with contextlib.suppress(KeyError):
            user = pwd.getpwnam(SERVICE_USER).pw_name
    if user is None:
        name, may = _own_name(), os.access(path, os.R_OK | os.W_OK)
    else:
        try:
            account = pwd.getpwnam(user)
        except KeyError:
            return [topics.PERMISSION.wrong(f"there is no user {user}", "name the one who runs zmav with --user")]
        groups = os.getgrouplist(user, account.pw_gid)
        name, may = user, _may(mode, account.pw_uid, groups)
    if may:
        return [topics.PERMISSION.well(f"{name} may open it")]
    group = _group_name(mode.st_gid)
    advice = f"sudo usermod -aG {group} {name}, then log in, or start the service, again"
    if mode.st_mode & 0o060 != 0o060:
        advice = f"sudo chmod g+rw {path} (a udev rule makes it last), and {advice}"
    return [
        topics.PERMISSION.wrong(f"{name} may not open {path} ({stat.filemode(mode.st_mode)}, group {group})", advice)
    ]


def _may(mode: os.stat_result, uid: int, groups: list[int]) -> bool:
    if uid == 0:
        return True
    bits = mode.st_mode >> (6 if uid == mode.st_uid else 3 if mode.st_gid in groups else 0)
    return bits & 0o6 == 0o6


def _own_name() -> str:
    try:
        return pwd.getpwuid(os.geteuid()).pw_name
    except KeyError:
        return str(os.geteuid())


def _group_name(gid: int) -> str:
    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return str(gid)


def processes(proc: Path) -> Iterator[tuple[Process, Path]]:
    """Every process and its folder."""
    for folder in proc.iterdir():
        if folder.name.isdecimal():
            try:
                words = (folder / "cmdline").read_bytes().decode(errors="replace").split("\0")
            except OSError:
                continue
            yield Process(int(folder.name), [word for word in words if word]), folder


def holders(device: str, proc: Path = Path("/proc")) -> Iterator[Process]:
    """The processes that have the device open, as far as we may see: other users' only root may."""
    end = time.monotonic() + SCAN_S
    for process, folder in processes(proc):
        if process.pid == os.getpid():
            continue
        with contextlib.suppress(OSError):
            for descriptor in (folder / "fd").iterdir():
                with contextlib.suppress(OSError):
                    if str(descriptor.readlink()) == device:
                        yield process
                        break
        if time.monotonic() > end:
            return


def _held(path: str, held: list[Process]) -> list[Finding]:
    strangers = [each for each in held if not each.is_up()]
    if strangers:
        who = "; ".join(f"pid {each.pid} ({each.command})" for each in strangers)
        return [topics.HOLDER.wrong(f"{path} is held by {who}", _release(strangers[0]))]
    if len(held) > 1:
        who = ", ".join(f"pid {each.pid}" for each in held)
        return [topics.HOLDER.wrong(f"{path} is held by two 'zmav up': {who}", f"end one of them: kill {held[0].pid}")]
    if held:
        return [topics.HOLDER.well(f"held by zmav up (pid {held[0].pid})")]
    whose = "" if os.geteuid() == 0 else ", as far as can be seen (root sees all)"
    return [topics.HOLDER.well(f"nobody has it open{whose}")]


def _release(process: Process) -> str:
    name = Path(process.words[0]).name if process.words else ""
    if "getty" in name or name == "login":
        return "a login waits there: sudo systemctl disable --now serial-getty@PORT (PORT as ttyAMA0)"
    if name == "ModemManager":
        return "sudo systemctl mask --now ModemManager"
    return f"stop it: kill {process.pid}, or sudo systemctl disable --now its unit (systemctl status {process.pid})"


def _console(real: str, held: list[Process], proc: Path) -> Iterator[Finding]:
    """By what the kernel says of itself: /proc/consoles are those in use, one a line."""
    try:
        lines = (proc / "consoles").read_text(errors="replace").splitlines()
    except OSError:
        return
    name = Path(real).name
    if any(line.split()[:1] == [name] for line in lines):
        advice = (
            f"take console={name} (or serial0) out of the kernel's command line (/boot/firmware/cmdline.txt on a "
            f"Raspberry Pi), sudo systemctl disable --now serial-getty@{name}, and restart"
        )
        yield topics.CONSOLE.wrong(f"{real} is the kernel's console", advice)


def look_for_modem_manager(
    real: str, mode: os.stat_result, proc: Path, udev: Path = Path("/run/udev/data")
) -> Iterator[Finding]:
    if not USB.match(Path(real).name):
        return
    running = next((p for p, _ in processes(proc) if p.words and Path(p.words[0]).name == "ModemManager"), None)
    if running is None:
        return
    number = f"c{os.major(mode.st_rdev)}:{os.minor(mode.st_rdev)}"
    with contextlib.suppress(OSError):
        if any(line in IGNORED for line in (udev / number).read_text(errors="replace").splitlines()):
            return
    advice = 'sudo systemctl mask --now ModemManager, or a udev rule with ENV{ID_MM_DEVICE_IGNORE}="1" for the device'
    yield topics.MODEM.advise(f"ModemManager (pid {running.pid}) probes {real} when it is plugged in", advice)
