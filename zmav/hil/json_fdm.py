"""ArduPilot's JSON interface: servo pulses in, the state of the physics out, in lock step over UDP.

Source: ArduPilot, libraries/SITL/examples/JSON/readme.md. The flight stack sends a binary packet for every step it
wants to make and waits for the answer, one line of JSON, which carries the time that it then takes as its own.
"""

from __future__ import annotations

import math
import struct
from typing import NamedTuple

from zmav.errors import BadMessage
from zmav.hil.plant import Plant, Truth

PORT, PORT_STEP = 9002, 10
MAGIC_16, MAGIC_32 = 18458, 29569
LONGEST_STEP_S = 0.02  # of the physics: a slower stack's steps are cut into such
MOST_S = 0.1  # that frames which got lost are made up for
FARTHEST_M = 9999.0  # that a rangefinder is told, for the sky too: without a word ArduPilot keeps the last distance
_HEADER = struct.Struct("<HHI")
_PWM = {MAGIC_16: struct.Struct("<16H"), MAGIC_32: struct.Struct("<32H")}
_EXPECTED = "magic 18458 and 16 servo outputs (40 bytes), or 29569 and 32 (72 bytes)"


class Servos(NamedTuple):
    """One packet of the flight stack: steps per second, which step this is, pulse widths in microseconds."""

    rate_hz: int
    frame: int
    pwm: tuple[int, ...]


def parse_servos(data: bytes) -> Servos:
    """Read a packet; :class:`BadMessage` says what is wrong with it."""
    if len(data) >= _HEADER.size:
        magic, rate, count = _HEADER.unpack_from(data)
        outputs = _PWM.get(magic)
        if outputs is not None and len(data) == _HEADER.size + outputs.size:
            if rate == 0:
                raise BadMessage("a servo packet with a frame rate of 0", field="frame_rate", value=0, expected="1 Hz")
            return Servos(rate, count, outputs.unpack_from(data, _HEADER.size))
    raise BadMessage.wrong("packet", len(data), _EXPECTED, f"{len(data)} bytes that are no servo packet")


def compose(plant: Plant) -> bytes:
    """The answer: the truth now, positions about the vehicle's own start. Sensor errors are the flight stack's to
    add (its SIM_* parameters).
    """
    now = plant.truth()
    start = plant.start
    gyro, force, q = now.rate, now.specific_force, now.q
    pos, vel = now.pos, now.vel
    text = (
        f'\n{{"timestamp":{plant.time_s:.7f},"imu":{{"gyro":[{gyro[0]:.7g},{gyro[1]:.7g},{gyro[2]:.7g}],'
        f'"accel_body":[{force[0]:.7g},{force[1]:.7g},{force[2]:.7g}]}},'
        f'"position":[{pos[0] - start[0]:.6f},{pos[1] - start[1]:.6f},{pos[2] - start[2]:.6f}],'
        f'"quaternion":[{q[0]:.8f},{q[1]:.8f},{q[2]:.8f},{q[3]:.8f}],'
        f'"velocity":[{vel[0]:.7g},{vel[1]:.7g},{vel[2]:.7g}],"no_time_sync":1'
        f'{_air(plant, now)},"rng_1":{_range(plant, now):.4f}}}\n'
    )
    return text.encode("ascii")


def _air(plant: Plant, now: Truth) -> str:
    """What instruments other than the IMU say: the apparent wind (from the bow, clockwise), airspeed (true), wind (the
    way it blows to, NED), and the battery.
    """
    u, v, w = now.air_velocity
    airspeed = max(u, 0.0) if plant.craft.air_data else math.sqrt(u * u + v * v + w * w)
    if plant.sensors.troubles.pitot_lost[0]:
        airspeed = 0.0
    vane = f'"windvane":{{"direction":{math.atan2(v, u) % (2 * math.pi):.5f},"speed":{math.hypot(u, v):.5g}}}'
    north, east, down = now.wind
    battery = f'"battery":{{"voltage":{plant.battery.volts[0]:.4g},"current":{plant.battery.current[0]:.4g}}}'
    return f',{vane},"airspeed":{airspeed:.6g},"velocity_wind":[{north:.5g},{east:.5g},{down:.5g}],{battery}'


def _range(plant: Plant, now: Truth) -> float:
    """What a rangefinder without limits that looks down the body's axis measures, m; the limits are the flight stack's
    to know (RNGFND1_MAX).
    """
    troubles = plant.sensors.troubles
    upward = now.to_body(0.0, 0.0, 1.0)[2]
    if upward < 1e-3 or troubles.range_lost[0]:
        return FARTHEST_M
    distance = max(-now.pos[2] / upward, 0.0) + float(troubles.range_shift[0])
    return min(max(distance, 0.0), FARTHEST_M)


class JsonFdm:
    """The protocol of one vehicle, without a socket: :meth:`take` a packet, then :meth:`answer` when time may go on.

    ``frames``: steps made; ``lost``: frames by the counter that never came; ``repeated``: those that came twice, which
    are answered without any time passing; ``restarts``: how often the flight stack started again, which puts it
    back to its start.
    """

    def __init__(self, plant: Plant) -> None:
        self.plant = plant
        self.frames = self.lost = self.repeated = self.restarts = 0
        self._last: Servos | None = None
        self._answer = b""
        self._pending: Servos | None = None

    def take(self, data: bytes) -> bytes | None:
        """A packet: gives the answer at once where no time passes by it. Raises :class:`BadMessage`."""
        servos = parse_servos(data)
        last = self._last
        if last is not None and servos.frame < last.frame:
            self._restart()
            last = None
        if last is not None and servos.frame == last.frame and self._answer:
            self.repeated += 1
            return self._answer
        self._pending = servos
        return None

    @property
    def wanted_s(self) -> float:
        """Seconds that the packet taken last asks for; 0 where none waits."""
        if self._pending is None:
            return 0.0
        return self._steps(self._pending) / self._pending.rate_hz

    def answer(self) -> bytes:
        """Make the step that was asked for."""
        servos = self._pending
        assert servos is not None
        steps = self._steps(servos)
        self.lost += 0 if self._last is None else servos.frame - self._last.frame - 1
        self._last, self._pending = servos, None
        plant = self.plant
        plant.drive(plant.craft.from_pwm(servos.pwm))
        seconds = 1.0 / servos.rate_hz
        parts = math.ceil(seconds / LONGEST_STEP_S)
        for _ in range(steps * parts):
            plant.run(seconds / parts)
        self.frames += 1
        self._answer = compose(plant)
        return self._answer

    def _steps(self, servos: Servos) -> int:
        """One, and those whose packets were lost, so that a stack that does not wait for answers keeps its time."""
        if self._last is None:
            return 1
        return min(servos.frame - self._last.frame, max(int(MOST_S * servos.rate_hz), 1))

    def _restart(self) -> None:
        self.restarts += 1
        self.plant.reset()
        self._last, self._answer = None, b""
