"""Parameters of the simulated autopilots that only make their way home and down shorter."""

from __future__ import annotations

COPTER_DOWN = {"LAND_SPEED": 200.0, "LAND_SPEED_HIGH": 300.0, "RTL_LOIT_TIME": 500.0}
COPTER_HOME = COPTER_DOWN | {"RTL_ALT": 800.0}
PX4_DOWN = {"MPC_LAND_SPEED": 2.0, "MPC_LAND_CRWL": 1.0, "RTL_LAND_DELAY": 0.0}
