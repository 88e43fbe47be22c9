"""``zmav mission``: missions, fences and rally points of vehicles and in files."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import click
import msgspec

import zmav
from zmav import wire
from zmav.cli.common import console, dump, fleet_option, force_option, json_option, run, zenoh_options
from zmav.cli.do import matching
from zmav.cli.mission_view import Lines, headline, kept, table
from zmav.errors import BadInput, Unsupported, ZmavError
from zmav.formats import plans
from zmav.formats.items import Plan
from zmav.mavlink import load_dialect
from zmav.session import SessionSettings
from zmav.vehicle.missions import KINDS, plans_of
from zmav.wire import MissionKind

MAV_TYPES = {"copter": 2, "plane": 1, "rover": 10, "boat": 11, "sub": 12, "heli": 4, "vtol": 20}
FIRMWARE = {"ardupilot": 3, "px4": 12}
Work = Callable[[zmav.Vehicle, Callable[[dict[str, Any]], None]], Awaitable[list[dict[str, Any]]]]
"""What is done with one vehicle; gives the lines to be said of it"""

kind_option = click.option("--kind", type=click.Choice(KINDS), help="This kind alone.")
dialect_option = click.option("--dialect", default="ardupilotmega", show_default=True, help="Dialect, by name.")


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
@fleet_option
@json_option
@zenoh_options
def upload(
    vehicles: str,
    file: str,
    kind: MissionKind | None,
    force: bool,
    fleet: str,
    as_json: bool,
    settings: SessionSettings,
) -> None:
    """Replace whole plans: 'zmav mission upload "quad*" survey.plan'.

    Of a .plan its mission, fence and rally points, each where there are any; a .waypoints holds one kind. What fails
    leaves the old plan in force, and says so.
    """
    by_kind = plans_of(file, kind, load_dialect())  # before anybody is asked

    async def work(vehicle: zmav.Vehicle, tell: Callable[[dict[str, Any]], None]) -> list[dict[str, Any]]:
        lines: list[dict[str, Any]] = []
        for each, items in by_kind.items():
            try:
                done = await vehicle.missions.upload(items, each, force=force, progress=tell)
                lines.append({"kind": each, "result": done[each]})
            except ZmavError as e:
                lines.append(_failure(e, kind=each))
        return lines

    def say(line: dict[str, Any]) -> str:
        return f"{line['kind']} uploaded, {line['result']['count']} items{kept(line['result'])}"

    run(_each(vehicles, work, say, fleet, as_json, settings))


@command.command("download")
@click.argument("vehicles")
@click.argument("file", type=click.Path(dir_okay=False))
@kind_option
@fleet_option
@json_option
@zenoh_options
def download(
    vehicles: str, file: str, kind: MissionKind | None, fleet: str, as_json: bool, settings: SessionSettings
) -> None:
    """Read plans into a file: 'zmav mission download quad1 quad1.plan'.

    A .plan takes all three kinds, a .waypoints one (--kind, or the mission). '{vehicle}' in the file's name becomes the
    vehicle's: 'zmav mission download "quad*" "{vehicle}.plan"'.
    """
    whole = Path(file).suffix.lower() == ".plan"
    kinds: tuple[MissionKind, ...] = (kind,) if kind else KINDS if whole else ("mission",)

    async def work(vehicle: zmav.Vehicle, tell: Callable[[dict[str, Any]], None]) -> list[dict[str, Any]]:
        found: dict[str, list[wire.MissionItem]] = {}
        for each in kinds:
            try:
                got = await vehicle.missions.download(each, progress=tell)
                found[each] = got.items
            except Unsupported:  # an autopilot need not have fences
                if len(kinds) == 1:
                    raise
        path, state = file.replace("{vehicle}", vehicle.name), vehicle.last_state
        firmware = FIRMWARE.get(state.autopilot or "", 0) if state else 3
        mav_type = MAV_TYPES.get(state.kind or "", 0) if state else 2
        plan = Plan(**found, firmware=firmware, vehicle=mav_type)  # type: ignore[arg-type]
        plans.save(path, plan, load_dialect().enums)
        return [{"file": path, "result": {each: len(items) for each, items in found.items()}}]

    def say(line: dict[str, Any]) -> str:
        counts = ", ".join(f"{each} {count} items" for each, count in line["result"].items())
        return f"{line['file']}: {counts}"

    run(_each(vehicles, work, say, fleet, as_json, settings, one="{vehicle}" not in file))


@command.command("clear")
@click.argument("vehicles")
@click.option("--kind", type=click.Choice([*KINDS, "all"]), default="mission", show_default=True)
@fleet_option
@json_option
@zenoh_options
def clear(vehicles: str, kind: str, fleet: str, as_json: bool, settings: SessionSettings) -> None:
    """Leave no items: 'zmav mission clear quad1 --kind all'."""
    kinds = [each for each in KINDS if kind in (each, "all")]

    async def work(vehicle: zmav.Vehicle, tell: Callable[[dict[str, Any]], None]) -> list[dict[str, Any]]:
        lines: list[dict[str, Any]] = []
        for each in kinds:
            try:
                await vehicle.missions.clear(each)
                lines.append({"kind": each, "result": {}})
            except ZmavError as e:
                lines.append(_failure(e, kind=each))
        return lines

    run(_each(vehicles, work, lambda line: f"{line['kind']} cleared", fleet, as_json, settings))


@command.command("start")
@click.argument("vehicles")
@click.option("--first", type=click.IntRange(min=0), default=0, show_default=True, help="Item to begin with.")
@click.option("--wait", is_flag=True, help="Until the mission's end.")
@force_option
@fleet_option
@json_option
@zenoh_options
def start(
    vehicles: str, first: int, wait: bool, force: bool, fleet: str, as_json: bool, settings: SessionSettings
) -> None:
    """Fly the mission; the vehicle must be armed: 'zmav mission start quad1 --wait'."""

    async def work(vehicle: zmav.Vehicle, tell: Callable[[dict[str, Any]], None]) -> list[dict[str, Any]]:
        return [{"result": await vehicle.missions.start(first, wait_end=wait, force=force, progress=tell)}]

    words = "at its end" if wait else "started"
    run(_each(vehicles, work, lambda line: f"mission {words}", fleet, as_json, settings))


@command.command("show")
@click.argument("what", metavar="VEHICLES|FILE")
@kind_option
@dialect_option
@fleet_option
@json_option
@zenoh_options
def show(
    what: str, kind: MissionKind | None, dialect: str, fleet: str, as_json: bool, settings: SessionSettings
) -> None:
    """Print plans as tables: 'zmav mission show quad1', 'zmav mission show survey.plan --kind fence'."""
    if Path(what).suffix.lower() in plans.SUFFIXES:
        for each, items in plans_of(what, kind, load_dialect(dialect)).items():
            _print(what, wire.Mission(kind=each, items=items), as_json)
        return
    run(_show(what, kind or "mission", fleet, as_json, settings))


@command.command("convert")
@click.argument("source", type=click.Path(dir_okay=False))
@click.argument("target", type=click.Path(dir_okay=False))
@kind_option
@dialect_option
def convert(source: str, target: str, kind: MissionKind | None, dialect: str) -> None:
    """Write a plan in another format, offline: 'zmav mission convert survey.plan survey.waypoints --kind mission'."""
    enums = load_dialect(dialect).enums
    plan = plans.load(source, enums)
    for each in KINDS:
        if kind not in (None, each):
            setattr(plan, each, None)
    if kind and not getattr(plan, kind):
        raise BadInput(f"{source} holds no {kind}", field="kind", value=kind, expected="a kind it holds")
    plans.save(target, plan, enums)
    counts = [f"{each} {len(getattr(plan, each))} items" for each in KINDS if getattr(plan, each)]
    click.echo(f"{target}: {', '.join(counts) or 'nothing'}")


# How it is done.


async def _each(
    pattern: str,
    work: Work,
    say: Callable[[dict[str, Any]], str],
    fleet: str,
    as_json: bool,
    settings: SessionSettings,
    one: bool = False,
) -> None:
    """Do the work with all vehicles that match, side by side; ends with an error if any of it failed."""
    async with zmav.open(fleet=fleet, settings=settings) as z:
        vehicles = await matching(z, pattern)
        if one and len(vehicles) > 1:
            names = ", ".join(vehicle.name for vehicle in vehicles)
            raise BadInput(f"one file for {names}: put {{vehicle}} into its name", field="file", expected="{vehicle}")
        with Lines(quiet=as_json) as lines:
            found = await asyncio.gather(*(_one(vehicle, work, lines) for vehicle in vehicles))
    failed = False
    for vehicle, told in zip(vehicles, found, strict=True):
        for line in told:
            failed = failed or "error" in line
            words = _fault(line) if "error" in line else say(line)
            click.echo(dump({"vehicle": vehicle.name, **line}, pretty=False) if as_json else f"{vehicle.name}: {words}")
    if failed:
        raise SystemExit(1)


async def _one(vehicle: zmav.Vehicle, work: Work, lines: Lines) -> list[dict[str, Any]]:
    try:
        return await work(vehicle, lambda news: lines.tell(vehicle.name, news))
    except ZmavError as e:
        return [_failure(e)]


def _failure(error: ZmavError, **more: Any) -> dict[str, Any]:
    in_force = {"in_force": error.detail["in_force"]} if "in_force" in error.detail else {}
    return {**more, "error": error.code, "message": error.message, **in_force}


def _fault(line: dict[str, Any]) -> str:
    return f"{line['kind']} not done: {line['message']}" if "kind" in line else f"not done: {line['message']}"


async def _show(pattern: str, kind: MissionKind, fleet: str, as_json: bool, settings: SessionSettings) -> None:
    async with zmav.open(fleet=fleet, settings=settings) as z:
        vehicles = await matching(z, pattern)
        found = await asyncio.gather(*(v.missions.get(kind) for v in vehicles), return_exceptions=True)
    failed = [(v, e) for v, e in zip(vehicles, found, strict=True) if isinstance(e, BaseException)]
    for vehicle, mission in zip(vehicles, found, strict=True):
        if not isinstance(mission, BaseException):
            _print(vehicle.name, mission, as_json)
    for vehicle, error in failed:
        if not isinstance(error, ZmavError):
            raise error
        line = {"vehicle": vehicle.name, **_failure(error)}
        click.echo(dump(line, pretty=False) if as_json else f"{vehicle.name}: {error.message}", err=not as_json)
    if failed:
        raise SystemExit(1)


def _print(name: str, mission: wire.Mission, as_json: bool) -> None:
    if as_json:
        click.echo(dump({"name": name, "mission": msgspec.to_builtins(mission)}, pretty=False))
    else:
        click.echo(click.style(headline(name, mission), bold=True))
        if mission.items:
            console().print(table(mission))
