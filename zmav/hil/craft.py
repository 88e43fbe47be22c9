"""How flight stacks drive the simulator's airframes: which output moves what, and how a stack is told its frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import msgspec
import numpy as np

from zmav.errors import BadConfig
from zmav.sim.air import density
from zmav.sim.arrays import Array
from zmav.sim.dynamics.airframe import airframe
from zmav.sim.dynamics.battery import Pack
from zmav.sim.dynamics.body import Body
from zmav.sim.dynamics.copter import CopterDynamics
from zmav.sim.dynamics.plane import PlaneDynamics
from zmav.sim.dynamics.rover import RoverDynamics
from zmav.sim.dynamics.roverframe import CAR
from zmav.sim.dynamics.wing import TRAINER
from zmav.sim.fleets.base import Fleet

PWM_LOW, PWM_MIDDLE, PWM_SPAN, PWM_HALF = 1000.0, 1500.0, 1000.0, 500.0  # microseconds
COPTER, ROVER, PLANE = "arducopter", "ardurover", "arduplane"


class OutputChannel(msgspec.Struct, frozen=True):
    """One actuator on an ArduPilot servo output (0, 1, ...): ``both_ways`` -1 to 1 about 1500 us, else 0 to 1 from
    1000 us.
    """

    number: int
    both_ways: bool = False

    def value(self, pwm: Sequence[int]) -> float:
        """What the actuator is told; an output without pulses (0) tells it nothing."""
        width = pwm[self.number]
        if width == 0:
            return 0.0
        if self.both_ways:
            return min(max((width - PWM_MIDDLE) / PWM_HALF, -1.0), 1.0)
        return min(max((width - PWM_LOW) / PWM_SPAN, 0.0), 1.0)


class Craft(msgspec.Struct, frozen=True, kw_only=True):
    """An airframe as flight stacks see it.

    ``program``: the ArduPilot binary that flies it; ``channels``: its actuators, in the order of the values of
    :func:`drive`; ``defaults``: parameter files of its source tree, in Tools/autotest; ``params``: what differs from
    them. ``px4``: which HIL_ACTUATOR_CONTROLS entry feeds each actuator; none where PX4 does not fly it here.
    ``px4_airframe``: SYS_AUTOSTART of PX4's SITL frame that matches, 0 where there is none; ``px4_rate_k``: the share
    of that frame's rate gains that it is flown with. ``air_data``: it has a pitot tube.
    """

    name: str
    program: str = COPTER
    channels: tuple[OutputChannel, ...]
    defaults: tuple[str, ...] = ("default_params/copter.parm",)
    params: Mapping[str, float]
    px4: tuple[int, ...] = ()
    px4_airframe: int = 0
    px4_rate_k: float = 1.0
    air_data: bool = False

    def make(self, start: Array, yaw: Array, dt: float) -> tuple[Body, Pack]:
        """Its body at ``start`` (3, 1) m NED with ``yaw`` (1,) rad, stepped every ``dt`` seconds; and its battery."""
        if self.program == ROVER:
            return RoverDynamics(CAR, start, yaw, dt), CAR.pack
        if self.program == PLANE:
            return PlaneDynamics(TRAINER, start, yaw, dt), TRAINER.pack
        copter = airframe(self.name)
        return CopterDynamics(copter, start, yaw, dt), copter.pack

    @property
    def px4_params(self) -> Mapping[str, float]:
        """Where PX4's motors are, for its mixer: the Iris that it takes this for has its rear ones closer together. It
        is also told the thrust curve, the share of full thrust that hovers, and rate gains: each body has each of them,
        as a directory that is kept has those of the body before.
        """
        frame = airframe(self.name)
        placed = {f"CA_ROTOR{i}": rotor for i, rotor in zip(self.px4, frame.rotors, strict=True)}
        places = {
            f"{motor}_{axis}": round(metres, 3)
            for motor, rotor in sorted(placed.items())
            for axis, metres in (("PX", rotor.forward_m), ("PY", rotor.right_m))
        }
        rates = {f"MC_{axis}RATE_K": self.px4_rate_k for axis in ("ROLL", "PITCH", "YAW")}
        hover = round(frame.hover_share, 2)
        return {**places, **rates, "THR_MDL_FAC": frame.thrust_expo, "MPC_THR_HOVER": hover}

    def from_pwm(self, pwm: Sequence[int]) -> list[float]:
        """Actuator values of ArduPilot's servo outputs."""
        return [channel.value(pwm) for channel in self.channels]

    def from_px4(self, controls: Sequence[float]) -> list[float]:
        """Actuator values of PX4's controls; an output that is off (NaN) is 0."""
        values = [controls[i] for i in self.px4]
        return [min(max(value, 0.0), 1.0) if value == value else 0.0 for value in values]


