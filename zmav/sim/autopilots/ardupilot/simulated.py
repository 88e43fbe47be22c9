"""ArduPilot's SIM_ parameters that spoil sensors and motors: what its own simulation does with them, done here.

https://ardupilot.org/dev/docs/sitl-simulation-parameters.html, "Simulated failures". SIM_RC_FAIL is the radio's,
SIM_BATT_VOLTAGE the battery's.
"""

from __future__ import annotations

import math

from zmav.sim.fleets.base import Seat
from zmav.sim.geo import METRES_PER_DEGREE
from zmav.sim.protocol.params import ParamStore
from zmav.sim.sensors.suite import FULL_SCALE
from zmav.sim.sensors.troubles import Trouble

CAUSE = "parameters"
_SENSORS = (
    "SIM_GPS1_ENABLE", "SIM_GPS1_GLTCH_X", "SIM_GPS1_GLTCH_Y", "SIM_GPS1_GLTCH_Z", "SIM_MAG1_FAIL", "SIM_MAG2_FAIL",
    "SIM_MAG3_FAIL", "SIM_BARO_GLITCH", "SIM_BARO_DISABLE", "SIM_BAR2_DISABLE", "SIM_SONAR_GLITCH", "SIM_ACC1_RND",
    "SIM_ARSPD_FAIL",
)  # fmt: skip
_MOTORS = ("SIM_ENGINE_FAIL", "SIM_ENGINE_MUL")
FARTHEST_M = 1e6
FILTERED, CLIPS_HZ = 0.72, 300.0  # as measured: of SIM_ACC1_RND, what VIBRATION shows; samples that can clip


class SimParams:
    """Watches one vehicle's parameters."""

    def __init__(self, params: ParamStore, seat: Seat, lat_deg: float) -> None:
        self._params = params
        self._seat = seat
        self._per_degree_east = METRES_PER_DEGREE * max(math.cos(math.radians(lat_deg)), 0.01)
        self._broken = 0
        changed = params.changed

        def also(name: str, value: float) -> None:
            changed(name, value)
            if name in _SENSORS:
                self._spoil_sensors()
            elif name in _MOTORS:
                self._spoil_motors()

        params.changed = also
        self._spoil_sensors()
        self._spoil_motors()

    def _value(self, name: str, default: float = 0.0) -> float:
        """A parameter that this kind may lack, within reason."""
        value = self._params[name] if name in self._params else default  # noqa: SIM401 - it is no dict
        return min(max(value, -FARTHEST_M), FARTHEST_M)

    def _spoil_sensors(self) -> None:
        value = self._value
        shaking = abs(value("SIM_ACC1_RND"))
        trouble = Trouble(
            gps_lost=value("SIM_GPS1_ENABLE", 1.0) <= 0.0,
            gps_shift=(
                min(max(value("SIM_GPS1_GLTCH_X") * METRES_PER_DEGREE, -FARTHEST_M), FARTHEST_M),
                min(max(value("SIM_GPS1_GLTCH_Y") * self._per_degree_east, -FARTHEST_M), FARTHEST_M),
                -value("SIM_GPS1_GLTCH_Z"),
            ),
            compass_lost=all(value(f"SIM_MAG{i}_FAIL") > 0.0 for i in (1, 2, 3)),
            baro_shift=value("SIM_BARO_GLITCH"),
            baro_lost=value("SIM_BARO_DISABLE") > 0.0 and value("SIM_BAR2_DISABLE", 1.0) > 0.0,
            range_shift=value("SIM_SONAR_GLITCH"),
            vibration=FILTERED * shaking,
            clipping=CLIPS_HZ * math.erfc(FULL_SCALE / (shaking * math.sqrt(2.0))) if shaking > 0.0 else 0.0,
            pitot_lost=value("SIM_ARSPD_FAIL") > 0.0,
        )
        self._seat.trouble(CAUSE, trouble)

    def _spoil_motors(self) -> None:
        """SIM_ENGINE_FAIL is a mask of motors that give SIM_ENGINE_MUL of their thrust."""
        mask, left = int(max(self._value("SIM_ENGINE_FAIL"), 0.0)), min(max(self._value("SIM_ENGINE_MUL"), 0.0), 1.0)
        for motor in range(self._seat.motors):
            if (mask | self._broken) >> motor & 1:
                self._seat.weaken_motor(motor, CAUSE, left if mask >> motor & 1 else 1.0)
        self._broken = mask
