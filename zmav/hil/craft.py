"""How flight stacks drive the simulator's airframes: which output moves what, and how a stack is told its frame."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

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
from zmav.sim.dynamics.roverframe import rover_frame
from zmav.sim.dynamics.wing import wing
from zmav.sim.environment import Environment
from zmav.sim.fleets.base import Fleet

PWM_LOW, PWM_MIDDLE, PWM_SPAN, PWM_HALF = 1000.0, 1500.0, 1000.0, 500.0  # microseconds

MakeBody = Callable[[Array, Array, float, Environment], Body]
Drive = Callable[[Body, Sequence[float]], None]
Settle = Callable[[Fleet], None]


class Channel(msgspec.Struct, frozen=True):
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

    ``make``: start (3, 1), yaw (1,), step and environment -> the body. ``drive``: sets the body's inputs from the
    actuators' values, in the order of ``channels``. ``settle``: what changes slowly, with the height and the battery.
    ``program``: the ArduPilot binary that flies it; ``model``: its own physics nearest to this;
    ``defaults``: parameter files of its source tree, in Tools/autotest; ``params``: what differs from them. ``px4``:
    which HIL_ACTUATOR_CONTROLS entry feeds each actuator; none where PX4 does not fly it here. ``px4_airframe``:
    SYS_AUTOSTART of PX4's SITL frame that matches, 0 where there is none; ``px4_params``: what differs from it.
    ``air_data``: it has a pitot tube.
    """

    name: str
    make: MakeBody
    drive: Drive
    settle: Settle
    pack: Pack
    channels: tuple[Channel, ...]
    program: str
    model: str
    defaults: tuple[str, ...] = ()
    params: Mapping[str, float] = {}
    px4: tuple[int, ...] = ()
    px4_airframe: int = 0
    px4_params: Mapping[str, float] = {}
    air_data: bool = False

    def from_pwm(self, pwm: Sequence[int]) -> list[float]:
        """Actuator values of ArduPilot's servo outputs."""
        return [channel.value(pwm) for channel in self.channels]

    def from_px4(self, controls: Sequence[float]) -> list[float]:
        """Actuator values of PX4's controls; an output that is off (NaN) is 0."""
        values = [controls[i] for i in self.px4]
        return [min(max(value, 0.0), 1.0) if value == value else 0.0 for value in values]


def _copter(name: str) -> MakeBody:
    def make(start: Array, yaw: Array, dt: float, environment: Environment) -> Body:
        return CopterDynamics(airframe(name), start, yaw, dt, environment.terrain)

    return make


def _drive_copter(body: Body, values: Sequence[float]) -> None:
    assert isinstance(body, CopterDynamics)
    body.throttle = np.array(values)[:, None]


def _settle_copter(fleet: Fleet) -> None:
    body = fleet.dynamics
    assert isinstance(body, CopterDynamics)
    body.supply = fleet.battery.volts / body.airframe.battery_v
    body.density = density(fleet.around.place.alt_amsl_m - body.pos[2])
    fleet.sensors.throttle[:] = body.throttle.mean(0)


def _rover(name: str) -> MakeBody:
    def make(start: Array, yaw: Array, dt: float, environment: Environment) -> Body:
        return RoverDynamics(rover_frame(name), start, yaw, dt, environment.terrain)

    return make


def _drive_rover(body: Body, values: Sequence[float]) -> None:
    assert isinstance(body, RoverDynamics)
    first, second = np.array([values[0]]), np.array([values[1]])
    if body.frame.skid:
        body.left, body.right, body.throttle = first, second, 0.5 * (first + second)
    else:
        body.steering, body.throttle = first, second


def _settle_rover(fleet: Fleet) -> None:
    body = fleet.dynamics
    assert isinstance(body, RoverDynamics)
    fleet.sensors.throttle[:] = np.abs(body.throttle)


def _make_plane(start: Array, yaw: Array, dt: float, environment: Environment) -> Body:
    return PlaneDynamics(wing("plane"), start, yaw, dt, environment.terrain)


def _drive_plane(body: Body, values: Sequence[float]) -> None:
    assert isinstance(body, PlaneDynamics)
    aileron, elevator, throttle, rudder = values
    body.surface = np.array([[aileron], [elevator], [rudder]])
    body.throttle = np.array([throttle])


def _settle_plane(fleet: Fleet) -> None:
    body = fleet.dynamics
    assert isinstance(body, PlaneDynamics)
    body.density = density(fleet.around.place.alt_amsl_m - body.pos[2])
    fleet.sensors.throttle[:] = body.throttle


