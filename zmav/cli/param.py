"""``zmav param``: list, get, set, save, load and compare parameters, of one vehicle or of a fleet."""

from __future__ import annotations

import asyncio
import fnmatch
import json
import math
from pathlib import Path
from typing import Any

import click
import msgspec
from rich.table import Table

import zmav
from zmav import wire
from zmav.cli.common import assignments, console, dump, fleet_option, json_option, run, zenoh_options
from zmav.cli.do import matching
from zmav.cli.paramtable import Reading, comparison, shown
from zmav.client import Client
from zmav.errors import BadInput, ZmavError
from zmav.formats import paramfile
from zmav.mavlink.paramvalue import same
from zmav.session import SessionSettings
from zmav.vehicle.params import differences, own_params, tables, values

own_option = click.option(
    "--own", is_flag=True, help="Also what is each vehicle's own: system id, counters, ids of sensors, measurements."
)


@click.group("param")
def command() -> None:
    """Parameters: 'zmav param list quad1 "WPNAV_*"', 'zmav param diff "quad*"', 'zmav param save quad1 q.params'."""


@command.command("list")
@click.argument("vehicles")
@click.argument("pattern", default="*")
@click.option("--refresh", is_flag=True, help="Read them again from the autopilot first.")
@fleet_option
@json_option
@zenoh_options
def list_(vehicles: str, pattern: str, refresh: bool, fleet: str, as_json: bool, settings: SessionSettings) -> None:
    """Show parameters by a pattern: 'zmav param list quad1 "WPNAV_*"'."""
    run(_list(vehicles, pattern, refresh, fleet, as_json, settings))


async def _list(
    vehicles: str, pattern: str, refresh: bool, fleet: str, as_json: bool, settings: SessionSettings
) -> None:
    async with zmav.open(fleet=fleet, settings=settings) as z:
        targets = await matching(z, vehicles)
        if refresh:
            await _together([v.params.refresh() for v in targets])
        found = await read(targets)
    by_name = {name: sorted(table.params, key=lambda p: p.name) for name, table in found.items()}
    rows = [(name, p) for name, params in by_name.items() for p in params if _fits(p.name, pattern)]
    if not rows:
        raise BadInput(
            f"no parameter matches {pattern!r}", field="pattern", value=pattern, expected="a name or pattern"
        )
    show(rows, as_json)


@command.command("get")
@click.argument("vehicles")
@click.argument("names", nargs=-1, required=True, metavar="NAME...")
@fleet_option
@json_option
@zenoh_options
def get(vehicles: str, names: tuple[str, ...], fleet: str, as_json: bool, settings: SessionSettings) -> None:
    """Show parameters by name, also while the whole set is still being read: 'zmav param get quad1 RTL_ALT'."""
    run(_get(vehicles, names, fleet, as_json, settings))


async def _get(vehicles: str, names: tuple[str, ...], fleet: str, as_json: bool, settings: SessionSettings) -> None:
    async with zmav.open(fleet=fleet, settings=settings) as z:
        targets = [(v, name) for v in await matching(z, vehicles) for name in names]
        found = await _together([v.params.get(name) for v, name in targets])
    show([(v.name, param) for (v, _), param in zip(targets, found, strict=True)], as_json)


@command.command("set")
@click.argument("vehicles")
@click.argument("assigned", nargs=-1, required=True, metavar="NAME=VALUE...")
@fleet_option
@json_option
@zenoh_options
def set_(vehicles: str, assigned: tuple[str, ...], fleet: str, as_json: bool, settings: SessionSettings) -> None:
    """Set parameters and read them back: 'zmav param set quad1 RTL_ALT=3000 FENCE_ENABLE=1'."""
    wanted = assignments(assigned)
    for name, value in wanted.items():
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise BadInput(f"{name}: {value!r} is not a number", field=name, value=str(value), expected="a number")
    run(_set(vehicles, wanted, fleet, as_json, settings))


async def _set(vehicles: str, wanted: dict[str, float], fleet: str, as_json: bool, settings: SessionSettings) -> None:
    """One after the other on each vehicle, side by side on several; ends with 1 if any was not set."""

    async def on_one(v: zmav.Vehicle) -> list[dict[str, Any]]:
        lines: list[dict[str, Any]] = []
        for name, value in wanted.items():
            try:
                lines.append({"vehicle": v.name, **msgspec.to_builtins(await v.params.set(name, value))})
            except ZmavError as e:
                lines.append({"vehicle": v.name, "name": name, "error": e.code, "message": e.message})
        return lines

    async with zmav.open(fleet=fleet, settings=settings) as z:
        found = await asyncio.gather(*(on_one(v) for v in await matching(z, vehicles)))
    lines = [line for each in found for line in each]
    for line in lines:
        said = f"not set: {line['message']}" if "error" in line else f"is {shown(line['value'])}"
        click.echo(dump(line, pretty=False) if as_json else f"{line['vehicle']}: {line['name']} {said}")
    if any("error" in line for line in lines):
        raise SystemExit(1)


