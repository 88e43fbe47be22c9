"""From what vehicles say of themselves to what a group says of them."""

from __future__ import annotations

from collections.abc import Iterator

from tests.bench.scale.group import GroupMember, GroupStates
from zmav import wire

MOST_BYTES = 8000
"""of a part: what Zenoh sends over UDP without cutting it up"""


def shorten(state: wire.VehicleState, age: float) -> GroupMember:
    """One vehicle for a map: positions to a centimetre, speeds to a centimetre a second."""
    p, v = state.position, state.velocity
    return GroupMember(
        name=state.name,
        age=round(age, 2),
        kind=state.kind,
        mode=state.mode,
        armed=state.armed,
        lat_deg=round(p.lat_deg, 7) if p else None,
        lon_deg=round(p.lon_deg, 7) if p else None,
        alt_amsl=round(p.alt_amsl, 2) if p else None,
        velocity=(round(v[0], 2), round(v[1], 2), round(v[2], 2)) if v else None,
        battery=None if state.battery is None or state.battery.remaining is None else state.battery.remaining,
        fix=state.gps.fix if state.gps else None,
        faults=[text for text in (None if state.connected else "no autopilot", state.clash, state.pilot) if text],
    )


def parts(group: str, t: float, members: list[GroupMember]) -> Iterator[bytes]:
    """The payloads of :class:`GroupStates` that hold them all, in order; one of an empty group, too."""
    held: list[list[GroupMember]] = [[]]
    size = 0
    for member in members:
        length = len(wire.encode(member)) + 1
        if held[-1] and size + length > MOST_BYTES:
            held.append([])
            size = 0
        held[-1].append(member)
        size += length
    for number, some in enumerate(held):
        yield wire.encode(GroupStates(t=t, group=group, part=number, parts=len(held), vehicles=some))
