"""Mission items as MISSION_ITEM_INT carries them: encoded, decoded, checked before they are sent, compared after.

Encoding: https://mavlink.io/en/services/mission.html#MISSION_ITEM_INT. x and y are degrees times 1e7 where the command
has a place in a global frame, metres times 1e4 in a local one, and plain numbers (param5, param6) otherwise.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from zmav.autopilots.base import MissionRules
from zmav.errors import BadInput
from zmav.formats import fence
from zmav.formats.items import UNKNOWN, command_name, command_number, frame_number, numbers
from zmav.mavlink import Dialect, command_type
from zmav.mavlink.paramvalue import shortest
from zmav.wire import MissionItem, MissionKind

KINDS: Mapping[MissionKind, int] = {"mission": 0, "fence": 1, "rally": 2}
"""MAV_MISSION_TYPE"""
WORDS: Mapping[MissionKind, str] = {"mission": "mission", "fence": "fence", "rally": "rally points"}
MOST = 65_534
"""items that the protocol's 16 bits can count"""
DO_JUMP = "MAV_CMD_DO_JUMP"
RALLY = "MAV_CMD_NAV_RALLY_POINT"
LAST_NAV = 95
"""MAV_CMD_NAV_LAST: below it are the commands that take the vehicle somewhere, or make it wait"""
GRID, PLACE_TOLERANCE, ALTITUDE_TOLERANCE, RALLY_TOLERANCE = 0x7FFFFFFF, 2, 0.011, 1.0
"""largest x and y; what autopilots' own storage loses: 1e-7 degrees, m, and m of a rally point's altitude"""


class Raw(NamedTuple):
    """The fields of a MISSION_ITEM_INT that are the item's own; floats as single precision holds them."""

    frame: int
    command: int
    autocontinue: int
    params: tuple[float, float, float, float]
    x: int
    y: int
    z: float

    def fields(self) -> dict[str, Any]:
        params = {f"param{n}": value for n, value in enumerate(self.params, 1)}
        own = {"frame": self.frame, "command": self.command, "autocontinue": self.autocontinue}
        return {**own, **params, "x": self.x, "y": self.y, "z": self.z}


HOME = Raw(0, 16, 1, (0.0, 0.0, 0.0, 0.0), 0, 0, 0.0)
"""What stands in for home, which the autopilot knows better"""


def raw_from(fields: Mapping[str, Any]) -> Raw:
    """Of a decoded MISSION_ITEM_INT."""
    params = (fields["param1"], fields["param2"], fields["param3"], fields["param4"])
    own = (fields["frame"], fields["command"], fields["autocontinue"])
    return Raw(*own, params, fields["x"], fields["y"], fields["z"])


