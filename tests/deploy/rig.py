"""Hosts of ``deploy/wifi`` as namespaces of this machine, in each of which the real systemd-networkd reads its files.

A cable (veth) plays the air. Nothing has a name outside: namespaces end with the processes that hold them.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import time
import uuid
from collections.abc import Iterator, Sequence
from ipaddress import ip_interface
from pathlib import Path
from typing import Any

import pytest

from mesh.lab import kernel
from tests.deploy.networks import files

NETWORKD = Path("/lib/systemd/systemd-networkd")
SETTINGS = Path("/etc/systemd/network")
# A read-only /sys tells networkd that no udev is there to wait for; its files lie in a /run of its own. A bridge's
# hardware address follows from the machine's id, so each host has its own.
PREPARE = """
mount -t sysfs -o ro sysfs /sys && mount -t tmpfs tmpfs /run && mkdir -p /run/systemd/netif
chown -R systemd-network /run/systemd/netif && mount --bind "$0" /etc/systemd/network
mount --bind "$0.id" /etc/machine-id && ip link set lo up && exec cat
"""
DEADLINE_S = 90.0


def check_able() -> None:
    """Skip, with the reason, where this cannot be played."""
    if os.geteuid() != 0:
        pytest.skip("needs root: network namespaces")
    for program in ("ip", "unshare", "nsenter", "mount"):
        if shutil.which(program) is None:
            pytest.skip(f"needs the program {program}")
    if not NETWORKD.exists() or not SETTINGS.is_dir() or not Path("/etc/machine-id").exists():
        pytest.skip("needs systemd-networkd")
    if subprocess.run(["unshare", "--net", "--mount", "true"], capture_output=True, check=False).returncode:
        pytest.skip("may not make namespaces here")


class Place:
    """One host: namespaces, its part of /etc/systemd/network, and the networkd that reads it."""

    def __init__(self, name: str, settings: Path) -> None:
        self.name = name
        settings.with_name(f"{settings.name}.id").write_text(uuid.uuid4().hex)
        self._holder = subprocess.Popen(
            ["unshare", "--net", "--mount", "sh", "-c", PREPARE, str(settings)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            preexec_fn=_die_with_us,
        )
        assert self._holder.stdin is not None
        assert self._holder.stdout is not None
        self._holder.stdin.write(b"ready\n")
        self._holder.stdin.flush()
        assert self._holder.stdout.readline() == b"ready\n", f"{name}: no namespaces"
        self.pid = self._holder.pid
        self._started = [self._holder]
        self.log = settings.with_suffix(".log")

    def inside(self, *command: str) -> list[str]:
        """The command, to be run in here."""
        return ["nsenter", "-t", str(self.pid), "-n", "-m", "--", *command]

    def run(self, *command: str, check: bool = True) -> str:
        """What a command in here prints."""
        done = subprocess.run(self.inside(*command), capture_output=True, text=True, timeout=60, check=False)
        assert not check or done.returncode == 0, f"{self.name}: {command}: {done.stdout}{done.stderr}"
        return done.stdout

    def start(self, *command: str, log: Path | None = None, **environment: str) -> subprocess.Popen[bytes]:
        """A program in here, which ends with us."""
        with (log or self.log.with_suffix(f".{Path(command[0]).name}")).open("ab") as file:
            process = subprocess.Popen(
                self.inside(*command),
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=file,
                env={**os.environ, **environment},
                preexec_fn=_die_with_us,
            )
        self._started.append(process)
        return process

    def configure(self) -> None:
        """Have networkd read the files."""
        self.start(str(NETWORKD), log=self.log, SYSTEMD_LOG_LEVEL="info", SYSTEMD_LOG_TARGET="console")

    def addresses(self) -> set[tuple[str, str]]:
        """(interface, address) as the kernel has them."""
        links: list[dict[str, Any]] = json.loads(self.run("ip", "-j", "-4", "addr"))
        return {
            (link["ifname"], str(ip_interface(f"{each['local']}/{each['prefixlen']}")))
            for link in links
            for each in link.get("addr_info", ())
        }

    def await_address(self, interface: str, address: str) -> None:
        """Return once networkd has set it."""
        until(lambda: (interface, address) in self.addresses(), f"{self.name}: {address} on {interface}", self.log)

    def end(self) -> None:
        for process in reversed(self._started):
            process.send_signal(signal.SIGTERM)
        for process in self._started:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(5)
            process.kill()
            process.wait()


def lay(layout: str, folders: Sequence[str], directory: Path) -> Path:
    """What the folders have for networkd, copied as their README says."""
    directory.mkdir()
    for place, path in files(layout, tuple(folders)).items():
        if place.startswith("systemd/network/"):
            target = directory / place.removeprefix("systemd/network/")
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)
    return directory


def _die_with_us() -> None:
    kernel.die_with_parent(signal.SIGKILL)


def until(there: Any, what: str, log: Path | None = None) -> None:
    """Ask until it is so; AssertionError, with the end of a log, where it does not come."""
    last = time.monotonic() + DEADLINE_S
    while not there():
        if time.monotonic() > last:
            raise AssertionError(f"{what}: not there; {log.read_text()[-2000:] if log and log.exists() else ''}")
        time.sleep(0.05)


def cable(a: Place, a_name: str, b: Place, b_name: str) -> None:
    """Join two interfaces that are made for it; both are up as soon as somebody brings them up."""
    command = f"ip link add {a_name} netns {a.pid} type veth peer name {b_name} netns {b.pid}"
    subprocess.run(command.split(), check=True, capture_output=True, timeout=20)


def client(ap: Place, number: int, other: Place, interface: str) -> None:
    """What hostapd does for a four-address client, and for a plain one as far as the bridge is concerned."""
    name = f"wlan0.sta{number}"
    cable(ap, name, other, interface)
    until(lambda: '"br0"' in ap.run("ip", "-j", "link"), f"{ap.name}: br0", ap.log)
    ap.run("ip", "link", "set", name, "master", "br0", "up")


@contextlib.contextmanager
def places(layout: str, hosts: dict[str, Sequence[str]], directory: Path) -> Iterator[dict[str, Place]]:
    """The hosts of a layout, by name; all is gone at the end."""
    made: dict[str, Place] = {}
    try:
        for name, folders in hosts.items():
            made[name] = Place(name, lay(layout, folders, directory / name))
        yield made
    finally:
        for place in made.values():
            place.end()
