"""EV1's loops: PX4's cascade for multirotors, one Controller a loop, with PX4's own gains and limits.

    position (P) -> velocity (PID) -> attitude and thrust -> attitude (quaternion P) -> body rates (PID) -> torque

and, where somebody gives the attitude, altitude (P and PID of the vertical alone) in place of the first two. Source of
the structure: https://docs.px4.io/main/en/flight_stack/controller_diagrams.html; each parameter says
which of PX4's it is. Plain floats all through: the whole cascade takes some tens of microseconds a cycle.
"""

from agents.controllers.loops.inner import AttitudeLoop, RatesLoop
from agents.controllers.loops.outer import AltitudeLoop, PositionLoop, VelocityLoop

__all__ = ["AltitudeLoop", "AttitudeLoop", "PositionLoop", "RatesLoop", "VelocityLoop"]