class Items:
    """Items to and from the wire by one dialect, as an autopilot of these ``rules`` takes them."""

    def __init__(self, dialect: Dialect, rules: MissionRules) -> None:
        self._dialect, self._rules = dialect, rules

    def offset(self, kind: MissionKind) -> int:
        """How many items stand before our first on the autopilot."""
        return int(self._rules.home_first and kind == "mission")

    def encode(self, kind: MissionKind, items: Sequence[MissionItem]) -> list[Raw]:
        """What goes over the wire, without home; raises :class:`BadInput` that names every fault by index."""
        faults: list[tuple[int, str]] = []
        raws: list[Raw] = []
        for i, item in enumerate(items):
            try:
                raws.append(self.raw(kind, item))
            except BadInput as e:
                faults.append((i, e.message))
        if kind == "fence":
            faults += fence.parse(items)[1]
        elif kind == "mission":
            faults += _bad_jumps(items)
        if len(items) > MOST:
            faults.append((MOST, f"the protocol counts to {MOST}"))
        if faults:
            faults.sort()
            text = "; ".join(f"item {i}: {why}" for i, why in faults[:20])
            more = f"; and {len(faults) - 20} more" if len(faults) > 20 else ""
            raise BadInput(
                f"the {WORDS[kind]} cannot be sent: {text}{more}",
                field=f"items[{faults[0][0]}]",
                value=len(items),
                expected="valid items",
                faults=[{"item": i, "why": why} for i, why in faults],
            )
        return raws

    def decode(self, kind: MissionKind, raws: Sequence[Raw]) -> list[MissionItem]:
        """The items of what came, home left out."""
        return [self._decode(kind, raw) for raw in raws[self.offset(kind) :]]

    def name(self, raw: Raw) -> str:
        """The command's name."""
        return command_name(raw.command, self._dialect.enums)

    def located(self, command: str) -> bool:
        """x and y are a place; of a command the dialect lacks it is taken to be so."""
        return command.startswith(UNKNOWN) or command_type(self._dialect, command).has_location

    def differences(self, kind: MissionKind, sent: Raw, kept: Raw) -> tuple[list[str], list[str]]:
        """What is not as it was sent: in what the item is and where, and in its parameters."""
        if sent.command != kept.command:
            return [f"{self.name(sent)} became {self.name(kept)}"], []
        place: list[str] = []
        params = [
            f"param{n}: sent {was:g}, kept {now:g}"
            for n, (was, now) in enumerate(zip(sent.params, kept.params, strict=True), 1)
            if was != now and not math.isnan(was)  # NaN leaves it to the autopilot
        ]
        if not self.located(self.name(sent)):
            other = (("x", sent.x, kept.x), ("y", sent.y, kept.y), ("z", sent.z, kept.z))
            return [], params + [f"{axis}: sent {was:g}, kept {now:g}" for axis, was, now in other if was != now]
        if abs(sent.x - kept.x) > PLACE_TOLERANCE or abs(sent.y - kept.y) > PLACE_TOLERANCE:
            place.append(f"place: sent {sent.x}, {sent.y}, kept {kept.x}, {kept.y} (1e-7 degrees)")
        if kind == "fence":  # flat: its frame and altitude mean nothing, and its param1 what it is
            return place + [each for each in params if each.startswith("param1")], []
        if _plain(sent.frame) != _plain(kept.frame):
            place.append(f"frame: sent {sent.frame}, kept {kept.frame}")
        if not abs(sent.z - kept.z) <= (RALLY_TOLERANCE if kind == "rally" else ALTITUDE_TOLERANCE):
            place.append(f"altitude: sent {sent.z:g}, kept {kept.z:g}")
        return place, params

    # One item.

    def raw(self, kind: MissionKind, item: MissionItem) -> Raw:
        """What goes over the wire; raises :class:`BadInput` for what cannot."""
        enums = self._dialect.enums
        command, frame = command_number(item.command, enums), frame_number(item.frame, enums)
        if (kind == "rally") != (item.command == RALLY):
            raise BadInput(f"{item.command} in {'rally points' if kind == 'rally' else f'a {kind}'}")
        if kind == "mission" and item.command.startswith(fence.PREFIX):
            raise BadInput(f"{item.command} in a mission")
        params = [math.nan if value is None else value for value in numbers(item)]
        for name, value in (*zip(("param1", "param2", "param3", "param4"), params, strict=True), ("z", item.z)):
            if math.isinf(value) or abs(value) > 3.4e38 or (name == "z" and math.isnan(value)):
                raise BadInput(f"{name} is {value}: not a number it can be")
        if item.command == DO_JUMP:
            params[0] += self.offset(kind)
        never = item.command in self._rules.never_placed
        if never and (item.x or item.y):
            raise BadInput(f"this autopilot takes {item.command} without a place only: give 0 for x and y")
        if self._rules.mission_frame and (never or not self.located(item.command)):
            frame = frame_number("MAV_FRAME_MISSION", enums)  # files of Mission Planner give every item frame 3
        scale = self.scale(item.command, frame)
        x, y = (_grid(axis, value, scale) for axis, value in (("x", item.x), ("y", item.y)))
        return Raw(frame, command, int(item.autocontinue), _singles(params), x, y, _singles([item.z])[0])

    def _decode(self, kind: MissionKind, raw: Raw) -> MissionItem:
        command, enums = self.name(raw), self._dialect.enum_names
        params = [None if math.isnan(value) else shortest(value) for value in raw.params]
        if command == DO_JUMP and params[0] is not None:
            params[0] -= self.offset(kind)
        scale = self.scale(command, raw.frame)
        x, y = (0.0 if abs(value) >= GRID else value / scale for value in (raw.x, raw.y))
        frame = enums.get("MAV_FRAME", {}).get(raw.frame, f"MAV_FRAME_{raw.frame}")
        if "GLOBAL" in frame and not self.located(command):
            frame = "MAV_FRAME_MISSION"  # what it says of the frame of no place differs by autopilot
        z = shortest(raw.z) if math.isfinite(raw.z) else 0.0
        return MissionItem(
            command=command, frame=frame, params=params, x=x, y=y, z=z, autocontinue=bool(raw.autocontinue)
        )

    def scale(self, command: str, frame: int) -> float:
        """What x and y are multiplied by on their way into a MISSION_ITEM_INT."""
        name = self._dialect.enum_name("MAV_FRAME", frame) or ""
        if "LOCAL" in name or "BODY" in name:
            return 1e4
        return 1e7 if "GLOBAL" in name and self.located(command) else 1.0


