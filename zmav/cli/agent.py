"""``zmav agent``: programs that run for a vehicle, wherever they run; start, look at, ask and tune them."""

from __future__ import annotations

import asyncio
import contextlib
import sys
import time
from importlib.metadata import entry_points
from typing import Any

import click
import msgspec
from rich.table import Table

import zmav
from zmav import keys, systemd, wire
from zmav.agent import Agent
from zmav.bus import Alive
from zmav.cli import installed
from zmav.cli.agentkind import resolve, settings_of
from zmav.cli.common import assignments, console, dump, fleet_option, json_option, run, seconds_option, zenoh_options
from zmav.errors import BadInput
from zmav.process import say, until_stopped
from zmav.session import SessionSettings
from zmav.waiting import within

VERBS = "zmav.agent.verbs"
"""entry points: verbs of packages above the library"""
vehicle_option = click.option("--vehicle", required=True, help="The vehicle that it runs for.")


class Group(click.Group):
    """Takes verbs of the packages above the library in."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted({*super().list_commands(ctx), *(point.name for point in entry_points(group=VERBS))})

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        own = super().get_command(ctx, name)
        if own is not None:
            return own
        found = [point for point in entry_points(group=VERBS) if point.name == name]
        if not found:
            return None
        verb: click.Command = found[0].load()
        return verb


@click.group("agent", cls=Group)
def command() -> None:
    """Agents: 'zmav agent run helipad --vehicle quad1', 'zmav agent list', 'zmav agent about follower'.

    An agent runs on board or on the ground alike: it meets the vehicle in the key space.
    """


@command.command("run")
@click.argument("name")
@vehicle_option
@click.option("-o", "--option", "options", multiple=True, metavar="NAME=VALUE", help="A setting (repeatable).")
@click.option("--set", "tuned", multiple=True, metavar="NAME=VALUE", help="A parameter to begin with (repeatable).")
@fleet_option
@zenoh_options
def run_(
    name: str, vehicle: str, options: tuple[str, ...], tuned: tuple[str, ...], fleet: str, settings: SessionSettings
) -> None:
    """Run an agent until SIGTERM or Ctrl-C, or until it has done what it does.

    NAME is an agent, a controller (ev1, ev2...), or a Python file that holds a class of either: 'zmav agent run
    my_controller.py --vehicle hex1'. 'zmav agent about NAME' shows its settings, parameters and orders.
    """
    kind, given = resolve(name)
    own = settings_of(kind, {**given, **assignments(options)})
    run(_run(kind, vehicle, own, assignments(tuned), fleet, settings))


async def _run(
    kind: type[Agent], vehicle: str, own: msgspec.Struct, tuned: dict[str, Any], fleet: str, settings: SessionSettings
) -> None:
    for name, value in tuned.items():
        if not isinstance(value, (int, float)):
            raise BadInput(f"{name}={value!r}; expected a number", field=name, value=value, expected="a number")
    async with zmav.open(fleet=fleet, settings=settings) as z:
        agent = kind(z, vehicle, own, tuned)
        async with agent:
            line = f"{vehicle}/{agent.name}: runs"
            say(line)
            agent.bus.on(Alive, lambda told: systemd.notify("WATCHDOG=1"))
            systemd.notify("READY=1", f"STATUS={line}")
            working, stopped = asyncio.create_task(agent.run()), asyncio.create_task(until_stopped())
            try:
                await asyncio.wait({working, stopped}, return_when=asyncio.FIRST_COMPLETED)
            finally:
                systemd.notify("STOPPING=1")
                for task in (working, stopped):
                    task.cancel()
                await asyncio.gather(working, stopped, return_exceptions=True)
            if not working.cancelled() and (error := working.exception()) is not None:
                raise error


@command.command("serve")
@click.argument("name")
@click.option("--directory", metavar="DIR", help="Where it was installed.  [default: /etc/zmav/agents.d]")
@click.option("--check", is_flag=True, help="Only look whether it can be run.")
@zenoh_options
def serve(name: str, directory: str | None, check: bool, settings: SessionSettings) -> None:
    """Run an agent that 'zmav agent install' has installed, in this terminal, as its unit does."""
    sys.dont_write_bytecode = True  # beside the agent, in /etc
    found = installed.read(name, directory)
    kind, given = resolve(found.what(directory))
    own = settings_of(kind, {**given, **found.options})
    if check:
        kind.check(own)
    else:
        run(_run(kind, found.vehicle, own, found.set, found.fleet, settings))


@command.command("about")
@click.argument("name")
def about(name: str) -> None:
    """Show what an agent is, its settings, parameters and orders."""
    kind, _ = resolve(name)
    out = console()
    out.print((kind.__doc__ or "").strip(), markup=False)
    table = Table("setting", "default", box=None, pad_edge=False, header_style="bold")
    for field in msgspec.structs.fields(kind.settings_type):
        default = "required" if field.required else dump(msgspec.to_builtins(field.default), pretty=False)
        table.add_row(field.name, default)
    out.print(table)
    table = Table("parameter", "default", "bounds", "unit", "", box=None, pad_edge=False, header_style="bold")
    for parameter, each in kind.tunables.items():
        table.add_row(parameter, f"{each.default:g}", f"{each.low:g} to {each.high:g}", each.unit, each.doc)
    out.print(table)
    table = Table("order", "", box=None, pad_edge=False, header_style="bold")
    for verb in kind.verbs.values():
        table.add_row(verb.name, verb.doc)
    out.print(table)


@command.command("list")
@click.argument("vehicles", default="*")
@seconds_option
@fleet_option
@json_option
@zenoh_options
def list_(vehicles: str, seconds: float, fleet: str, as_json: bool, settings: SessionSettings) -> None:
    """Show the agents that are installed on this computer, with their units, and all that are heard."""
    installed.show(as_json)
    run(_list(vehicles, seconds, fleet, as_json, settings))


async def _list(vehicles: str, seconds: float, fleet: str, as_json: bool, settings: SessionSettings) -> None:
    found: dict[tuple[str, str], wire.AgentStatus] = {}
    async with zmav.open(fleet=fleet, settings=settings) as z:
        key = keys.AGENT_STATUS.key(fleet, vehicles, agent="*")

        def take(sample: Any) -> None:
            status = wire.decode(sample.payload.to_bytes(), wire.AgentStatus, "status")
            found[str(sample.key_expr).split("/")[2], status.agent] = status

        async with z.subscribe(key, take) as heard:
            with contextlib.suppress(asyncio.TimeoutError):
                await within(seconds, _read(heard))
    if as_json:
        for (vehicle, _), status in sorted(found.items()):
            click.echo(dump({"vehicle": vehicle, **msgspec.to_builtins(status)}, pretty=False))
        return
    if not found:
        click.echo(f"no agent was heard within {seconds:g} s", err=True)
        return
    table = Table("vehicle", "agent", "state", "age", "text", box=None, pad_edge=False, header_style="bold")
    for (vehicle, agent), status in sorted(found.items()):
        table.add_row(vehicle, agent, status.state, f"{time.time() - status.t:.1f} s", status.text)
    console().print(table)


async def _read(heard: zmav.Subscription[None]) -> None:
    async for _ in heard:
        pass


@command.command("do")
@click.argument("agent")
@click.argument("verb")
@click.argument("arguments", nargs=-1, metavar="[NAME=VALUE]...")
@vehicle_option
@fleet_option
@zenoh_options
def do(agent: str, verb: str, arguments: tuple[str, ...], vehicle: str, fleet: str, settings: SessionSettings) -> None:
    """Give an agent an order: 'zmav agent do follower follow target=rover1 --vehicle quad1'."""
    run(_tell(agent, verb, assignments(arguments), vehicle, fleet, settings))


@command.group("param")
def param() -> None:
    """Parameters of agents, changed while they run."""


@param.command("list")
@click.argument("agent")
@vehicle_option
@fleet_option
@zenoh_options
def param_list(agent: str, vehicle: str, fleet: str, settings: SessionSettings) -> None:
    """Show an agent's parameters: 'zmav agent param list follower --vehicle quad1'."""
    run(_tell(agent, "params", {}, vehicle, fleet, settings, table=True))


