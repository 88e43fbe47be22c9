"""Is this autopilot flying a simulation? Nothing is armed before that is shown by more than one sign.

ArduPilot: only a build with simulation in it has ``SIM_`` parameters, and its gyroscopes and accelerometers then carry
the bus type SITL in their ids (AP_HAL::Device::BUS_TYPE_SITL); SIM_OH_MASK names outputs that it drives all the same.
Source: ardupilot.org/dev, "Simulation on Hardware"; AP_HAL/Device.h, SITL.cpp, AP_HAL_ChibiOS/RCOutput.cpp.
PX4: SYS_HITL is 1, for which it starts simulated outputs and no sensor drivers, and its HEARTBEAT says that it is in
HIL, in which its commander locks the real outputs.
Source: docs.px4.io, "Hardware in the Loop Simulation (HITL)"; mavlink.io, MAV_MODE_FLAG.
"""

from __future__ import annotations

from collections.abc import Mapping

from zmav.errors import Refused
from zmav.mavlink.paramvalue import Value

BUS_BITS, BUS_SITL = 0x7, 4
SENSORS = ("INS_ACC_ID", "INS_ACC2_ID", "INS_ACC3_ID", "INS_GYR_ID", "INS_GYR2_ID", "INS_GYR3_ID")
HIL_FLAG = "HIL_ENABLED"
HITL = "SYS_HITL"


def ardupilot_simulates(params: Mapping[str, Value]) -> list[str]:
    """The signs that it does; raises :class:`Refused` naming the one that is missing. ``params``: the complete set."""
    simulation = [name for name in params if name.startswith("SIM_")]
    if len(simulation) < 10 or "SIM_OH_MASK" not in params:
        raise _real(f"it has {len(simulation)} SIM_ parameters: its firmware is not built for simulation on hardware")
    if params["SIM_OH_MASK"] != 0:
        raise _real(f"SIM_OH_MASK is {params['SIM_OH_MASK']}: it drives real outputs; set it to 0 and reboot")
    ids = {name: int(params[name] or 0) for name in SENSORS if params.get(name)}
    if "INS_ACC_ID" not in ids or "INS_GYR_ID" not in ids:
        raise _real("it names no accelerometer or no gyroscope (INS_ACC_ID, INS_GYR_ID)")
    real = [f"{name} {number}" for name, number in ids.items() if number & BUS_BITS != BUS_SITL]
    if real:
        raise _real(f"it has sensors that are not simulated: {', '.join(real)}")
    return [
        f"{len(simulation)} SIM_ parameters, SIM_OH_MASK 0: no output is driven",
        f"{', '.join(ids)}: all of the bus type SITL",
    ]


def px4_simulates(params: Mapping[str, Value], base_mode: str) -> list[str]:
    """Likewise; ``base_mode``: its HEARTBEAT's, by the names of MAV_MODE_FLAG."""
    if HITL not in params:
        raise _real(f"it has no {HITL}: its firmware knows no HITL")
    if params[HITL] != 1:
        raise _real(f"{HITL} is {params[HITL]}, and not 1")
    if HIL_FLAG not in base_mode:
        raise _real(f"{HITL} is 1, but its HEARTBEAT does not say that it is in HIL ({base_mode}): reboot it")
    return [
        f"{HITL} is 1: simulated outputs, no sensor drivers",
        "its HEARTBEAT says HIL_ENABLED: real outputs are locked",
    ]


def _real(why: str) -> Refused:
    return Refused(f"nothing shows that this autopilot flies a simulation: {why}. It is not armed")
