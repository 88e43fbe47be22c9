"""``zmav agent``: programs that run for a vehicle, wherever they run; start, look at, ask and tune them.

Which agent is meant is told by a name, or by a file.
"""

from __future__ import annotations

import asyncio
import contextlib
import importlib.util
import inspect
import re
import sys
import time
import traceback
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

import click
import msgspec

import zmav
from zmav import keys, systemd, wire
from zmav.agent import Agent
from zmav.bus import Alive
from zmav.cli import installed
from zmav.cli.common import (
    Finite,
    Verbs,
    Work,
    assignments,
    connected,
    dump,
    fleet_option,
    json_option,
    run,
    seconds_option,
    show_table,
    zenoh_options,
)
from zmav.cli.vehicles import one
from zmav.config.table import reading
from zmav.errors import BadConfig, BadInput, ZmavError, missing_extra
from zmav.process import say, until_stopped
from zmav.session import SessionSettings
from zmav.subscription import document
from zmav.waiting import alongside, within

GROUP, CONTROLLERS = "zmav.agents", "zmav.controllers"
"""entry points: agents by name, and controllers that an agent runs"""
OURS = ("agents", "zmav")
"""packages of agents whose errors say what was given wrongly, and not in which line of theirs"""
CONTROLLER = "controller"
"""the agent that runs a controller"""


def resolve(what: str) -> tuple[type[Agent], dict[str, Any]]:
    """The agent that is meant, and settings that go with it: of a name, or of a file that holds a class.

    Raises :class:`~zmav.errors.BadInput` for a name that there is not, :class:`BadConfig` for a file that holds none.
    """
    if what.endswith(".py"):
        own = _agent_in(Path(what))
        return (own, {}) if own is not None else (find(CONTROLLER), {"controller": what})
    known = entry_points(group=GROUP).names
    if what not in known and what in entry_points(group=CONTROLLERS).names:
        return find(CONTROLLER), {"controller": what}
    return find(what), {}


def _agent_in(path: Path) -> type[Agent] | None:
    """The agent that a file holds. A controller's file is not run here, but in a process of its own: None."""
    with reading(path, "agent"):
        text = path.read_text(encoding="utf-8", errors="replace")  # what is wrong in it, Python says with its line
    if not re.search(r"^class \w+\(.*\bAgent\b", text, re.MULTILINE):
        return None
    name = f"zmav_agent_file_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # where the types in its annotations are looked up
    try:
        spec.loader.exec_module(module)
    except Exception as e:
        text = f"{path}:\n{own_lines(e, str(path))}"
        raise BadConfig(text, field="name", value=str(path), expected="an agent") from e
    found = [
        each
        for each in vars(module).values()
        if isinstance(each, type) and issubclass(each, Agent) and each.__module__ == name
    ]
    if len(found) != 1 or not hasattr(found[0], "name"):
        names = ", ".join(each.__name__ for each in found) or "none"
        text = f"{path} holds {names}; expected one class derived from zmav.Agent, with a name"
        raise BadConfig(text, field="name", value=str(path), expected="one agent")
    return found[0]


def own_lines(error: Exception, file: str) -> str:
    """A traceback from the first line in ``file`` on: what called that is not its author's. All of it where none is; of
    what Python cannot read, only where.
    """
    at = error.__traceback__
    while at is not None and Path(at.tb_frame.f_code.co_filename).resolve() != Path(file).resolve():
        at = at.tb_next
    shown = error.__traceback__ if at is None and not isinstance(error, SyntaxError) else at
    return "".join(traceback.format_exception(type(error), error, shown, chain=at is None)).rstrip()


def find(name: str) -> type[Agent]:
    """The agent of that name; raises :class:`~zmav.errors.BadInput` naming those there are."""
    known: dict[str, EntryPoint] = {point.name: point for point in entry_points(group=GROUP)}
    if name not in known:
        names = ", ".join(sorted(known)) or "none installed"
        raise BadInput(f"no agent {name!r}; there are: {names}", field="name", value=name, expected=names)
    try:
        kind = known[name].load()
    except ImportError as e:
        raise missing_extra(f"the agent {name}", e.name, "vision") from e
    if not (isinstance(kind, type) and issubclass(kind, Agent)):
        raise BadConfig(f"{known[name].value} is no zmav.Agent", field="name", value=name, expected="a zmav.Agent")
    return kind


def settings_of(kind: type[Agent], values: dict[str, Any]) -> msgspec.Struct:
    """The settings of an agent of that kind; raises :class:`BadInput` naming those there are."""
    try:
        return msgspec.convert(values, kind.settings_type, strict=False)
    except msgspec.ValidationError as e:
        known = ", ".join(field.name for field in msgspec.structs.fields(kind.settings_type)) or "none"
        raise BadInput(f"{kind.name}: {e}; settings: {known}", field="option", value=values, expected=known) from e


vehicle_option = click.option("--vehicle", required=True, help="The vehicle that it runs for.")