@command.command("save")
@click.argument("vehicles")
@click.argument("file")
@click.argument("pattern", default="*")
@click.option("--format", "form", type=click.Choice(paramfile.FORMATS), help="[default: by the file's ending]")
@fleet_option
@zenoh_options
def save(vehicles: str, file: str, pattern: str, form: str | None, fleet: str, settings: SessionSettings) -> None:
    """Write parameters to a file: .params for QGroundControl, .param or .parm for Mission Planner.

    'zmav param save quad1 quad1.params'; of several vehicles: 'zmav param save "quad*" backup/{vehicle}.params'.
    """
    run(_save(vehicles, file, pattern, paramfile.format_of(file, form), fleet, settings))


async def _save(
    vehicles: str, file: str, pattern: str, form: paramfile.Format, fleet: str, settings: SessionSettings
) -> None:
    async with zmav.open(fleet=fleet, settings=settings) as z:
        targets = await matching(z, vehicles)
        if len(targets) > 1 and "{vehicle}" not in file:
            expected = "a name with {vehicle} in it"
            raise BadInput(f"{len(targets)} vehicles, one file: {file}", field="file", value=file, expected=expected)
        found = await read(targets)
        states = {v.name: v.last_state for v in targets}
    for name, table in found.items():
        path, state = Path(file.replace("{vehicle}", name)), states[name]
        params = [
            paramfile.FileParam(p.name, p.value, p.type, (state and state.compid) or 1)
            for p in table.params
            if _fits(p.name, pattern)
        ]
        about = paramfile.ParamFile(
            format=form,
            params=params,
            sysid=state.sysid if state else None,
            version=table.firmware or "",
            stack={"ardupilot": "ArduPilot", "px4": "PX4 Pro"}.get(table.autopilot, "Generic"),
            vehicle=(state and state.kind) or "",
        )
        try:
            path.write_bytes(paramfile.write(about))
        except OSError as e:
            raise BadInput(f"cannot write {path}: {e.strerror}", field="file", value=str(path)) from e
        click.echo(f"{name}: {len(params)} parameters written to {path}")


@command.command("load")
@click.argument("vehicles")
@click.argument("file")
@click.option("-n", "--dry-run", is_flag=True, help="Only show what would change.")
@own_option
@fleet_option
@json_option
@zenoh_options
def load(
    vehicles: str, file: str, dry_run: bool, own: bool, fleet: str, as_json: bool, settings: SessionSettings
) -> None:
    """Set what a file says and the vehicle has otherwise: 'zmav param load quad1 quad1.params --dry-run'."""
    run(_load(vehicles, open_file(file), dry_run, own, fleet, as_json, settings))


async def _load(
    vehicles: str,
    file: paramfile.ParamFile,
    dry_run: bool,
    own: bool,
    fleet: str,
    as_json: bool,
    settings: SessionSettings,
) -> None:
    async with zmav.open(fleet=fleet, settings=settings) as z:
        targets = await matching(z, vehicles)
        found = await read(targets)
        plans = {v.name: plan(file, found[v.name], v.last_state, own) for v in targets}
        for name, changes in plans.items():
            has = values(found[name])
            for param, value in changes.items():
                line = {"vehicle": name, "name": param, "from": has.get(param), "to": value}
                was = shown(has[param]) if param in has else "(not listed)"
                told = f"{name}: {param} {was} -> {shown(value)}"
                click.echo(dump(line, pretty=False) if as_json else told)
        if dry_run:
            for name, changes in plans.items():
                click.echo(f"{name}: {len(changes)} would be set; nothing was sent", err=True)
            return
        with Reading("setting") as reading:
            tasks = [_load_one(v, plans[v.name], reading) for v in targets]
            results = dict(zip(plans, await _together(tasks), strict=True))
    failed = False
    for name, done in results.items():
        failed |= bool(done.failed)
        for param, why in done.failed.items():
            line = {"vehicle": name, "name": param, "error": why}
            click.echo(dump(line, pretty=False) if as_json else f"{name}: {param} not set: {why}")
        click.echo(f"{name}: {len(done.set)} set, {len(done.unchanged)} unchanged, {len(done.failed)} failed", err=True)
    if failed:
        raise SystemExit(1)


async def _load_one(v: zmav.Vehicle, changes: dict[str, float], reading: Reading) -> wire.ParamLoaded:
    if not changes:
        return wire.ParamLoaded()
    return await v.params.load(changes, lambda news: reading.tell(v.name, news.get("done"), news.get("of")))


def plan(
    file: paramfile.ParamFile, table: wire.ParamTable, state: wire.VehicleState | None, own: bool
) -> dict[str, float]:
    """What of a file differs on the vehicle, but for what is each vehicle's own."""
    wanted = file.values((state and state.compid) or 1)
    left_out = set() if own else own_params(table.autopilot, wanted)
    has = values(table)
    return {
        name: value
        for name, value in wanted.items()
        if value is not None and name not in left_out and not (name in has and same(value, has[name]))
    }


