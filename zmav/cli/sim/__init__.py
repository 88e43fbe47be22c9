"""``zmav sim``: simulated vehicles to fly; ``zmav sim VERB`` talks to a simulator that runs.

Each verb is a file of this folder with a ``command``, named in :data:`VERBS`.
"""

from __future__ import annotations

import importlib
from typing import Any

import click

from zmav.cli.sim.run import run_options, run_world

# Verbs that talk to a running simulator, and the files that hold them.
VERBS = {
    "status": "talk",
    "pause": "talk",
    "resume": "talk",
    "speed": "talk",
    "step": "talk",
    "stop": "talk",
    "fault": "fault",
    "pilot": "pilot",
}
HOME_WORDS = 4


class Sim(click.Group):
    """Runs a world where no verb is given."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(VERBS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name not in VERBS:
            return None
        found = getattr(importlib.import_module(f"zmav.cli.sim.{VERBS[name]}"), name)
        assert isinstance(found, click.Command)
        return found

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        return super().parse_args(ctx, _join_home(args))


def _join_home(args: list[str]) -> list[str]:
    """``--home LAT LON AMSL HEADING`` in four words as in one with commas."""
    for i, word in enumerate(args):
        words = args[i + 1 : i + 1 + HOME_WORDS]
        if word == "--home" and len(words) == HOME_WORDS and all(map(_is_number, words)):
            return [*args[: i + 1], ",".join(words), *args[i + 1 + HOME_WORDS :]]
    return args


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


@click.group("sim", cls=Sim, invoke_without_command=True)
@click.pass_context
@run_options
def command(ctx: click.Context, /, **options: Any) -> None:
    """Simulate vehicles that speak as real autopilots do: 'zmav sim', then 'zmav up --link tcp:127.0.0.1:5760'; or
    'zmav sim --px4 1', then 'zmav up --link udpin:127.0.0.1:14540'.

    With a verb, talk to a simulator that runs: 'zmav sim pause'.
    """
    if ctx.invoked_subcommand is None:
        run_world(**options)
        return
    given = [name for name in options if ctx.get_parameter_source(name) is not click.core.ParameterSource.DEFAULT]
    if given and given != ["control"]:
        raise click.UsageError(f"--{given[0].replace('_', '-')} is for a world that begins, not for a verb")
    ctx.obj = options["control"]
