"""``zmav sim``: simulated vehicles to fly; ``zmav sim VERB`` talks to a simulator that runs."""

from __future__ import annotations

from typing import Any

import click

from zmav.cli.sim.run import run_options, run_world
from zmav.cli.sim.talk import fault, pause, pilot, resume, speed, status, step, stop
from zmav.cli.sim.traffic import traffic


@click.group("sim", invoke_without_command=True)
@click.pass_context
@run_options
def command(ctx: click.Context, /, **options: Any) -> None:
    """Simulate vehicles that speak as real autopilots do: 'zmav sim --copters 3 --rovers 1 --up', then 'zmav ls'.

    Without --up nothing runs beside them: 'zmav sim', then 'zmav up --link tcp:127.0.0.1:5760'; or 'zmav sim --px4 1',
    then 'zmav up --link udpin:127.0.0.1:14540'.

    With a verb, talk to a simulator that runs: 'zmav sim pause'.
    """
    if ctx.invoked_subcommand is None:
        run_world(**options)
        return
    given = [name for name in options if ctx.get_parameter_source(name) is not click.core.ParameterSource.DEFAULT]
    if given and given != ["control"]:
        raise click.UsageError(f"--{given[0].replace('_', '-')} is for a world that begins, not for a verb")
    ctx.obj = options["control"]


for verb in (status, pause, resume, speed, step, stop, fault, pilot, traffic):
    command.add_command(verb)