def _rotors(*numbers: int) -> tuple[Channel, ...]:
    return tuple(Channel(number) for number in numbers)


# Motor numbers: ardupilot.org, "Connect ESCs and Motors"; docs.px4.io, "Airframes Reference". Rotors here are in the
# order of zmav.sim.dynamics.airframe: the "+" right, left, front, rear; rings clockwise from right of the nose.
_ROVER_PARAMS = ("default_params/rover.parm",)
_COPTER_PARAMS = ("default_params/copter.parm",)
_QUAD_X, _HEXA_X = (0, 3, 1, 2), (4, 0, 3, 5, 1, 2)
# Steps a second where loops run at 50 Hz: a third of what ArduPilot asks for by itself, and as good.
_SLOW = {"SIM_RATE_HZ": 400}


def _px4_geometry(name: str, px4: Sequence[int]) -> dict[str, float]:
    """Where PX4's motors are, for its mixer: the Iris that it takes this for has its rear ones closer together."""
    rotors = airframe(name).rotors
    placed = {f"CA_ROTOR{px4[i]}": rotor for i, rotor in enumerate(rotors)}
    return {
        f"{motor}_{axis}": round(metres, 3)
        for motor, rotor in sorted(placed.items())
        for axis, metres in (("PX", rotor.forward_m), ("PY", rotor.right_m))
    }


def _crafts() -> list[Craft]:
    return [
        Craft(
            name="quad",
            make=_copter("quad"),
            drive=_drive_copter,
            settle=_settle_copter,
            pack=airframe("quad").pack,
            channels=_rotors(0, 1, 2, 3),
            program="arducopter",
            model="+",
            defaults=_COPTER_PARAMS,
            params={"FRAME_CLASS": 1, "FRAME_TYPE": 0},
        ),
        Craft(
            name="hexa",
            make=_copter("hexa"),
            drive=_drive_copter,
            settle=_settle_copter,
            pack=airframe("hexa").pack,
            channels=_rotors(*_HEXA_X),
            program="arducopter",
            model="hexa",
            defaults=_COPTER_PARAMS,
            params={"FRAME_CLASS": 2, "FRAME_TYPE": 1},
            px4=_HEXA_X,
        ),
        Craft(
            name="sih",
            make=_copter("sih"),
            drive=_drive_copter,
            settle=_settle_copter,
            pack=airframe("sih").pack,
            channels=_rotors(*_QUAD_X),
            program="arducopter",
            model="x",
            defaults=_COPTER_PARAMS,
            params={"FRAME_CLASS": 1, "FRAME_TYPE": 1, "MOT_THST_EXPO": 0.0, "MOT_THST_HOVER": 0.49},
            px4=_QUAD_X,
            px4_airframe=10016,
            px4_params=_px4_geometry("sih", _QUAD_X),
        ),
        Craft(
            name="rover",
            make=_rover("rover"),
            drive=_drive_rover,
            settle=_settle_rover,
            pack=rover_frame("rover").pack,
            channels=(Channel(0, both_ways=True), Channel(2, both_ways=True)),
            program="ardurover",
            model="rover",
            defaults=_ROVER_PARAMS,
            params=_SLOW,
        ),
        Craft(
            name="rover-skid",
            make=_rover("rover-skid"),
            drive=_drive_rover,
            settle=_settle_rover,
            pack=rover_frame("rover-skid").pack,
            channels=(Channel(0, both_ways=True), Channel(2, both_ways=True)),
            program="ardurover",
            model="rover-skid",
            defaults=(*_ROVER_PARAMS, "default_params/rover-skid.parm"),
            params={"SERVO1_FUNCTION": 73, "SERVO3_FUNCTION": 74, **_SLOW},
        ),
        Craft(
            name="plane",
            make=_make_plane,
            drive=_drive_plane,
            settle=_settle_plane,
            pack=wing("plane").pack,
            channels=(Channel(0, both_ways=True), Channel(1, both_ways=True), Channel(2), Channel(3, both_ways=True)),
            program="arduplane",
            model="plane",
            defaults=("models/plane.parm",),
            # The elevator up, and the rudder to the right, by longer pulses.
            params={"SERVO2_REVERSED": 0, "SERVO4_REVERSED": 0, **_SLOW},
            air_data=True,
        ),
    ]


def craft(name: str) -> Craft:
    """The airframe of that name; :class:`BadConfig` names the known ones."""
    known = {each.name: each for each in _crafts()}
    if name not in known:
        expected = ", ".join(known)
        raise BadConfig(f"no airframe {name!r}; known: {expected}", field="airframe", value=name, expected=expected)
    return known[name]
