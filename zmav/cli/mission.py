"""``zmav mission``: missions, fences and rally points of vehicles and in files."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import msgspec

from zmav import wire
from zmav.cli.common import Work, connected, dump, force_option, json_option, show_table
from zmav.cli.vehicles import Line, attempt, fault, for_each, matching, on_all, show
from zmav.client import Client
from zmav.errors import Unsupported
from zmav.formats import plans
from zmav.formats.items import Plan
from zmav.mavlink import load_dialect
from zmav.vehicle import Vehicle
from zmav.vehicle.missions import KINDS, plans_of
from zmav.wire import MissionKind

MAV_TYPES = {"copter": 2, "plane": 1, "rover": 10, "boat": 11, "heli": 4, "vtol": 20}
FIRMWARE = {"ardupilot": 3, "px4": 12}
Tell = Callable[[dict[str, Any]], None]

kind_option = click.option("--kind", type=click.Choice(KINDS), help="This kind alone.")


@click.group("mission")
def command() -> None:
    """Missions, fences and rally points.

    'zmav mission upload "quad*" survey.plan', 'zmav mission start quad1 --wait', 'zmav mission show quad1'.
    """


@command.command("upload")
@click.argument("vehicles")
@click.argument("file", type=click.Path(dir_okay=False))
@kind_option
@force_option
@json_option
@connected
def upload(vehicles: str, file: str, kind: MissionKind | None, force: bool, as_json: bool) -> Work:
    """Replace whole plans: 'zmav mission upload "quad*" survey.plan'.

    Of a .plan its mission, fence and rally points, each where there are any; a .waypoints holds one kind. What fails
    leaves the old plan in force, and says so.
    """
    by_kind = plans_of(file, kind, load_dialect())

    async def send(vehicle: Vehicle, tell: Tell, kind: MissionKind) -> Line:
        done = await vehicle.missions.upload(by_kind[kind], kind, force=force, progress=tell)
        return {"result": done[kind]}

    def words(line: Line) -> str:
        return f"{line['kind']} uploaded, {line['result']['count']} items{_kept(line['result'])}"

    return on_all(vehicles, "upload", send, words, as_json, [{"kind": each} for each in by_kind])


@command.command("download")
@click.argument("vehicles")
@click.argument("file", type=click.Path(dir_okay=False))
@kind_option
@json_option
@connected
def download(vehicles: str, file: str, kind: MissionKind | None, as_json: bool) -> Work:
    """Read plans into a file: 'zmav mission download quad1 quad1.plan'.

    A .plan takes all three kinds, a .waypoints one (--kind, or the mission). '{vehicle}' in the file's name becomes the
    vehicle's: 'zmav mission download "quad*" "{vehicle}.plan"'.
    """
    whole = Path(file).suffix.lower() == ".plan"
    kinds: tuple[MissionKind, ...] = (kind,) if kind else KINDS if whole else ("mission",)

    async def read(vehicle: Vehicle, tell: Tell) -> Line:
        found: dict[str, list[wire.MissionItem]] = {}
        for each in kinds:
            try:
                found[each] = (await vehicle.missions.download(each, progress=tell)).items
            except Unsupported:  # an autopilot need not have fences
                if len(kinds) == 1:
                    raise
        path, state = file.replace("{vehicle}", vehicle.name), vehicle.last_state
        firmware = FIRMWARE.get(state.autopilot or "", 0) if state else 3
        mav_type = MAV_TYPES.get(state.kind or "", 0) if state else 2
        plan = Plan(**found, firmware=firmware, vehicle=mav_type)  # type: ignore[arg-type]
        plans.save(path, plan, load_dialect().enums)
        return {"file": path, "result": {each: len(items) for each, items in found.items()}}

    def words(line: Line) -> str:
        counts = ", ".join(f"{each} {count} items" for each, count in line["result"].items())
        return f"{line['file']}: {counts}"

    return on_all(vehicles, "download", read, words, as_json, file=file)


@command.command("clear")
@click.argument("vehicles")
@click.option("--kind", type=click.Choice([*KINDS, "all"]), default="mission", show_default=True)
@json_option
@connected
def clear(vehicles: str, kind: str, as_json: bool) -> Work:
    """Leave no items: 'zmav mission clear quad1 --kind all'."""

    async def empty(vehicle: Vehicle, tell: Tell, kind: MissionKind) -> Line:
        await vehicle.missions.clear(kind)
        return {"result": {}}

    parts = [{"kind": each} for each in KINDS if kind in (each, "all")]
    return on_all(vehicles, "clear", empty, lambda line: f"{line['kind']} cleared", as_json, parts)


@command.command("start")
@click.argument("vehicles")
@click.option("--first", type=click.IntRange(min=0), default=0, show_default=True, help="Item to begin with.")
@click.option("--wait", is_flag=True, help="Until the mission's end.")
@force_option
@json_option
@connected
def start(vehicles: str, first: int, wait: bool, force: bool, as_json: bool) -> Work:
    """Fly the mission; the vehicle must be armed: 'zmav mission start quad1 --wait'."""

    async def fly(vehicle: Vehicle, tell: Tell) -> Line:
        return {"result": await vehicle.missions.start(first, wait_end=wait, force=force, progress=tell)}

    return on_all(vehicles, "mission", fly, lambda line: f"mission {'at its end' if wait else 'started'}", as_json)


@command.command("show")
@click.argument("vehicles")
@click.option("--kind", type=click.Choice(KINDS), default="mission", show_default=True)
@json_option
@connected
def show_(vehicles: str, kind: MissionKind, as_json: bool) -> Work:
    """Print plans as tables: 'zmav mission show quad1', 'zmav mission show "quad*" --kind fence'."""

    async def read(z: Client) -> None:
        async def on_one(vehicle: Vehicle) -> list[Line]:
            mission = await attempt(_mission(vehicle, kind))
            if "error" in mission:
                return [mission]
            _print(vehicle.name, mission["mission"], as_json)
            return []

        show(await for_each(await matching(z, vehicles), on_one), fault, as_json)

    return read


# How it is done.


async def _mission(vehicle: Vehicle, kind: MissionKind) -> Line:
    return {"mission": await vehicle.missions.get(kind)}


def _kept(result: dict[str, Any]) -> str:
    """What an autopilot keeps otherwise than it was sent, in words."""
    notes = result.get("kept_otherwise", [])
    more = f" and {len(notes) - 3} more" if len(notes) > 3 else ""
    return f"; it keeps otherwise: {'; '.join(notes[:3])}{more}" if notes else ""


def _print(name: str, mission: wire.Mission, as_json: bool) -> None:
    """A plan; for a person to read with ``>`` at the item being flown, and ``*`` at those reached."""
    if as_json:
        click.echo(dump({"name": name, "mission": msgspec.to_builtins(mission)}))
        return
    state = f", {mission.state.lower().replace('_', ' ')}" if mission.state else ""
    click.echo(click.style(f"{name}: {mission.kind}, {len(mission.items)} items{state}", bold=True))
    if mission.items:
        rows = (_row(mission, i, item) for i, item in enumerate(mission.items))
        show_table(("", "item", "command", "frame", "params", "x", "y", "z"), rows, right=("item", "x", "y", "z"))


def _row(mission: wire.Mission, i: int, item: wire.MissionItem) -> list[str]:
    mark = ">" if i == mission.current else "*" if mission.reached is not None and i <= mission.reached else ""
    params = " ".join("-" if value is None else f"{value:g}" for value in item.params)
    command, frame = item.command.removeprefix("MAV_CMD_"), item.frame.removeprefix("MAV_FRAME_")
    return [mark, str(i), command, frame, params, _place(item.x), _place(item.y), f"{item.z:g}"]


def _place(value: float) -> str:
    """Degrees to their seventh digit; whole numbers as they are."""
    return f"{value:g}" if value == math.floor(value) else f"{value:.7f}"
