"""QGroundControl's ``.plan``: a mission, a geofence and rally points in one JSON file.

Format: https://docs.qgroundcontrol.com/master/en/qgc-dev-guide/file_formats/plan.html. Read: plan version 1, mission
version 2, fence and rally version 2. Of a complex item (survey, corridor scan) the simple items that QGroundControl
generated for it are taken; one that has none stored cannot be read without QGroundControl. Unknown keys are passed
over, as QGroundControl adds some with every release; what is read is strict, and a fault is named by its JSON path.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from zmav.errors import BadInput
from zmav.formats import fence
from zmav.formats.items import Enums, Place, Plan, command_name, command_number, frame_name, frame_number, numbers
from zmav.wire import MissionItem

DO_JUMP = "MAV_CMD_DO_JUMP"
RALLY = "MAV_CMD_NAV_RALLY_POINT"
RELATIVE = "MAV_FRAME_GLOBAL_RELATIVE_ALT"
ALTITUDE_MODES = {"MAV_FRAME_GLOBAL_RELATIVE_ALT": 1, "MAV_FRAME_GLOBAL": 2, "MAV_FRAME_GLOBAL_TERRAIN_ALT": 4}
"""QGroundControl's AltitudeMode by the item's frame"""


class _Simple(msgspec.Struct, tag_field="type", tag="SimpleItem", kw_only=True):
    command: int
    frame: int
    params: list[float | None]
    autoContinue: bool = True
    doJumpId: int | None = None


class _Transects(msgspec.Struct, kw_only=True):
    Items: list[_Simple]


class _Complex(msgspec.Struct, tag_field="type", tag="ComplexItem", kw_only=True):
    complexItemType: str = "unnamed"
    TransectStyleComplexItem: _Transects | None = None


class _MissionPart(msgspec.Struct, kw_only=True):
    version: int
    items: list[_Simple | _Complex]
    plannedHomePosition: Place | None = None
    firmwareType: int = 3
    vehicleType: int = 2


class _Circle(msgspec.Struct, kw_only=True):
    center: tuple[float, float]
    radius: float


class _FenceCircle(msgspec.Struct, kw_only=True):
    circle: _Circle
    inclusion: bool = True


class _FencePolygon(msgspec.Struct, kw_only=True):
    polygon: list[tuple[float, float]]
    inclusion: bool = True


class _FencePart(msgspec.Struct, kw_only=True):
    version: int
    circles: list[_FenceCircle] = []
    polygons: list[_FencePolygon] = []
    breachReturn: Place | None = None


class _RallyPart(msgspec.Struct, kw_only=True):
    version: int
    points: list[Place] = []


class _File(msgspec.Struct, kw_only=True):
    fileType: str
    version: int
    mission: _MissionPart | None = None
    geoFence: _FencePart | None = None
    rallyPoints: _RallyPart | None = None


def read(data: bytes, enums: Enums, name: str = "the plan") -> Plan:
    """The plans in a ``.plan`` file's bytes; ``enums``: the dialect's, for names of commands and frames.

    Raises :class:`BadInput` naming ``name``, the JSON path and what was expected.
    """
    try:
        file = msgspec.json.decode(data, type=_File)
    except msgspec.ValidationError as e:
        what, _, path = str(e).partition(" - at `")
        raise _bad(name, path.rstrip("`") or "$", what) from None
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as e:
        raise _bad(name, "$", f"not JSON: {e}") from None
    if file.fileType != "Plan":
        raise _bad(name, "$.fileType", f"{file.fileType!r}, expected 'Plan'")
    for path, got, known in (
        ("$.version", file.version, 1),
        ("$.mission.version", file.mission and file.mission.version, 2),
        ("$.geoFence.version", file.geoFence and file.geoFence.version, 2),
        ("$.rallyPoints.version", file.rallyPoints and file.rallyPoints.version, 2),
    ):
        if got is not None and got != known:
            raise _bad(name, path, f"version {got}, expected {known}: save it again with a newer QGroundControl")
    mission, home = file.mission, file.mission.plannedHomePosition if file.mission else None
    return Plan(
        mission=_read_mission(mission, enums, name) if mission else None,
        fence=_read_fence(file.geoFence) if file.geoFence else None,
        rally=[_rally_point(place) for place in file.rallyPoints.points] if file.rallyPoints else None,
        home=home,
        firmware=mission.firmwareType if mission else 3,
        vehicle=mission.vehicleType if mission else 2,
    )


def write(plan: Plan, enums: Enums) -> bytes:
    """A ``.plan`` file's bytes; raises :class:`BadInput` for items that the format cannot hold."""
    places = [item for item in plan.mission or [] if item.frame.startswith("MAV_FRAME_GLOBAL") and (item.x or item.y)]
    home = plan.home or ((places[0].x, places[0].y, 0.0) if places else (0.0, 0.0, 0.0))
    mission = {
        "cruiseSpeed": 15,
        "firmwareType": plan.firmware,
        "globalPlanAltitudeMode": 1,
        "hoverSpeed": 5,
        "items": [_write_item(i, item, enums) for i, item in enumerate(plan.mission or [])],
        "plannedHomePosition": list(home),
        "vehicleType": plan.vehicle,
        "version": 2,
    }
    file = {
        "fileType": "Plan",
        "geoFence": _write_fence(plan.fence or []),
        "groundStation": "QGroundControl",
        "mission": mission,
        "rallyPoints": {"points": [_write_rally(i, item) for i, item in enumerate(plan.rally or [])], "version": 2},
        "version": 1,
    }
    return msgspec.json.format(msgspec.json.encode(file), indent=4) + b"\n"