def drive(body: Body, values: Sequence[float]) -> None:
    """Set the actuators of a body for one: rotors; steering and throttle; or aileron, elevator, throttle and rudder."""
    columns = np.array(values)[:, None]
    if isinstance(body, PlaneDynamics):
        body.surface, body.throttle = columns[[0, 1, 3]], columns[2]
    elif not isinstance(body, RoverDynamics):
        assert isinstance(body, CopterDynamics)
        body.throttle = columns
    else:
        body.steering, body.throttle = columns


def settle(fleet: Fleet) -> None:
    """Let what changes slowly follow the height and the battery."""
    body = fleet.dynamics
    assert isinstance(body, CopterDynamics | PlaneDynamics | RoverDynamics)
    if not isinstance(body, RoverDynamics):
        body.density = density(fleet.around.place.alt_amsl_m - body.pos[2])
    if isinstance(body, CopterDynamics):
        body.supply = fleet.battery.volts / body.airframe.battery_v
        fleet.sensors.throttle[:] = body.throttle.mean(0)
    else:
        fleet.sensors.throttle[:] = np.abs(body.throttle)


def _rotors(*numbers: int) -> tuple[OutputChannel, ...]:
    return tuple(OutputChannel(number) for number in numbers)


# Motor numbers: ardupilot.org, "Connect ESCs and Motors"; docs.px4.io, "Airframes Reference". Rotors here are in the
# order of zmav.sim.dynamics.airframe: the "+" right, left, front, rear; rings clockwise from right of the nose.
_QUAD_PLUS, _QUAD_X, _HEXA_X = (0, 1, 2, 3), (0, 3, 1, 2), (4, 0, 3, 5, 1, 2)
_DRIVE = (OutputChannel(0, both_ways=True), OutputChannel(2, both_ways=True))
# Steps a second where loops run at 50 Hz: a third of what ArduPilot asks for by itself, and as good.
_SLOW = {"SIM_RATE_HZ": 400}
_CRAFTS = (
    Craft(
        name="quad",
        channels=_rotors(0, 1, 2, 3),
        params={"FRAME_CLASS": 1, "FRAME_TYPE": 0},
        px4=_QUAD_PLUS,
        px4_airframe=10016,
        px4_rate_k=0.4,  # full rotors turn it three times as fast as PX4's own body
    ),
    Craft(name="hexa", channels=_rotors(*_HEXA_X), params={"FRAME_CLASS": 2, "FRAME_TYPE": 1}, px4=_HEXA_X),
    Craft(
        name="sih",
        channels=_rotors(*_QUAD_X),
        params={"FRAME_CLASS": 1, "FRAME_TYPE": 1, "MOT_THST_EXPO": 0.0, "MOT_THST_HOVER": 0.49},
        px4=_QUAD_X,
        px4_airframe=10016,
    ),
    Craft(name="rover", program=ROVER, channels=_DRIVE, defaults=("default_params/rover.parm",), params=_SLOW),
    Craft(
        name="plane",
        program=PLANE,
        channels=(
            OutputChannel(0, both_ways=True),
            OutputChannel(1, both_ways=True),
            OutputChannel(2),
            OutputChannel(3, both_ways=True),
        ),
        defaults=("models/plane.parm",),
        # The elevator up, and the rudder to the right, by longer pulses.
        params={"SERVO2_REVERSED": 0, "SERVO4_REVERSED": 0, **_SLOW},
        air_data=True,
    ),
)


def craft(name: str) -> Craft:
    """The airframe of that name; :class:`BadConfig` names the known ones."""
    known = {each.name: each for each in _CRAFTS}
    if name not in known:
        expected = ", ".join(known)
        raise BadConfig(f"no airframe {name!r}; known: {expected}", field="airframe", value=name, expected=expected)
    return known[name]