@param.command("set")
@click.argument("agent")
@click.argument("name")
@click.argument("value", type=float)
@vehicle_option
@fleet_option
@zenoh_options
def param_set(agent: str, name: str, value: float, vehicle: str, fleet: str, settings: SessionSettings) -> None:
    """Change a parameter: 'zmav agent param set follower gain 1.2 --vehicle quad1'."""
    run(_tell(agent, "set", {"name": name, "value": value}, vehicle, fleet, settings))


async def _tell(
    agent: str,
    verb: str,
    arguments: dict[str, Any],
    vehicle: str,
    fleet: str,
    settings: SessionSettings,
    table: bool = False,
) -> None:
    async with zmav.open(fleet=fleet, settings=settings) as z:
        (target,) = await z.wait_for(vehicle, timeout=5.0)
        result = await target.tell(agent, verb, **arguments)
    if not table:
        words = ", ".join(f"{name} {value}" for name, value in result.items())
        click.echo(f"{vehicle}/{agent}: {verb} done" + (f" ({words})" if words else ""))
        return
    rows = Table("parameter", "value", "default", "bounds", "unit", "", box=None, pad_edge=False, header_style="bold")
    for name, raw in result.items():
        each = msgspec.convert(raw, wire.TunableInfo)
        bounds = f"{each.low:g} to {each.high:g}"
        rows.add_row(name, f"{each.value:g}", f"{each.default:g}", bounds, each.unit, each.doc)
    console().print(rows)


for verb in installed.VERBS:
    command.add_command(verb)
