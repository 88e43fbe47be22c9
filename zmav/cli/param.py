"""``zmav param``: list, get, set, save, load and compare parameters, of one vehicle or of a fleet."""

from __future__ import annotations

import collections
import fnmatch
import math
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import click
import msgspec

from zmav import wire
from zmav.cli.common import Work, assignments, connected, dump, json_option, show_table, tell
from zmav.cli.progress import Progress
from zmav.cli.vehicles import Line, check_apart, matching, on_all, show, together
from zmav.client import Client
from zmav.errors import BadInput
from zmav.formats import paramfile
from zmav.formats.paramfile import shown
from zmav.mavlink.paramvalue import same
from zmav.vehicle import Difference, Vehicle, differences
from zmav.vehicle.params import own_params, values

MOST_COLUMNS = 6
"""vehicles side by side; more are gathered by their values"""
LACKS = "-"
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
@json_option
@connected
def list_(vehicles: str, pattern: str, refresh: bool, as_json: bool) -> Work:
    """Show parameters by a pattern: 'zmav param list quad1 "WPNAV_*"'."""

    async def read(z: Client) -> None:
        targets = await matching(z, vehicles)
        found = await _tables(targets, refresh)
        rows = [
            (name, param)
            for name, table in found.items()
            for param in sorted(table.params, key=lambda p: p.name)
            if _fits(param.name, pattern)
        ]
        if not rows:
            text = f"no parameter matches {pattern!r}"
            raise BadInput(text, field="pattern", value=pattern, expected="a name or pattern")
        _print(rows, as_json)

    return read


@command.command("get")
@click.argument("vehicles")
@click.argument("names", nargs=-1, required=True, metavar="NAME...")
@json_option
@connected
def get(vehicles: str, names: tuple[str, ...], as_json: bool) -> Work:
    """Show parameters by name, also while the whole set is still being read: 'zmav param get quad1 RTL_ALT'."""

    async def read(z: Client) -> None:
        targets = [(v, name) for v in await matching(z, vehicles) for name in names]
        found = await together([v.params.get(name) for v, name in targets])
        _print([(v.name, param) for (v, _), param in zip(targets, found, strict=True)], as_json)

    return read


@command.command("set")
@click.argument("vehicles")
@click.argument("assigned", nargs=-1, required=True, metavar="NAME=VALUE...")
@json_option
@connected
def set_(vehicles: str, assigned: tuple[str, ...], as_json: bool) -> Work:
    """Set parameters and read them back: 'zmav param set quad1 RTL_ALT=3000 FENCE_ENABLE=1'."""
    wanted = assignments(assigned)
    for name, value in wanted.items():
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise BadInput.wrong(name, value, "a number")

    async def change(v: Vehicle, tell: Any, name: str) -> Line:
        changed: Line = msgspec.to_builtins(await v.params.set(name, wanted[name]))
        return changed

    def words(line: Line) -> str:
        return f"{line['name']} is {shown(line['value'])}"

    return on_all(vehicles, "set", change, words, as_json, [{"name": name} for name in wanted])


@command.command("save")
@click.argument("vehicles")
@click.argument("file")
@click.argument("pattern", default="*")
@connected
def save(vehicles: str, file: str, pattern: str) -> Work:
    """Write parameters to a file: .params for QGroundControl, .param or .parm for Mission Planner.

    'zmav param save quad1 quad1.params'; of several vehicles: 'zmav param save "quad*" backup/{vehicle}.params'.
    """
    form = paramfile.format_of(file)

    async def read(z: Client) -> None:
        targets = await matching(z, vehicles)
        check_apart(targets, file)
        found = await _tables(targets)
        for v in targets:
            table, path, state = found[v.name], Path(file.replace("{vehicle}", v.name)), v.last_state
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
            click.echo(f"{v.name}: {len(params)} parameters written to {path}")

    return read


@command.command("load")
@click.argument("vehicles")
@click.argument("file")
@click.option("-n", "--dry-run", is_flag=True, help="Only show what would change.")
@own_option
@json_option
@connected
def load(vehicles: str, file: str, dry_run: bool, own: bool, as_json: bool) -> Work:
    """Set what a file says and the vehicle has otherwise: 'zmav param load quad1 quad1.params --dry-run'."""
    opened = _open(file)

    async def load_all(z: Client) -> None:
        targets = await matching(z, vehicles)
        found = await _tables(targets)
        plans = {v.name: _changes(opened, found[v.name], v.last_state, own) for v in targets}
        for name, changes in plans.items():
            has = values(found[name])
            for param, value in changes.items():
                was = shown(has[param]) if param in has else "(not listed)"
                document = {"vehicle": name, "name": param, "from": has.get(param), "to": value}
                tell(as_json, document, f"{name}: {param} {was} -> {shown(value)}")
            if dry_run:
                click.echo(f"{name}: {len(changes)} would be set; nothing was sent", err=True)
        if dry_run:
            return
        with Progress("setting", quiet=as_json) as progress:
            tasks = [_load(v, plans[v.name], progress) for v in targets]
            results: list[wire.ParamLoaded] = await together(tasks)
        for name, done in zip(plans, results, strict=True):
            counts = f"{len(done.set)} set, {len(done.unchanged)} unchanged, {len(done.failed)} failed"
            click.echo(f"{name}: {counts}", err=True)
        failed = [
            {"vehicle": name, "name": param, "error": why}
            for name, done in zip(plans, results, strict=True)
            for param, why in done.failed.items()
        ]
        show(failed, lambda line: f"{line['name']} not set: {line['error']}", as_json)

    return load_all


