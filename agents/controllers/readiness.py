"""What must be so before a controller takes over from the autopilot."""

from __future__ import annotations

import contextlib

from agents.controllers.estimate import Estimate
from zmav import wire
from zmav.autopilots import autopilot_named
from zmav.errors import Refused, ZmavError
from zmav.vehicle.vehicle import Vehicle

ENOUGH, LEAST = 0.8, 0.5
"""of the rate that is wanted: below the first it is said, below the second nobody takes over"""


def check_ready(state: wire.VehicleState, estimate: Estimate, wanted: float) -> str:
    """Words on a rate that is lower than the one ``wanted`` (cycles a second); empty: it is not. Raises
    :class:`Refused` with what is missing.
    """
    if state.pilot:
        raise Refused(f"the pilot has it: {state.pilot}", count="pilot")
    if not state.armed or state.landed:
        raise Refused("it is on the ground or disarmed: a controller takes over in the air; order a takeoff first")
    if state.position is None:
        raise Refused("its height above home is not known yet: has it a position?")
    if not estimate.ready:
        raise Refused("no ATTITUDE_QUATERNION and LOCAL_POSITION_NED yet: is the link up, has it a position?")
    hz = 1.0 / max(estimate.period, 1e-6)
    if hz < LEAST * wanted:
        text = (
            f"the autopilot's state comes at {hz:.0f} Hz of {wanted:g}: give the link more room (a higher baud, "
            f"SERIALn_BAUD or SER_TELn_BAUD; 'zmav rate {state.name}' shows who reads what), or ask for less "
            f"(-o rate_hz={max(hz * 0.9, 1.0):.0f})"
        )
        raise Refused(text, hz=hz, wanted=wanted)
    return "" if hz >= ENOUGH * wanted else f" at {hz:.0f} Hz: its state comes no faster ({wanted:g} wanted)"


async def check_parameters(vehicle: Vehicle, gives: str) -> None:
    """Raises :class:`Refused` where the autopilot would take an output for something else than it says."""
    state = vehicle.state
    autopilot = autopilot_named(state.autopilot, state.kind)
    for need in next((each for level, each in autopilot.needs_by_level.items() if level == gives), ()):
        values: dict[str, float | None] = {}
        for name in need.params:
            with contextlib.suppress(ZmavError):  # another firmware's name
                values[name] = (await vehicle.params.get(name)).value
        why = need.unmet(values.get, state.sysid or 1)
        if why is not None:
            raise Refused(why, vehicle=state.name, parameter=need.params[0])
