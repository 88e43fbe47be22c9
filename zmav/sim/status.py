"""What a world tells of itself and its vehicles at one moment: for ``zmav sim status`` and tests."""

from __future__ import annotations

import msgspec

Vector = tuple[float, float, float]


class HilLoop(msgspec.Struct, frozen=True):
    """The loop with a flight controller on its own hardware, counted since the world began. ``dropped``: readings that
    the line had no room for; ``bad``: frames of it that could not be read; ``longest_s``: wall seconds between two
    controls, at most, since it last went to HIL.
    """

    readings: int
    controls: int
    dropped: int
    bad: int
    longest_s: float


class VehicleStatus(msgspec.Struct, frozen=True, kw_only=True):
    """One vehicle. ``ned_m``: true position in the world's NED, metres; ``height_m`` above home; ``links``: open
    channels, whether anybody is at their other end or not; ``failed``: the defect that stopped its autopilot for good;
    ``loop``: of a vehicle whose autopilot is on its own hardware.
    """

    name: str
    sysid: int
    kind: str = "external"
    autopilot: str
    airframe: str
    url: str
    urls: tuple[str, ...] = ()
    mode: str
    armed: bool
    landed: bool
    ready: bool
    ned_m: Vector
    height_m: float
    speed_mps: float
    heading_deg: float
    battery_pct: int
    links: int
    faults: tuple[str, ...] = ()
    failed: str | None = None
    loop: HilLoop | None = None

    @property
    def flying(self) -> bool:
        """In the air; a rover never is."""
        return self.armed and not self.landed and self.kind != "rover"


class WorldStatus(msgspec.Struct, frozen=True, kw_only=True):
    """The world: simulated seconds; the speed asked for, times real time (None: as fast as it goes), and the one
    reached lately; whether it stands still, or falls behind what was asked; and every vehicle.
    """

    time_s: float
    speed: float | None
    speed_reached: float
    paused: bool = False
    behind: bool = False
    lockstep: bool = False
    vehicles: tuple[VehicleStatus, ...]
