"""The verbs that give the planner a goal: each builds one, and has it previewed or flown."""

from __future__ import annotations

import asyncio
import functools
import math
from collections.abc import Callable
from typing import Any, get_args

import click

import zmav
from agents.planner.cli.asking import Planner, find
from agents.planner.cli.watching import show_preview, until_ended
from zmav.cli import places
from zmav.cli.common import Between, Finite, Work, connected, json_option, tell
from zmav.wire import Vector, swarm

GROUND, POLYGON = "N,E", "'N,E N,E ...'"
"""what the options' help calls places on the ground"""
Make = Callable[[Planner], swarm.Goal]

vehicles_argument = click.argument("vehicles", nargs=-1, required=True)
tight_option = click.option("--tight", is_flag=True, help="Make no room for what the vehicles' positions may be off.")


def ground(text: str) -> swarm.Corner:
    """``NORTH,EAST``."""
    north, east = places.numbers(text, 2, f"{GROUND}: metres north and east of the origin")
    return (north, east)


def polygon(text: str) -> list[swarm.Corner]:
    """``N,E N,E N,E``: three corners or more."""
    corners = [ground(part) for part in text.replace(";", " ").split()]
    if len(corners) < 3:
        raise click.BadParameter(f"a polygon has three corners or more: 'N,E N,E N,E', not {text!r}")
    return corners


def _targets(arguments: tuple[str, ...]) -> tuple[list[str], list[Vector]]:
    """``quad1=10,20,15``: who, and where to; names without a place are only named."""
    names, wanted = [], []
    for argument in arguments:
        name, equals, where = argument.partition("=")
        names.append(name)
        if equals:
            wanted.append(places.place(where))
    if wanted and len(wanted) != len(names):
        raise click.UsageError("give each vehicle a place (quad1=10,20,15), or none and --to for each place")
    return names, wanted


def goal_options(command: Callable[..., Make]) -> Callable[..., None]:
    """``--queue --preview --no-wait`` and those of every verb, for a command that gives what makes its goal."""

    @click.option("--queue", is_flag=True, help="After what its vehicles do now, not in place of it.")
    @click.option("--preview", is_flag=True, help="Only tell what would be flown.")
    @click.option("--no-wait", is_flag=True, help="Return when it is in the book; 'zmav swarm list' shows it.")
    @json_option
    @connected
    @functools.wraps(command)
    def wrapped(queue: bool, preview: bool, no_wait: bool, as_json: bool, **options: Any) -> Work:
        make = command(**options)
        return lambda z: _order(z, make, queue, preview, no_wait, as_json)

    return wrapped


async def _order(z: zmav.Client, make: Make, queue: bool, preview: bool, no_wait: bool, as_json: bool) -> None:
    planner = await find(z)
    goal = make(planner)
    if preview:
        await show_preview(planner, goal, as_json)
        return
    result = await planner.order("submit", swarm.Submit(goal=goal, when="queue" if queue else "now"))
    name = str(result["goal"])
    if no_wait:
        tell(as_json, result, f"{name} is in the book of {planner.name}")
        return
    await _watch(z, name, as_json)


async def _watch(z: zmav.Client, name: str, as_json: bool) -> None:
    """Until it has ended; exit code 1 unless it is done."""
    try:
        entry = await until_ended(z, name, as_json)
    except asyncio.CancelledError:  # Ctrl-C
        click.echo(f"{name}: goes on; 'zmav swarm cancel {name}' drops it", err=True)
        raise
    if entry.state != "done":
        raise SystemExit(1)


@click.command("goto")
@vehicles_argument
@click.option(
    "--to", "to", type=places.place, metavar=places.PLACE, multiple=True, help="A place; as many as there are vehicles."
)
@click.option("--any", "unlabelled", is_flag=True, help="Anyone who is best placed goes to each.")
@tight_option
@goal_options
def goto(vehicles: tuple[str, ...], to: tuple[Vector, ...], unlabelled: bool, tight: bool) -> Make:
    """Go to places: 'quad1=30,0,15 quad2=0,20,15', or 'quad* --to 30,0,15 --to 0,20,15 --any'.

    Places are metres north and east of the fleet's origin and above it.
    """
    names, places = _targets(vehicles)
    if bool(places) == bool(to):
        raise click.UsageError("where to? 'quad1=NORTH,EAST,ALT ...', or --to for each place")

    def make(planner: Planner) -> swarm.Goal:
        found = planner.one_each(names) if places else planner.names(names)
        return swarm.GoTo(vehicles=found, to=places or list(to), labelled=not unlabelled, tight=tight)

    return make


