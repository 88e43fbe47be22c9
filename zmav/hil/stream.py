"""The messages of PX4's simulator interface, for any line: sensors out, actuator controls in.

Source: docs.px4.io, "Simulation", sections "Simulator MAVLink API" and "Lockstep Simulation"; mavlink.io, HIL_SENSOR,
HIL_GPS, HIL_ACTUATOR_CONTROLS. What PX4 makes of each: its simulator_mavlink (on a computer) and mavlink_receiver (on a
flight controller).
"""

from __future__ import annotations

import math
from typing import Any

from zmav.hil.plant import Plant
from zmav.mavlink.codec import Packer, decode
from zmav.mavlink.dialect import Dialect
from zmav.mavlink.frames import Frame
from zmav.sim.geo import from_ned
from zmav.sim.sensors.readings import GpsFix, Readings

SENSOR_HZ = 250.0
SIMULATOR = 200  # component id, in the vehicle's own system
# Bits of HIL_SENSOR.fields_updated, for the sensors that PX4 takes one by one.
IMU, MAG, BARO, PITOT = 0x3F, 0x1C0, 0x1A00, 0x400
MAG_EVERY_S, BARO_EVERY_S, BEAT_EVERY_S = 0.01, 0.02, 1.0
FAULTS = frozenset({"motor", "battery", "gps-loss", "gps-glitch", "compass", "baro", "imu"})
"""what of a body and its sensors can fail and be seen in these messages"""
ARMED, LOCKSTEP = 128, 1
GENERIC, INVALID, ACTIVE = 0, 8, 4  # MAV_TYPE, MAV_AUTOPILOT, MAV_STATE: no ground station, whose loss PX4 watches for
_HIL_MESSAGES = ("HIL_ACTUATOR_CONTROLS", "HIL_CONTROLS")


class HilStream:
    """One vehicle's exchange. :meth:`step` moves the plant on by one reading of the IMU and gives the frames to send;
    :meth:`take` hears a frame of the autopilot.

    ``sensor_hz``: readings a second. ``controls``: how often actuators were told; ``armed``, ``lockstep`` and
    ``answered_us``, the autopilot's own time: as the last of them said.
    """

    def __init__(
        self,
        plant: Plant,
        dialect: Dialect,
        sysid: int,
        epoch_us: int,
        sensor_hz: float = SENSOR_HZ,
    ) -> None:
        self.plant = plant
        self.dialect = dialect
        self.sensor_hz = sensor_hz
        self.packer = Packer(dialect, sysid, SIMULATOR)
        self._epoch_us = epoch_us
        self._ids = {dialect.message(name).id for name in _HIL_MESSAGES}
        self.restart()

    def restart(self) -> None:
        """Begin again with another autopilot, or the same after its boot."""
        self.controls = self.answered_us = 0
        self.armed = self.lockstep = False
        self._due = dict.fromkeys(("mag", "baro", "beat"), 0.0)
        self._fix_time = -1.0

    @property
    def interval_s(self) -> float:
        return 1.0 / self.sensor_hz

    @property
    def time_us(self) -> int:
        """The plant's time as the autopilot's clock is set to it; never 0, which would mean "unknown"."""
        return round(self.plant.time_s * 1e6) + 1

    # ---- out

    def step(self) -> bytes:
        """One interval of physics, and what the sensors say then."""
        self.plant.run(self.interval_s)
        self.plant.sensors.tick(self.interval_s)
        return self.report()

    def report(self) -> bytes:
        """What is due now: sensors always, the rest at its own rate. The sensors come last: they let time go on."""
        readings = self.plant.sensors.readings(0)
        frames = []
        if self._is_due("beat", BEAT_EVERY_S):
            frames.append(self.heartbeat())
            unix_us = self._epoch_us + self.time_us
            frames.append(self.packer.pack("SYSTEM_TIME", time_unix_usec=unix_us, time_boot_ms=self.time_us // 1000))
        if readings.gps.time_s != self._fix_time:
            self._fix_time = readings.gps.time_s
            frames.append(self._gps(readings.gps))
        frames.append(self._sensor(readings))
        return b"".join(frames)

    def heartbeat(self) -> bytes:
        return self.packer.pack("HEARTBEAT", type=GENERIC, autopilot=INVALID, system_status=ACTIVE)

    def _is_due(self, what: str, every_s: float) -> bool:
        now = self.plant.time_s
        if now < self._due[what] - 1e-9:
            return False
        self._due[what] = max(self._due[what] + every_s, now)
        return True

    def _sensor(self, readings: Readings) -> bytes:
        updated, troubles = IMU, self.plant.sensors.troubles
        if self._is_due("mag", MAG_EVERY_S) and not troubles.compass_lost[0]:
            updated |= MAG
        if self._is_due("baro", BARO_EVERY_S) and not troubles.baro_lost[0]:
            updated |= BARO | (PITOT if self.plant.craft.air_data else 0)
        (xacc, yacc, zacc), (xgyro, ygyro, zgyro), (xmag, ymag, zmag) = readings.accel, readings.gyro, readings.mag
        return self.packer.pack(
            "HIL_SENSOR",
            time_usec=self.time_us,
            xacc=xacc,
            yacc=yacc,
            zacc=zacc,
            xgyro=xgyro,
            ygyro=ygyro,
            zgyro=zgyro,
            xmag=xmag,
            ymag=ymag,
            zmag=zmag,
            abs_pressure=readings.pressure_hpa,
            diff_pressure=readings.diff_pressure_hpa,
            pressure_alt=readings.pressure_alt_m,
            temperature=readings.temperature_c,
            fields_updated=updated,
            id=0,
        )

    def _gps(self, fix: GpsFix) -> bytes:
        """eph and epv in cm, as PX4 takes them; the time is UTC."""
        place = from_ned(fix.north, fix.east, fix.down, self.plant.around.place)
        speed = math.hypot(fix.vn, fix.ve)
        course = math.degrees(math.atan2(fix.ve, fix.vn)) % 360.0
        return self.packer.pack(
            "HIL_GPS",
            time_usec=self._epoch_us + round(fix.time_s * 1e6),
            fix_type=fix.fix_type,
            lat=round(place.lat_deg * 1e7),
            lon=round(place.lon_deg * 1e7),
            alt=round(place.alt_amsl_m * 1e3),
            eph=round(fix.eph_m * 100.0),
            epv=round(fix.epv_m * 100.0),
            vel=round(speed * 100.0),
            vn=_centi(fix.vn),
            ve=_centi(fix.ve),
            vd=_centi(fix.vd),
            cog=round(course * 100.0) % 36000,
            satellites_visible=fix.satellites,
            id=0,
            yaw=0,
        )

    # ---- in

    def is_hil(self, frame: Frame) -> bool:
        """A message of this exchange, of no interest to ground stations."""
        return frame.msgid in self._ids

    def take(self, frame: Frame) -> None:
        """Hear a checked frame. Raises :class:`BadMessage`."""
        if self.dialect.name_of(frame.msgid) == "HIL_ACTUATOR_CONTROLS":
            self._drive(decode(frame, self.dialect))

    def _drive(self, message: dict[str, Any]) -> None:
        self.controls += 1
        self.answered_us = message["time_usec"]
        self.armed = bool(message["mode"] & ARMED)
        self.lockstep = bool(message["flags"] & LOCKSTEP)
        craft = self.plant.craft
        values = craft.from_px4(message["controls"])
        self.plant.drive(values if self.armed else [0.0] * len(values))


def _centi(value: float) -> int:
    """Hundredths, as far as 16 bits go."""
    return min(max(round(value * 100.0), -32768), 32767)
