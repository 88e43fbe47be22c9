"""What ``zmav doctor`` says of a computer: our own, and those that answer ``host``."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Sequence

from zmav import host, wire
from zmav.doctor import topics
from zmav.doctor.findings import Finding
from zmav.doctor.words import few

MB, GB = 1 << 20, 1 << 30
DISK_RED, DISK_AMBER = 256 * MB, 2 * GB
MEMORY_RED, MEMORY_AMBER = 64 * MB, 0.1
BUSY = 1.5
"""processes a core"""
HOT = 80.0
"""°C"""
THROTTLES = ("under-voltage", "processor capped", "processor throttled", "soft temperature limit")
"""by the firmware's bits; those of what was since the start are 16 higher"""


def check_bits() -> Iterator[Finding]:
    """Nothing on a 64-bit system; a 32-bit one may run on a 64-bit kernel, so the kernel is not asked."""
    if sys.maxsize < 2**32:
        advice = "install the 64-bit system (Raspberry Pi OS comes as both) and zmav on it"
        yield topics.COMPUTER.wrong("64-bit only: this Python is 32-bit, for which packages have no wheels", advice)


def check_packages(packages: Sequence[str] = host.PACKAGES) -> Iterator[Finding]:
    """Python and the packages that carry zmav."""
    found = host.versions()
    missing = [name for name in packages if name not in found]
    if missing:
        yield topics.PACKAGES.wrong(f"not installed: {', '.join(missing)}", "install zmav with its dependencies")
    yield topics.PACKAGES.well(", ".join(f"{name} {number}" for name, number in found.items()))


def check_host(told: wire.HostReport, who: str = "") -> Iterator[Finding]:
    """A line that sums up, and one for each trouble."""
    yield topics.COMPUTER.well(_summary(told), who)
    for disk in told.disks:
        yield from _disk(disk, who)
    yield from _memory(told, who)
    if told.load is not None and told.load > BUSY * max(told.cpus, 1):
        yield topics.LOAD.advise(
            f"{told.load:.1f} processes want {told.cpus} cores",
            "see what is busy: top; a planner or a camera belongs on another host",
            who,
        )
    if told.temperature is not None and told.temperature >= HOT:
        yield topics.HEAT.advise(f"{told.temperature:.0f} °C", "give it a heat sink or air", who)
    yield from _power(told, who)
    if told.clock_synced is False:
        yield topics.TIME.advise(
            "nothing keeps the clock: no NTP, GPS or PTP",
            "run chrony (timedatectl shows whether it works); without an uplink, let all hosts follow one",
            who,
        )


def _summary(told: wire.HostReport) -> str:
    parts = [told.system, *(f"{disk.path} {_bytes(disk.free)} free" for disk in told.disks)]
    if told.memory is not None:
        parts.append(f"memory {_bytes(told.memory)} free")
    if told.load is not None:
        parts.append(f"load {told.load:.1f} of {told.cpus}")
    if told.temperature is not None:
        parts.append(f"{told.temperature:.0f} °C")
    if told.clock_synced:
        error = "" if told.clock_error is None else f" within {1e3 * told.clock_error:.0f} ms"
        parts.append(f"clock kept{error}")
    return ", ".join(parts)


def _disk(disk: wire.Disk, who: str) -> Iterator[Finding]:
    if disk.read_only:
        advice = (
            "a card that became read-only is worn out: replace it; or remount: sudo mount -o remount,rw " + disk.path
        )
        yield topics.DISK.wrong(f"{disk.path} is mounted read-only", advice, who)
        return
    found = f"{_bytes(disk.free)} free of {_bytes(disk.size)} at {disk.path}"
    if disk.free < DISK_RED:
        advice = f"delete old recordings and logs, or move them: du -xh {disk.path} | sort -h | tail"
        yield topics.DISK.wrong(found, advice, who)
    elif disk.free < DISK_AMBER:
        yield topics.DISK.advise(found, "make room before the next recording", who)


