"""``zmav command``: any MAV_CMD by name."""

from __future__ import annotations

from typing import Any

import click

from zmav.cli.common import assignments, fleet_option, json_option, run, zenoh_options
from zmav.cli.do import give
from zmav.mavlink import CommandType, command_type, load_dialect
from zmav.session import SessionSettings


@click.command("command")
@click.argument("vehicles")
@click.argument("name")
@click.argument("params", nargs=-1, metavar="[PARAM=VALUE]...")
@click.option("--frame", help="Send it as COMMAND_INT in this MAV_FRAME (GLOBAL_RELATIVE_ALT...); param5/6 in degrees.")
@click.option("--explain", is_flag=True, help="Say what the command's parameters are, and send nothing.")
@click.option("--dialect", default="ardupilotmega", show_default=True, help="With --explain: where to look it up.")
@fleet_option
@json_option
@zenoh_options
def command(
    vehicles: str,
    name: str,
    params: tuple[str, ...],
    frame: str | None,
    explain: bool,
    dialect: str,
    fleet: str,
    as_json: bool,
    settings: SessionSettings,
) -> None:
    """Give any MAV_CMD: 'zmav command quad1 DO_CHANGE_SPEED Speed=5 SpeedType=GROUNDSPEED'.

    Parameters go by the dialect's labels or as param1 to param7; what is not given is 0, and null stands for NaN.
    'zmav command - DO_CHANGE_SPEED --explain' lists them.
    """
    if explain:
        _explain(command_type(load_dialect(dialect), name))
        return
    args: dict[str, Any] = {"command": name, "params": assignments(params), "frame": frame}
    run(give(vehicles, "command", args, fleet, as_json, settings))


def _explain(kind: CommandType) -> None:
    click.echo(click.style(f"{kind.name} ({kind.id})", bold=True))
    click.echo(kind.description)
    for param in kind.params:
        if not param.reserved:
            limits = (("from", param.minimum), ("to", param.maximum))
            bounds = "".join(f"{word} {value:g} " for word, value in limits if value is not None)
            click.echo(f"  {param}  {bounds}{param.description}")