async def _load(v: Vehicle, changes: dict[str, float], progress: Progress) -> wire.ParamLoaded:
    return await v.params.load(changes, partial(progress.tell, v.name)) if changes else wire.ParamLoaded()


def _changes(
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
@own_option
@json_option
@connected
def diff(targets: tuple[str, ...], own: bool, as_json: bool) -> Work:
    """Show what differs: 'zmav param diff "quad*"', 'zmav param diff quad1 quad2', 'zmav param diff quad1 q.params'.

    With a file, only the names in it are compared.
    """
    files = {target: _open(target) for target in targets if _is_file(target)}

    async def compare(z: Client) -> None:
        named = {v.name: v for target in targets if target not in files for v in await matching(z, target)}
        found = await _tables(list(named.values()))
        columns: dict[str, Any] = {name: values(table) for name, table in found.items()}
        compids = {v.last_state.compid or 1 for v in named.values() if v.last_state} or {1}
        for target, file in files.items():
            columns[target] = file.values(min(compids))
        if len(columns) < 2:
            text = f"only {', '.join(columns)} to compare: name a second vehicle, a pattern or a file"
            raise BadInput(text, field="targets", value=list(targets), expected="two at least")
        only = {name for target in files for name in columns[target]} if files else None
        differ = differences(columns, only)
        left_out = set[str]()
        for autopilot in set() if own else {table.autopilot for table in found.values()}:
            left_out |= own_params(autopilot, [each.name for each in differ])
        differ = [each for each in differ if each.name not in left_out]
        if as_json:
            for each in differ:
                click.echo(dump({"name": each.name, "values": {c: each.values.get(c) for c in columns}}))
        elif differ:
            head, rows = comparison(differ, list(columns))
            show_table(head, rows, right=head[1:])
        more = f" ({len(left_out)} more are each vehicle's own: --own shows them)" if left_out else ""
        click.echo(f"{len(differ)} parameters differ among {len(columns)}{more}", err=True)

    return compare


# What they share.


def _is_file(target: str) -> bool:
    """It names a parameter file, and no vehicle."""
    return Path(target).suffix.lower() in paramfile.SUFFIXES or "/" in target


def _open(path: str) -> paramfile.ParamFile:
    """A parameter file's content; raises :class:`BadInput`."""
    try:
        data = Path(path).read_bytes()
    except OSError as e:
        raise BadInput(f"cannot read {path}: {e.strerror}", field="file", value=path) from e
    return paramfile.read(data, path)


async def _tables(vehicles: list[Vehicle], refresh: bool = False) -> dict[str, wire.ParamTable]:
    """The whole sets, by vehicle; raises the first error, if any."""
    with Progress("reading parameters") as progress:
        asked = [(v.params.refresh if refresh else v.params.list)(partial(progress.tell, v.name)) for v in vehicles]
        return dict(zip((v.name for v in vehicles), await together(asked), strict=True))


def _fits(name: str, pattern: str) -> bool:
    return any(fnmatch.fnmatchcase(name, each) for each in (pattern, pattern.upper()))


def _print(rows: list[tuple[str, wire.Param]], as_json: bool) -> None:
    """Parameters by vehicle; the vehicle's column only where there are several."""
    if as_json:
        for name, p in rows:
            click.echo(dump({"vehicle": name, "name": p.name, "value": p.value, "type": p.type}))
        return
    several = len({name for name, _ in rows}) > 1
    table = [[*([name] if several else []), p.name, shown(p.value), p.type] for name, p in rows]
    show_table([*(["vehicle"] if several else []), "name", "value", "type"], table, right=("value",))


def comparison(found: Sequence[Difference], columns: Sequence[str]) -> tuple[list[str], Iterable[list[str]]]:
    """Head and rows of the names that differ, a column for each vehicle; of many vehicles who has which value, the
    commonest first.
    """

    def cell(each: Difference, column: str) -> str:
        return shown(each.values[column]) if column in each.values else LACKS

    if len(columns) <= MOST_COLUMNS:
        return ["name", *columns], [[each.name, *(cell(each, c) for c in columns)] for each in found]
    rows = []
    for each in found:
        holders = collections.defaultdict[str, list[str]](list)
        for column in columns:
            holders[cell(each, column)].append(column)
        (most, who), *others = sorted(holders.items(), key=lambda pair: -len(pair[1]))
        rest = "; ".join(f"{value}: {' '.join(names)}" for value, names in others)
        rows.append([each.name, f"{most} ×{len(who)}", rest])
    return ["name", f"most of {len(columns)}", "the others"], rows
