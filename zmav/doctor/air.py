"""What ``zmav doctor`` looks at of the air: the feeds of who else is in it, and remote identification of our own."""

from __future__ import annotations

from collections.abc import Iterator

import msgspec

from zmav.doctor import topics
from zmav.doctor.facts import AgentReport
from zmav.doctor.findings import Finding
from zmav.errors import ZmavError
from zmav.vehicle import Vehicle

ENABLED = {"ardupilot": "DID_ENABLE", "px4": "COM_ARM_ODID"}
"""the parameter by which an autopilot has to do with remote identification, not zero"""
STATUS = "OPEN_DRONE_ID_ARM_STATUS"
OLD_S = 5.0
"""s after which a module that said it each second is silent"""
GOOD = "MAV_ODID_ARM_STATUS_GOOD_TO_ARM"


class RemoteId(msgspec.Struct, frozen=True):
    """What a vehicle says of its module for remote identification."""

    wanted: str | None = None
    """the parameter that has it wanted; None: nothing does"""
    status: str | None = None
    """MAV_ODID_ARM_STATUS; None: no module was ever heard"""
    error: str = ""
    age: float = 0.0


async def remote_id_of(vehicle: Vehicle) -> RemoteId:
    """Asks the vehicle's agent; nothing is armed or changed."""
    wanted: str | None = None
    try:
        state = vehicle.last_state
        name = ENABLED.get((state.autopilot if state is not None else None) or "")
        if name is not None and (await vehicle.params.get(name)).value:
            wanted = name
    except ZmavError:
        pass  # it has no such parameter, or they are not read: doctor's line on failsafes says so
    try:
        told = await vehicle.message(STATUS)
    except ZmavError:
        return RemoteId(wanted)
    return RemoteId(wanted, str(told.fields.get("status")), str(told.fields.get("error") or "").rstrip("\0"), told.age)


def check_remote_id(told: dict[str, RemoteId]) -> Iterator[Finding]:
    """Nothing of who neither has a module nor is to have one."""
    for who, each in told.items():
        if each.status is None:
            if each.wanted:
                found = f"{each.wanted} asks for it, and no module is heard"
                yield topics.REMOTE_ID.wrong(found, "look at the module's power, port and baud rate", who)
        elif each.age > OLD_S:
            yield topics.REMOTE_ID.wrong(
                f"its module is silent for {each.age:.0f} s", "look at its power and cable", who
            )
        elif each.status != GOOD:
            why = f": {each.error}" if each.error else ""
            advice = "give it what it lacks (operator's id, place, its own GPS), by a station or the module's own page"
            yield topics.REMOTE_ID.wrong(f"its module is not ready to arm{why}", advice, who)
        else:
            yield topics.REMOTE_ID.well("its module is heard, and ready to arm", who)


def check_traffic(agents: list[AgentReport]) -> Iterator[Finding]:
    """Of each 'zmav traffic'; that all its feeds are lost or it is silent, the line on agents says."""
    for agent in agents:
        if agent.name != "traffic" or agent.stale or agent.state == "lost":
            continue
        found = f"{agent.fleet}/{agent.host}: {agent.text}"
        if agent.state == "partly":
            yield topics.AIRCRAFT.advise(found, "is that receiver's program running there? the others are heard")
        elif agent.state == "silent":
            yield topics.AIRCRAFT.advise(
                found, "look at its antenna, or at another place's: is anybody in the air at all?"
            )
        else:
            yield topics.AIRCRAFT.well(found)