# Missions.


def _read_mission(part: _MissionPart, enums: Enums, name: str) -> list[MissionItem]:
    found: list[tuple[str, _Simple]] = []
    for i, item in enumerate(part.items):
        path = f"$.mission.items[{i}]"
        if isinstance(item, _Simple):
            found.append((path, item))
        elif item.TransectStyleComplexItem is None:
            kind = item.complexItemType
            raise _bad(name, path, f"a complex item ({kind}) without the simple items generated for it")
        else:
            inside = f"{path}.TransectStyleComplexItem.Items"
            found += [(f"{inside}[{k}]", simple) for k, simple in enumerate(item.TransectStyleComplexItem.Items)]
    index_of: dict[int, int | None] = {}
    for i, (_, item) in enumerate(found):
        if item.doJumpId is not None:
            index_of[item.doJumpId] = None if item.doJumpId in index_of else i
    for i, (_, item) in enumerate(found):
        if item.doJumpId is None:
            index_of.setdefault(i + 1, i)
    return [_read_item(item, path, index_of, enums, name) for path, item in found]


def _read_item(item: _Simple, path: str, index_of: Mapping[Any, int | None], enums: Enums, name: str) -> MissionItem:
    if len(item.params) != 7:
        raise _bad(name, f"{path}.params", f"{len(item.params)} values, expected 7")
    try:
        command, frame = command_name(item.command, enums), frame_name(item.frame, enums)
    except BadInput as e:
        raise _bad(name, f"{path}.{e.detail['field']}", e.message) from None
    params, place = item.params[:4], [value or 0.0 for value in item.params[4:]]
    if command == DO_JUMP:
        target = index_of.get(params[0] or 0)
        if target is None:
            why = "two items have: give each its own" if params[0] in index_of else "no item has"
            raise _bad(name, f"{path}.params[0]", f"jumps to the doJumpId {params[0]}, which {why}")
        params[0] = float(target)
    x, y, z = place
    return MissionItem(command=command, frame=frame, params=params, x=x, y=y, z=z, autocontinue=item.autoContinue)


def _write_item(index: int, item: MissionItem, enums: Enums) -> dict[str, Any]:
    params: list[float | None] = list(numbers(item))
    if item.command == DO_JUMP:
        params[0] = (params[0] or 0.0) + 1.0  # doJumpIds count from 1
    written: dict[str, Any] = {
        "autoContinue": item.autocontinue,
        "command": command_number(item.command, enums),
        "doJumpId": index + 1,
        "frame": frame_number(item.frame, enums),
        "params": [*params, item.x, item.y, item.z],
        "type": "SimpleItem",
    }
    mode = ALTITUDE_MODES.get(item.frame.removesuffix("_INT"))
    if mode is not None:
        above_sea = item.z if mode == 2 else None  # QGroundControl works it out from the terrain
        written = {"AMSLAltAboveTerrain": above_sea, "Altitude": item.z, "AltitudeMode": mode, **written}
    return written


# Fences and rally points.


def _read_fence(part: _FencePart) -> list[MissionItem]:
    shapes: list[fence.Shape] = [fence.Polygon(tuple(each.polygon), each.inclusion) for each in part.polygons]
    shapes += [fence.Circle(each.circle.center, each.circle.radius, each.inclusion) for each in part.circles]
    if part.breachReturn is not None:
        shapes.append(fence.Return(part.breachReturn))
    return fence.items(shapes)


def _write_fence(items: Sequence[MissionItem]) -> dict[str, Any]:
    written: dict[str, Any] = {"circles": [], "polygons": [], "version": 2}
    for shape in fence.shapes(items):
        if isinstance(shape, fence.Polygon):
            polygon = [list(vertex) for vertex in shape.vertices]
            written["polygons"].append({"inclusion": shape.inclusion, "polygon": polygon, "version": 1})
        elif isinstance(shape, fence.Circle):
            circle = {"center": list(shape.center), "radius": shape.radius}
            written["circles"].append({"circle": circle, "inclusion": shape.inclusion, "version": 1})
        elif "breachReturn" in written:
            raise BadInput("a .plan holds one return point of the fence", field="fence", expected="one return point")
        else:
            written["breachReturn"] = list(shape.place)
    return written


def _rally_point(place: Place) -> MissionItem:
    return MissionItem(command=RALLY, frame=RELATIVE, x=place[0], y=place[1], z=place[2])


def _write_rally(index: int, item: MissionItem) -> list[float]:
    if item.command != RALLY or item.frame.removesuffix("_INT") != RELATIVE:
        text = f"rally point {index} is {item.command} in {item.frame}: a .plan holds {RALLY} in {RELATIVE} alone"
        raise BadInput(text, field=f"rally[{index}]", value=item.frame, expected=RELATIVE)
    return [item.x, item.y, item.z]


def _bad(name: str, path: str, what: str) -> BadInput:
    return BadInput(f"{name}: {path}: {what}", field=path, value=name, expected=what)
