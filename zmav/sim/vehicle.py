"""One vehicle of the world, as a test, a command line or a script sees it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TypeVar

from zmav.errors import BadInput
from zmav.sim.autopilots.arducopter.copter import ArduCopter
from zmav.sim.autopilots.ardupilot.vehicle import ArduVehicle
from zmav.sim.autopilots.arduplane.plane import ArduPlane
from zmav.sim.autopilots.ardurover.rover import ArduRover
from zmav.sim.autopilots.px4.copter import Px4Copter
from zmav.sim.autopilots.px4.modes import SWITCH
from zmav.sim.endpoints import Endpoint
from zmav.sim.protocol.base import Node
from zmav.sim.spec import ARDUCOPTER, ARDUPLANE, ARDUROVER, PX4, VehicleSpec, airframe_of, kind_of
from zmav.sim.status import VehicleStatus

CHANNELS, NARROWEST, WIDEST = 8, 800, 2200
Autopilot = ArduCopter | ArduPlane | ArduRover | Px4Copter
A = TypeVar("A", bound=ArduVehicle | Px4Copter)


class SimVehicle:
    """A simulated vehicle: its addresses, its pilot, and its state."""

    def __init__(self, spec: VehicleSpec, brain: Autopilot, node: Node) -> None:
        self.spec = spec
        self.name = spec.name or ""
        self.brain = brain
        self.node = node
        self.endpoints: list[Endpoint] = []
        self.failed: Exception | None = None
        """the defect that stopped its autopilot for good"""

    @property
    def copter(self) -> ArduCopter:
        """The ArduCopter that flies it; BadInput where anything else does."""
        return self._flown_by(ArduCopter, "copter", "an ArduCopter")

    @property
    def rover(self) -> ArduRover:
        """The ArduRover that drives it; BadInput where anything else does."""
        return self._flown_by(ArduRover, "rover", "an ArduRover")

    @property
    def plane(self) -> ArduPlane:
        """The ArduPlane that flies it; BadInput where anything else does."""
        return self._flown_by(ArduPlane, "plane", "an ArduPlane")

    @property
    def ardupilot(self) -> ArduVehicle:
        """What every ArduPilot has; BadInput where a PX4 flies it."""
        return self._flown_by(ArduVehicle, "ardupilot", "an ArduPilot")  # type: ignore[type-abstract]  # isinstance takes it

    @property
    def px4(self) -> Px4Copter:
        """The PX4 that flies it; BadInput where anything else does."""
        return self._flown_by(Px4Copter, "px4", "a PX4")

    def _flown_by(self, kind: type[A], field: str, expected: str) -> A:
        if isinstance(self.brain, kind):
            return self.brain
        names = {ARDUCOPTER: "an ArduCopter", ARDUROVER: "an ArduRover", ARDUPLANE: "an ArduPlane", PX4: "a PX4"}
        found = self.spec.autopilot
        raise BadInput(f"{self.name} is {names[found]}", field=field, value=found, expected=expected)

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

    # ---- the pilot

    def hands(self, mode: str | None, channels: Mapping[int, int]) -> None:
        """The pilot turns the mode switch, and sets channels (1 to 8) to pulse widths in us. On a PX4, either turns the
        radio on, with its throttle stick in the middle.
        """
        for channel, pwm in channels.items():
            if not (1 <= channel <= CHANNELS and NARROWEST <= pwm <= WIDEST):
                expected = f"channels 1 to {CHANNELS} at {NARROWEST} to {WIDEST} us"
                raise BadInput.wrong("channels", (channel, pwm), expected, f"channel {channel} at {pwm} us")
        if mode is not None:
            self.pilot_mode(mode)
        pilot = self.brain.pilot
        if not pilot.radio:
            pilot.radio = True
            pilot.sticks(throttle=0.5)
        for channel, pwm in channels.items():
            pilot.flip(channel, pwm)

    def pilot_mode(self, name: str) -> None:
        """The pilot turns the mode switch to ``name``, with the throttle stick in its middle, which holds the height.

        Only the modes of FLTMODE1 to FLTMODE6 (MODE1 to 6, COM_FLTMODE1 to 6) are on the switch; BadInput names them.
        On a PX4 it turns the radio on.
        """
        brain = self.brain
        if isinstance(brain, Px4Copter):
            names = {number: mode.name for number, mode in SWITCH.items()}
            prefix = "COM_FLTMODE"
        else:
            names = {number: mode.name for number, mode in brain.modes.items()}
            prefix = brain.MODE_PARAM
        numbers = ((position, int(brain.params[f"{prefix}{position}"])) for position in range(1, 7))
        on_switch = {names[number]: position for position, number in numbers if number in names}
        if name not in on_switch:
            expected = ", ".join(on_switch) or "no mode"
            text = f"{name} is not on the mode switch; there are {expected}"
            raise BadInput(text, field="mode", value=name, expected=expected)
        brain.pilot.radio = True
        brain.pilot.sticks(throttle=0.5)
        brain.pilot.turn_switch(on_switch[name])

    def status(self) -> VehicleStatus:
        copter, s = self.brain, self.brain.sense
        return VehicleStatus(
            name=self.name,
            sysid=self.sysid,
            kind=kind_of(self.spec),
            autopilot=self.spec.autopilot,
            airframe=airframe_of(self.spec),
            url=self.endpoints[0].url if self.endpoints else "",
            urls=tuple(self.urls),
            mode=copter.mode.name,
            armed=copter.armed,
            landed=copter.landed,
            ready=copter.position_ok,
            ned_m=(s.true_north, s.true_east, s.true_down),
            height_m=copter.home_world[2] - s.true_down,
            speed_mps=math.sqrt(s.vn * s.vn + s.ve * s.ve + s.vd * s.vd),
            heading_deg=math.degrees(s.yaw) % 360.0,
            battery_pct=round(100.0 * copter.battery_left),
            links=len(self.node.channels),
            failed=None if self.failed is None else repr(self.failed),
        )