def same(items: Items, kind: MissionKind, one: Sequence[Raw], other: Sequence[Raw], exact: bool = False) -> bool:
    """Both are the same plan, as far as an autopilot's storage can tell (``exact``: in every parameter); home is not
    looked at.
    """
    start = items.offset(kind)
    if len(one[start:]) != len(other[start:]):
        return False
    found = [items.differences(kind, a, b) for a, b in zip(one[start:], other[start:], strict=True)]
    return not any(place or (exact and params) for place, params in found)


def home(raws: Sequence[Raw]) -> tuple[float, float, float] | None:
    """Of a plan that carries home as its first item: degrees, metres above mean sea level; None where it is empty."""
    return (raws[0].x / 1e7, raws[0].y / 1e7, shortest(raws[0].z)) if raws else None


def ends_at(items: Items, raws: Sequence[Raw]) -> int | None:
    """Index (as on the autopilot) of the item that is reached when the mission is over; None: it jumps, for ever it
    may be, or never goes anywhere, and only the autopilot knows when it is over.
    """
    nav = [i for i, raw in enumerate(raws) if i >= items.offset("mission") and raw.command < LAST_NAV]
    jumps = [i for i, raw in enumerate(raws) if "JUMP" in items.name(raw)]
    return nav[-1] if nav and not any(i > nav[-1] for i in jumps) else None


def _bad_jumps(items: Sequence[MissionItem]) -> list[tuple[int, str]]:
    faults = []
    for i, item in enumerate(items):
        target = item.params[0] if item.params else None
        if item.command == DO_JUMP and (target is None or target not in range(len(items))):
            faults.append((i, f"it jumps to item {target}, which there is not"))
    return faults


def _grid(axis: str, value: float, scale: float) -> int:
    if not math.isfinite(value):
        raise BadInput(f"{axis} is {value}: not a finite number")
    most = {("x", 1e7): 90.0, ("y", 1e7): 180.0}.get((axis, scale), GRID / scale)
    if abs(value) > most:
        what = {"x": "latitude", "y": "longitude"}[axis] if scale == 1e7 else axis
        raise BadInput(f"{what} {value:g} is beyond ±{most:g}")
    if scale == 1.0 and value != round(value):
        raise BadInput(f"{axis} is {value:g}, but this command has whole numbers there alone")
    return round(value * scale)


def _singles(values: Sequence[float]) -> Any:
    """As single precision holds them."""
    form = f"<{len(values)}f"
    return struct.unpack(form, struct.pack(form, *values))


def _plain(frame: int) -> int:
    """The frames whose names end in INT say the same as those without."""
    return {5: 0, 6: 3, 11: 10}.get(frame, frame)
