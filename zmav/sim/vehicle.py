"""One vehicle of the world, as a test, a command line or a script sees it."""

from __future__ import annotations

import math

import msgspec

from zmav.errors import BadInput
from zmav.sim.autopilots.arducopter import ArduCopter
from zmav.sim.control.setpoints import Vector
from zmav.sim.endpoints import Endpoint
from zmav.sim.protocol.node import MavNode


class VehicleStatus(msgspec.Struct, frozen=True):
    """A snapshot. ``ned_m``: true position in the world's NED, metres; ``height_m`` above home; ``links``: open
    channels.
    """

    name: str
    sysid: int
    url: str
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


class SimVehicle:
    """A simulated vehicle: its addresses, its pilot, and its state."""

    def __init__(self, name: str, copter: ArduCopter, node: MavNode) -> None:
        self.name = name
        self.copter = copter
        self.node = node
        self.endpoints: list[Endpoint] = []

    @property
    def sysid(self) -> int:
        return self.node.sysid

    @property
    def uid(self) -> int:
        return self.node.uid

    @property
    def urls(self) -> list[str]:
        """Link URLs that reach this vehicle, in the order of its endpoints."""
        return [endpoint.url for endpoint in self.endpoints]

    @property
    def url(self) -> str:
        """The first of :attr:`urls`; BadInput for a vehicle without endpoints."""
        if not self.endpoints:
            raise BadInput(
                f"{self.name} has no open endpoint", field="endpoints", value=None, expected="an opened world"
            )
        return self.endpoints[0].url

    def pilot_mode(self, name: str, *, throttle: float = 0.5) -> None:
        """The pilot turns the mode switch to ``name``, with a hand on the throttle stick (0..1; its middle holds the
        height).

        Only the modes of FLTMODE1 to FLTMODE6 are on the switch; BadInput names them.
        """
        copter = self.copter
        on_switch = {}
        for position in range(1, 7):
            mode = copter.modes.get(int(copter.params[f"FLTMODE{position}"]))
            if mode is not None:
                on_switch[mode.name] = position
        if name not in on_switch:
            expected = ", ".join(on_switch)
            raise BadInput(
                f"{name} is not on the mode switch; there are {expected}", field="mode", value=name, expected=expected
            )
        copter.pilot.sticks(throttle=throttle)
        copter.pilot.turn_switch(on_switch[name])

    def status(self) -> VehicleStatus:
        copter, s = self.copter, self.copter.sense
        capacity = max(copter.params["BATT_CAPACITY"], 1.0)
        return VehicleStatus(
            name=self.name,
            sysid=self.sysid,
            url=self.endpoints[0].url if self.endpoints else "",
            mode=copter.mode.name,
            armed=copter.armed,
            landed=copter.landed,
            ready=copter.position_ok,
            ned_m=(s.true_north, s.true_east, s.true_down),
            height_m=copter.home_world[2] - s.true_down,
            speed_mps=math.sqrt(s.vn * s.vn + s.ve * s.ve + s.vd * s.vd),
            heading_deg=math.degrees(s.yaw) % 360.0,
            battery_pct=max(round(100.0 * (1.0 - copter.consumed_mah / capacity)), 0),
            links=len(self.node.channels),
        )