@click.group("agent", cls=Verbs, points="zmav.agent.verbs")
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
            raise BadInput.wrong(name, value, "a number")
    file = inspect.getfile(kind)
    try:
        await _live(kind, vehicle, own, tuned, fleet, settings)
    except BadInput as e:
        lines = traceback.extract_tb(e.__traceback__)
        called = [line for path, line, *_ in lines if Path(path).resolve() == Path(file).resolve()]
        if not called or kind.__module__.partition(".")[0] in OURS:
            raise
        raise type(e)(f"{e} ({file}, line {called[-1]})", **e.detail) from e
    except ZmavError:
        raise
    except Exception as e:
        raise ZmavError(f"{kind.name} failed:\n{own_lines(e, file)}") from e


async def _live(
    kind: type[Agent], vehicle: str, own: msgspec.Struct, tuned: dict[str, Any], fleet: str, settings: SessionSettings
) -> None:
    async with zmav.open(fleet=fleet, settings=settings) as z:
        agent = kind(z, vehicle, own, tuned)
        async with agent:
            line = f"{vehicle}/{agent.name}: runs"
            say(line)
            agent.bus.on(Alive, lambda told: systemd.notify("WATCHDOG=1"))
            systemd.notify("READY=1", f"STATUS={line}")
            async with alongside(agent.run(), until_stopped()) as (working, stopped):
                try:
                    await asyncio.wait({working, stopped}, return_when=asyncio.FIRST_COMPLETED)
                finally:
                    systemd.notify("STOPPING=1")
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
    click.echo((kind.__doc__ or "").strip())
    defaults = (
        (field.name, "required" if field.required else dump(msgspec.to_builtins(field.default)))
        for field in msgspec.structs.fields(kind.settings_type)
    )
    show_table(("setting", "default"), defaults)
    tunables = (
        (name, f"{each.default:g}", f"{each.low:g} to {each.high:g}", each.unit, each.doc)
        for name, each in kind.tunables.items()
    )
    show_table(("parameter", "default", "bounds", "unit", ""), tunables)
    show_table(("order", ""), ((verb.name, verb.doc) for verb in kind.verbs.values()))


@command.command("list")
@click.argument("vehicles", default="*")
@seconds_option
@json_option
@connected
def list_(vehicles: str, seconds: float, as_json: bool) -> Work:
    """Show the agents that are installed on this computer, with their units, and all that are heard."""
    installed.show(as_json)

    async def listen(z: zmav.Client) -> None:
        found: dict[tuple[str, str], wire.AgentStatus] = {}

        async def hear() -> None:
            where = keys.AGENT_STATUS.key(z.fleet_name, vehicles, agent="*")
            async with z.subscribe(where, document(wire.AgentStatus)) as statuses:
                async for key, status in statuses:
                    found[key.split("/")[2], status.agent] = status

        with contextlib.suppress(asyncio.TimeoutError):
            await within(seconds, hear())
        if as_json:
            for (vehicle, _), status in sorted(found.items()):
                click.echo(dump({"vehicle": vehicle, **msgspec.to_builtins(status)}))
        elif found:
            rows = (
                (vehicle, agent, status.state, f"{time.time() - status.t:.1f} s", status.text)
                for (vehicle, agent), status in sorted(found.items())
            )
            show_table(("vehicle", "agent", "state", "age", "text"), rows)
        else:
            click.echo(f"no agent was heard within {seconds:g} s", err=True)

    return listen


@command.command("do")
@click.argument("agent")
@click.argument("verb")
@click.argument("arguments", nargs=-1, metavar="[NAME=VALUE]...")
@vehicle_option
@connected
def do(agent: str, verb: str, arguments: tuple[str, ...], vehicle: str) -> Work:
    """Give an agent an order: 'zmav agent do follower follow target=rover1 --vehicle quad1'."""
    return _order(agent, verb, assignments(arguments), vehicle)


@command.group("param")
def param() -> None:
    """Parameters of agents, changed while they run."""


@param.command("list")
@click.argument("agent")
@vehicle_option
@connected
def param_list(agent: str, vehicle: str) -> Work:
    """Show an agent's parameters: 'zmav agent param list follower --vehicle quad1'."""

    async def ask(z: zmav.Client) -> None:
        result = await (await one(z, vehicle)).tell(agent, "params")
        known = {name: msgspec.convert(raw, wire.TunableInfo) for name, raw in result.items()}
        rows = (
            (name, f"{each.value:g}", f"{each.default:g}", f"{each.low:g} to {each.high:g}", each.unit, each.doc)
            for name, each in known.items()
        )
        show_table(("parameter", "value", "default", "bounds", "unit", ""), rows)

    return ask


@param.command("set")
@click.argument("agent")
@click.argument("name")
@click.argument("value", type=Finite())
@vehicle_option
@connected
def param_set(agent: str, name: str, value: float, vehicle: str) -> Work:
    """Change a parameter: 'zmav agent param set follower gain 1.2 --vehicle quad1'."""
    return _order(agent, "set", {"name": name, "value": value}, vehicle)


def _order(agent: str, verb: str, arguments: dict[str, Any], vehicle: str) -> Work:
    async def give(z: zmav.Client) -> None:
        result = await (await one(z, vehicle)).tell(agent, verb, **arguments)
        words = ", ".join(f"{name} {value}" for name, value in result.items())
        click.echo(f"{vehicle}/{agent}: {verb} done" + (f" ({words})" if words else ""))

    return give


for verb in installed.VERBS:
    command.add_command(verb)
