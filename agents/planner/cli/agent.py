"""``zmav swarm planner``: the planning agent."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any, TypeVar

import click

import zmav
from mesh.cli.options import file_option, own_name
from zmav.cli.common import Between, run, zenoh_options
from zmav.config import load_fleet
from zmav.errors import missing_extra
from zmav.formats.tiles import open_source
from zmav.process import say, until_stopped
from zmav.services.files.store import tiles_directory
from zmav.session import SessionSettings
from zmav.trust.credentials import Credentials

F = TypeVar("F", bound=Callable[..., Any])


def _number(name: str, least: float, most: float, default: float, text: str) -> Callable[[F], F]:
    within = Between(least, most)
    return click.option(name, type=within, default=default, show_default=True, help=text)


@click.command("planner")
@click.option("--name", help="Its host's name in keys.  [default: the certificate's, or the computer's]")
@click.option("--standby", is_flag=True, help="Let another take charge, and take over when it is gone.")
@click.option("--fleet", help="The fleet's name.  [default: the fleet file's, $ZMAV_FLEET or demo]")
@file_option
@_number("--margin", 0.0, 20.0, 0.5, "Metres between two vehicles beyond their radii.")
@_number("--tracking", 0.05, 5.0, 0.4, "Metres, of the margin, by which vehicles may be off their ways: more in wind.")
@_number("--downwash", 1.0, 10.0, 1.5, "How much farther above each other than beside each other.")
@_number(
    "--traffic", 0.0, 2000.0, 100.0, "Metres kept from aircraft of 'zmav traffic', beyond what their places may be off."
)
@_number("--patience", 1.0, 600.0, 3.0, "Seconds without a planner after which it takes charge.")
@click.option("--terrain", metavar="FOLDER|FILE.tif|URL", help="Heights of the ground, as for 'zmav terrain load'.")
@click.option("--unknown-batteries", is_flag=True, help="Have vehicles fly that do not say what is left in theirs.")
@click.option("--interpret", is_flag=True, help="Compile nothing: ready at once, for a few vehicles in the open.")
@zenoh_options
def planner(
    name: str | None,
    standby: bool,
    fleet: str | None,
    fleet_file: str | None,
    terrain: str | None,
    interpret: bool,
    settings: SessionSettings,
    **rest: Any,
) -> None:
    """Run the planner: goals in, safe motion of all vehicles out.

    The first one of a fleet takes charge; every other stands by and takes over when it is gone. Give it goals with
    'zmav swarm goto', 'formation', 'takeoff' and so on. SIGTERM ends it: what is in the air comes to rest.
    """
    if interpret:
        os.environ["NUMBA_DISABLE_JIT"] = "1"  # read as numba is loaded, by the solver's process, too
    try:
        from agents.planner.live.field import field_of, ground_of
        from agents.planner.live.settings import PlannerSettings, fence_of
    except ImportError as e:
        raise missing_extra("the planner", e.name, "planner") from e
    host = own_name(name, settings)
    file = load_fleet(fleet_file) if fleet_file else None
    own = Credentials.load(settings.credentials) if settings.credentials else None
    which = fleet or (own.fleet if own else None) or (file.fleet if file else os.environ.get("ZMAV_FLEET", "demo"))
    fences: dict[str, Any] = {"field": field_of(file), "geofence": fence_of(file)} if file else {}
    if terrain is not None:
        fences["ground"] = ground_of(file, open_source(terrain, tiles_directory()))
    run(_planner(PlannerSettings(name=host, fleet=which, standby=standby, **fences, **rest), settings))


async def _planner(own: Any, session: SessionSettings) -> None:
    try:
        from agents.planner.live.agent import Agent
        from agents.planner.solve import jit
    except ImportError as e:
        raise missing_extra("the planner", e.name, "planner") from e
    async with zmav.open(fleet=own.fleet, settings=session) as z, Agent(z, own):
        first = "its first start on this machine compiles it, for half a minute of a core"
        more = "" if jit.compiled() else f"; {first if jit.folder() else f'it is compiled: {jit.NOT_KEPT}'}"
        say(f"{own.fleet}/{own.name}: loading the solver{more}")
        await until_stopped()
        say("ending: what is in the air comes to rest")
