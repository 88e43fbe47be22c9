"""What a host tells of its computer: asked for, never streamed."""

from __future__ import annotations

from zmav.wire.base import Told


class Disk(Told, kw_only=True):
    """One file system, by a path on it."""

    path: str
    free: int
    """bytes that a user may still write"""
    size: int
    read_only: bool = False


class HostReport(Told, kw_only=True):
    """A computer's health; what it does not tell is None."""

    t: float
    name: str
    instance: str
    """of the process that answers"""
    versions: dict[str, str]
    """of Python, zmav and what carries it"""
    system: str
    """kernel and architecture"""
    cpus: int
    disks: list[Disk] = []
    load: float | None = None
    """processes that want a core, mean of the last minute"""
    memory: int | None = None
    """bytes that programs can still have"""
    memory_size: int | None = None
    temperature: float | None = None
    """°C of the hottest thermal zone"""
    throttled: int | None = None
    """the Raspberry Pi firmware's bits: 0 under-voltage, 1 capped, 2 throttled, 3 soft limit; + 16: since it started"""
    under_voltage: bool | None = None
    """now, by the kernel's sensor"""
    clock_synced: bool | None = None
    """something keeps the clock: NTP, GPS, PTP"""
    clock_error: float | None = None
    """s that the kernel reckons its clock can be wrong by, where it is kept"""