several = functools.partial(click.option, multiple=True, callback=lambda context, option, values: list(values))
degrees = functools.partial(
    click.option,
    type=Finite(),
    callback=lambda context, option, value: None if value is None else math.radians(value),
)


above_ground_option = click.option(
    "--above-ground",
    type=Between(min=0.0, min_open=True),
    metavar="M",
    help="Metres above the ground, which the lanes follow.",
)


def one_height(height: float | None, above_ground: float | None, name: str) -> tuple[float, bool]:
    """The one that is given, and whether it counts from the ground."""
    if (height is None) == (above_ground is None):
        raise click.UsageError(f"how high? give {name} or --above-ground")
    return (above_ground or 0.0, True) if height is None else (height, False)


def goal_command(
    name: str, kind: Callable[..., swarm.Goal], doc: str, *options: Callable[[Callable[..., None]], Callable[..., None]]
) -> click.Command:
    """A verb whose options are its goal's fields."""

    @goal_options
    def command(vehicles: tuple[str, ...], **fields: Any) -> Make:
        if "above_ground" in fields:
            fields["alt"], fields["above_ground"] = one_height(fields["alt"], fields["above_ground"], "--alt")
        if "alt" in fields:
            fields["height"] = fields.pop("alt")
        return lambda planner: kind(vehicles=planner.names(vehicles), **fields)

    for option in reversed(options):
        command = option(command)
    return click.command(name, help=doc)(vehicles_argument(command))


formation = goal_command(
    "formation",
    swarm.Formation,
    "Stand in a shape: 'quad* --shape vee --at 50,0,20 --heading 90 --spacing 9'.",
    click.option("--shape", type=click.Choice(get_args(swarm.Shape)), default="line", show_default=True),
    click.option(
        "--at",
        type=places.place,
        metavar=places.PLACE,
        required=True,
        help="The shape's centre, or its leader's place.",
    ),
    degrees("--heading", default=0.0, show_default=True, help="Degrees clockwise from north it looks to."),
    click.option("--spacing", type=Finite(), default=5.0, show_default=True, help="Metres between neighbours."),
    several("--via", type=places.place, metavar=places.PLACE, help="A place the centre passes, in shape."),
    several(
        "--point",
        "points",
        type=places.offset,
        metavar=places.OFFSET,
        help="custom: forward, right and up of the centre.",
    ),
    click.option("--in-order", "labelled", is_flag=True, help="The first vehicle gets the first place."),
    tight_option,
)
follow = goal_command(
    "follow",
    swarm.Follow,
    "Stay beside something that moves until cancelled: 'quad1 --leader rover1 --offset -8,0,10'.",
    click.option("--leader", required=True, help="A vehicle, or an obstacle that moves."),
    several(
        "--offset",
        "offsets",
        type=places.motion,
        metavar=places.MOTION,
        help="From the leader, one a vehicle.  [default: staggered south of it, at its height]",
    ),
    click.option("--on-lost", type=click.Choice(["hold", "return", "land"]), default="hold", show_default=True),
    click.option(
        "--lost-after", type=Finite(), default=3.0, show_default=True, help="Seconds without a word of the leader."
    ),
)
search = goal_command(
    "search",
    swarm.Search,
    "Sweep a polygon, split between the vehicles by what each can do.",
    click.option(
        "--polygon",
        type=polygon,
        metavar=POLYGON,
        required=True,
        help="What is to be seen: '0,0 100,0 100,80'.",
    ),
    click.option("--alt", type=Finite(), help="Metres above the origin."),
    above_ground_option,
    degrees("--angle", help="Degrees clockwise from north of the lanes.  [default: the fewest turns]"),
    click.option("--overlap", type=Between(0.0, 0.9), default=0.1, show_default=True),
)
takeoff = goal_command(
    "takeoff",
    swarm.TakeOff,
    "Take off, in an order in which nobody meets: 'quad* --alt 12'.",
    click.option("--alt", type=Finite(), default=10.0, show_default=True, help="Metres above each one's home."),
)
land = goal_command(
    "land",
    swarm.Land,
    "Land.",
    several(
        "--at",
        type=ground,
        metavar=GROUND,
        help="One a vehicle.  [default: below each, or where there is room]",
    ),
)
return_ = goal_command("return", swarm.Return, "Home, each to where it took off, and land there.")
hold = goal_command("hold", swarm.Hold, "Stop along what is being flown, and stay.")

COMMANDS: tuple[click.Command, ...] = (goto, formation, follow, search, takeoff, land, return_, hold)
