"""The verbs that ask the planner about goals and obstacles."""

from __future__ import annotations

import time

import click
import msgspec

import zmav
from agents.planner.cli.asking import find, planners
from agents.planner.cli.goals import GROUND, POLYGON, ground, polygon
from agents.planner.cli.watching import few, show_goals
from agents.planner.live.ledger import ENDED
from zmav import keys
from zmav.cli import places
from zmav.cli.common import Finite, Work, connected, dump, json_option, show_table, tell
from zmav.errors import BadInput
from zmav.subscription import document
from zmav.wire import Vector, swarm


def _verb(name: str, words: str, required: bool, doc: str) -> click.Command:
    """An order about one goal, or all."""

    @click.command(name, help=doc)
    @click.argument("goal", required=required, default=None if required else "")
    @json_option
    @connected
    def command(goal: str, as_json: bool) -> Work:
        async def ask(z: zmav.Client) -> None:
            result = await (await find(z)).order(name, swarm.GoalId(goal=goal))
            tell(as_json, result, f"{words}: {', '.join(map(str, result['goals'])) or 'nothing'}")

        return ask

    return command


pause = _verb("pause", "paused", False, "Come to rest along what is flown; GOAL alone, or all.")
resume = _verb("resume", "goes on", False, "Go on with what was paused: GOAL, or all.")
abort = _verb("abort", "cancelled", False, "Come to rest, and drop GOAL or every goal.")
cancel = _verb("cancel", "cancelled", True, "Drop one goal; its vehicles come to rest.")


@click.command("list")
@click.option("--all", "everything", is_flag=True, help="Goals that have ended, too.")
@json_option
@connected
def list_(everything: bool, as_json: bool) -> Work:
    """The planner in charge, its goals, and what happened last."""
    return lambda z: _list(z, everything, as_json)


async def _list(z: zmav.Client, everything: bool, as_json: bool) -> None:
    planner = await find(z)
    others = [name for name in await planners(z) if name != planner.name]
    status = planner.status
    if as_json:
        click.echo(dump({**status, "standby": others}))
        return
    book = msgspec.convert(status["book"], swarm.Book)
    head = f"{planner.name} is in charge (term {status['term']}, {status['state']})"
    head += f"; standing by: {', '.join(others)}" if others else "; nobody stands by"
    click.echo(f"{head}\nit hears {len(planner.vehicles)} vehicles: {few(planner.vehicles, 12) or 'none'}")
    if status["unheard"]:
        click.secho(f"not heard, in the air when last heard: {', '.join(status['unheard'])}", fg="yellow")
    goals = [entry for entry in book.goals if everything or entry.state not in ENDED]
    if goals:
        show_goals(goals)
    else:
        click.echo("no goals" if everything or not book.goals else "no open goals (--all shows those that have ended)")
    for event in status["events"][-8:]:
        at = time.strftime("%H:%M:%S", time.localtime(event["t"]))
        click.secho(f"{at} {event['text']}", dim=event["severity"] == "info")


@click.group("obstacle")
def obstacle() -> None:
    """What all plans keep clear of: boxes, cylinders, no-fly polygons, the geofence, things that move."""


@obstacle.command("add")
@click.argument("name")
@click.option("--box", type=places.place, metavar=places.PLACE, nargs=2, help="Two opposite corners.")
@click.option("--cylinder", type=ground, metavar=GROUND, help="The centre; with --radius, --floor, --ceiling.")
@click.option("--no-fly", type=polygon, metavar=POLYGON, help="A polygon; with --floor, --ceiling.")
@click.option(
    "--geofence",
    type=polygon,
    metavar=POLYGON,
    help="A polygon to stay inside of; with --floor, --ceiling.",
)
@click.option(
    "--ball",
    type=places.place,
    metavar=places.PLACE,
    help="Something round; with --radius, and --velocity where it moves.",
)
@click.option("--radius", type=Finite(), default=2.0, show_default=True)
@click.option("--floor", type=Finite(), default=-100.0, show_default=True, help="Metres above the origin.")
@click.option("--ceiling", type=Finite(), default=1000.0, show_default=True)
@click.option("--velocity", type=places.motion, metavar=places.MOTION, help="m/s.")
@click.option("--ttl", type=Finite(), help="Seconds after which it is forgotten.")
@json_option
@connected
def add(
    name: str,
    box: tuple[Vector, Vector] | None,
    cylinder: swarm.Corner | None,
    no_fly: list[swarm.Corner] | None,
    geofence: list[swarm.Corner] | None,
    ball: Vector | None,
    radius: float,
    floor: float,
    ceiling: float,
    velocity: Vector | None,
    ttl: float | None,
    as_json: bool,
) -> Work:
    """Add one, or move it: 'tower --cylinder 40,10 --radius 3 --ceiling 60'."""
    given = [
        swarm.Box(low=box[0], high=box[1]) if box else None,
        swarm.Cylinder(center=cylinder, radius=radius, floor=floor, ceiling=ceiling) if cylinder else None,
        swarm.NoFly(polygon=no_fly, floor=floor, ceiling=ceiling) if no_fly else None,
        swarm.Geofence(polygon=geofence, floor=floor, ceiling=ceiling) if geofence else None,
        swarm.Ball(center=ball, radius=radius, velocity=velocity or (0.0, 0.0, 0.0)) if ball else None,
    ]
    shapes = [each for each in given if each is not None]
    if len(shapes) != 1:
        raise click.UsageError("give one of --box, --cylinder, --no-fly, --geofence and --ball")
    return _give(swarm.Obstacle(name=keys.check_name(name), t=time.time(), what=shapes[0], ttl=ttl), as_json)


@obstacle.command("remove")
@click.argument("name")
@json_option
@connected
def remove(name: str, as_json: bool) -> Work:
    """Forget one."""
    return _give(swarm.Obstacle(name=keys.check_name(name), t=time.time(), what=None), as_json)


def _give(told: swarm.Obstacle, as_json: bool) -> Work:
    async def give(z: zmav.Client) -> None:
        result = await (await find(z)).order("obstacle", swarm.GiveObstacle(obstacle=told))
        if told.what is None and not result["news"]:
            raise BadInput(f"no obstacle is called {told.name}", field="name", value=told.name, expected="a known one")
        word = "forgotten" if told.what is None else "known"
        tell(as_json, result, f"{told.name} is {word}; {result['obstacles']} obstacles in all")

    return give


@obstacle.command("list")
@json_option
@connected
def list_obstacles(as_json: bool) -> Work:
    """All that is kept clear of."""
    return lambda z: _list_obstacles(z, as_json)


async def _list_obstacles(z: zmav.Client, as_json: bool) -> None:
    await find(z)
    key = keys.FLEET.key(z.fleet_name, topic="obstacle")
    async with z.subscribe(key, document(swarm.ObstacleMap)) as maps:
        _, told = await zmav.waiting.within(12.0, maps.get())
    if as_json:
        click.echo(dump(msgspec.to_builtins(told)))
        return
    rows = []
    for each in told.obstacles:
        fields = msgspec.to_builtins(each.what)
        shape = str(fields.pop("shape"))
        where = ", ".join(f"{name} {value}" for name, value in fields.items())
        rows.append((each.name, shape, "-" if each.ttl is None else f"{each.ttl:g} s", where))
    show_table(("name", "shape", "ttl", ""), rows)
    click.echo(f"{len(told.obstacles)} obstacles")


COMMANDS: tuple[click.Command, ...] = (pause, resume, abort, cancel, list_, obstacle)