@command.command("diff")
@click.argument("targets", nargs=-1, required=True, metavar="VEHICLE|FILE...")
@click.option("--exit-code", is_flag=True, help="End with 1 where anything differs.")
@own_option
@fleet_option
@json_option
@zenoh_options
def diff(
    targets: tuple[str, ...], exit_code: bool, own: bool, fleet: str, as_json: bool, settings: SessionSettings
) -> None:
    """Show what differs: 'zmav param diff "quad*"', 'zmav param diff quad1 quad2', 'zmav param diff quad1 q.params'.

    With a file, only the names in it are compared.
    """
    run(_diff(targets, exit_code, own, fleet, as_json, settings))


async def _diff(
    targets: tuple[str, ...], exit_code: bool, own: bool, fleet: str, as_json: bool, settings: SessionSettings
) -> None:
    files = {target: open_file(target) for target in targets if is_file(target)}
    columns: dict[str, Any] = {}
    autopilots = set()
    async with zmav.open(fleet=fleet, settings=settings) as z:
        vehicles = await _named(z, [target for target in targets if target not in files])
        for name, table in (await read(vehicles)).items():
            columns[name] = values(table)
            autopilots.add(table.autopilot)
        compids = {v.last_state.compid or 1 for v in vehicles if v.last_state} or {1}
    for target, file in files.items():
        columns[target] = file.values(min(compids))
    if len(columns) < 2:
        text = f"only {', '.join(columns)} to compare: name a second vehicle, a pattern or a file"
        raise BadInput(text, field="targets", value=list(targets), expected="two at least")
    only = {name for target in files for name in columns[target]} if files else None
    found = differences(columns, only)
    left_out: set[str] = set()
    if not own:
        left_out = left_out.union(*(own_params(autopilot, [d.name for d in found]) for autopilot in autopilots))
    found = [each for each in found if each.name not in left_out]
    if as_json:
        for each in found:
            click.echo(json.dumps({"name": each.name, "values": {c: each.values.get(c) for c in columns}}))
    elif found:
        console().print(comparison(found, list(columns)))
    more = f" ({len(left_out)} more are each vehicle's own: --own shows them)" if left_out else ""
    click.echo(f"{len(found)} parameters differ among {len(columns)}{more}", err=True)
    if exit_code and found:
        raise SystemExit(1)


# What they share.


def is_file(target: str) -> bool:
    """It names a parameter file, and no vehicle."""
    return Path(target).suffix.lower() in paramfile.SUFFIXES or "/" in target


def open_file(path: str) -> paramfile.ParamFile:
    """A parameter file's content; raises :class:`BadInput`."""
    try:
        data = Path(path).read_bytes()
    except OSError as e:
        raise BadInput(f"cannot read {path}: {e.strerror}", field="file", value=path) from e
    return paramfile.read(data, path)


async def read(vehicles: list[zmav.Vehicle]) -> dict[str, wire.ParamTable]:
    """The whole sets, by vehicle; raises the first error, if any."""
    with Reading("reading parameters") as reading:
        found = await tables(vehicles, lambda name, news: reading.tell(name, news.get("received"), news.get("count")))
    for each in found.values():
        if isinstance(each, BaseException):
            raise each
    return {name: table for name, table in found.items() if isinstance(table, wire.ParamTable)}


async def _named(z: Client, patterns: list[str]) -> list[zmav.Vehicle]:
    """The vehicles that any of the patterns means, each once."""
    found = {v.name: v for pattern in patterns for v in await matching(z, pattern)}
    return list(found.values())


async def _together(tasks: list[Any]) -> list[Any]:
    """All of them to their ends; then the first error, if any."""
    results = await asyncio.gather(*tasks, return_exceptions=True)
    for result in results:
        if isinstance(result, BaseException):
            raise result
    return list(results)


def _fits(name: str, pattern: str) -> bool:
    return any(fnmatch.fnmatchcase(name, each) for each in (pattern, pattern.upper()))


def show(rows: list[tuple[str, wire.Param]], as_json: bool) -> None:
    """Parameters by vehicle; the vehicle's column only where there are several."""
    several = len({name for name, _ in rows}) > 1
    if as_json:
        for name, p in rows:
            click.echo(dump({"vehicle": name, "name": p.name, "value": p.value, "type": p.type}, pretty=False))
        return
    table = Table(box=None, pad_edge=False, header_style="bold")
    for title in (*(("vehicle",) if several else ()), "name", "value", "type"):
        table.add_column(title, justify="right" if title == "value" else "left", no_wrap=True)
    for name, p in rows:
        table.add_row(*((name,) if several else ()), p.name, shown(p.value), p.type)
    console().print(table)
