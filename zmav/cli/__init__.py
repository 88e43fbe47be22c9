"""The shell of verbs: ``zmav VERB``. One verb a file; packages above the library add theirs by entry points."""

from __future__ import annotations

import importlib
import sys
from importlib.metadata import entry_points

import click

from zmav.errors import ZmavError

VERBS = (
    "agent",
    "sim",
    "ls",
    "echo",
    "hz",
    "bw",
    "delay",
    "info",
    "rate",
    "do",
    "command",
    "goto",
    "fly",
    "mission",
    "get",
    "ftp",
    "log",
    "send",
    "signing",
    "doctor",
    "param",
)


class Verbs(click.Group):
    """Loads a verb's file only when the verb is used: ``zmav ls`` need not wait for what the planner imports."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted({*VERBS, *(point.name for point in entry_points(group="zmav.verbs"))})

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name in VERBS:
            found = importlib.import_module(f"zmav.cli.{name}").command
        else:
            points = [point for point in entry_points(group="zmav.verbs") if point.name == name]
            if not points:
                return None
            found = points[0].load()
        assert isinstance(found, click.Command)
        return found


@click.group(cls=Verbs, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="zmav")
def zmav() -> None:
    """One key space for a swarm of vehicles: MAVLink over Zenoh.

    'zmav demo' flies three simulated copters; 'zmav up' runs beside an autopilot; 'zmav ls' shows who is there.
    """


def main() -> None:
    """The ``zmav`` program: 0 done, 1 an error that is said, 2 wrong usage, 130 interrupted."""
    try:
        code = zmav(standalone_mode=False)
    except click.ClickException as e:
        e.show()
        sys.exit(e.exit_code)
    except ZmavError as e:
        click.echo(f"zmav: {e}", err=True)
        sys.exit(1)
    except (click.Abort, KeyboardInterrupt):
        sys.exit(130)
    sys.exit(code if isinstance(code, int) else 0)