def _memory(told: wire.HostReport, who: str) -> Iterator[Finding]:
    if told.memory is None:
        return
    found = f"{_bytes(told.memory)} free"
    if told.memory < MEMORY_RED:
        yield topics.MEMORY.wrong(found, "see what takes it, and end that: ps aux --sort -rss | head", who)
    elif told.memory_size and told.memory < MEMORY_AMBER * told.memory_size:
        yield topics.MEMORY.advise(found, "see what takes it: ps aux --sort -rss | head", who)


def _power(told: wire.HostReport, who: str) -> Iterator[Finding]:
    bits = told.throttled or 0
    now = [words for bit, words in enumerate(THROTTLES) if bits >> bit & 1]
    if told.under_voltage and THROTTLES[0] not in now:
        now.insert(0, THROTTLES[0])
    before = [words for bit, words in enumerate(THROTTLES) if bits >> bit + 16 & 1 and words not in now]
    supply = "power it by a converter of its own, with short, thick leads"
    if now:
        yield topics.POWER.wrong(f"now: {', '.join(now)}", f"{supply}; where it is hot, cool it", who)
    elif before:
        yield topics.POWER.advise(f"since it started: {', '.join(before)}", f"{supply}; where it is hot, cool it", who)


def _bytes(number: float) -> str:
    for unit, size in (("TB", 1 << 40), ("GB", GB), ("MB", MB)):
        if number >= size:
            return f"{number / size:.3g} {unit}" if number < 100 * size else f"{number / size:.0f} {unit}"
    return f"{number / 1024:.0f} kB"


def check_versions(told: dict[str, wire.HostReport | dict[str, str]]) -> Iterator[Finding]:
    """zmav and Zenoh of all hosts that told theirs, and our own."""
    hosts = {who: each.versions if isinstance(each, wire.HostReport) else each for who, each in told.items()}
    hosts["here"] = host.versions()
    for package in ("zmav", "eclipse-zenoh"):
        by_version: dict[str, list[str]] = {}
        for who, versions in hosts.items():
            if package in versions:
                by_version.setdefault(versions[package], []).append(who)
        if len(by_version) < 2:
            yield from (
                topics.VERSIONS.well(f"{number} on {_count(whose)}", package) for number, whose in by_version.items()
            )
            continue
        found = "; ".join(f"{number}: {few(sorted(whose), 5)}" for number, whose in sorted(by_version.items()))
        minor = {tuple(number.split(".")[:2]) for number in by_version}
        if package == "eclipse-zenoh" and len(minor) == 1:
            yield topics.VERSIONS.advise(found, "install one version everywhere when there is time", package)
            continue
        newest = max(by_version, key=_order)
        older = sorted(who for number, whose in by_version.items() if _order(number) < _order(newest) for who in whose)
        advice = f"install one version everywhere: pip install {package}=={newest}"
        if package == "zmav" and older:
            advice = (
                f"install one version everywhere: {_on(older)} pip install zmav=={newest}, where it is a service 'sudo "
                "zmav install', too; until then the older one refuses orders and fields that came later"
            )
            found = f"{_who(older, by_version, newest)} ({found})"
        yield topics.VERSIONS.wrong(found, advice, package)


def _order(number: str) -> tuple[int, ...]:
    """Of a version; what stands behind its three numbers (rc1, .dev0, +local) makes none older."""
    return tuple(map(int, re.findall(r"\d{1,9}", re.split(r"[^\d.]", number)[0])[:3]))


def _on(older: list[str]) -> str:
    return "here" if older == ["here"] else f"on {few(older, 5)}"


def _who(older: list[str], by_version: dict[str, list[str]], newest: str) -> str:
    """``quad2 runs zmav 0.1.0, this is 0.2.0``."""
    versions = {who: number for number, whose in by_version.items() for who in whose}
    each = ", ".join(f"{'this computer' if who == 'here' else who} runs zmav {versions[who]}" for who in older[:5])
    more = f" and {len(older) - 5} more an older one" if len(older) > 5 else ""
    there = f"the newest is {newest} on {few(sorted(by_version[newest]), 3)}"
    return f"{each}{more}: {f'this is {newest}' if versions['here'] == newest else there}"


def _count(whose: list[str]) -> str:
    return "this host" if len(whose) == 1 else f"this host and {len(whose) - 1} that tell"
