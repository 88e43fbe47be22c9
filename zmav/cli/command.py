"""``zmav command``: any MAV_CMD by name."""

from __future__ import annotations

from typing import Any

import click

from zmav.cli.common import Work, assignments, connected, force_option, json_option
from zmav.cli.do import order


@click.command("command")
@click.argument("vehicles")
@click.argument("name")
@click.argument("params", nargs=-1, metavar="[PARAM=VALUE]...")
@click.option("--frame", help="Send it as COMMAND_INT in this MAV_FRAME (GLOBAL_RELATIVE_ALT...); param5/6 in degrees.")
@force_option
@json_option
@connected
def command(vehicles: str, name: str, params: tuple[str, ...], frame: str | None, force: bool, as_json: bool) -> Work:
    """Give any MAV_CMD: 'zmav command quad1 DO_CHANGE_SPEED Speed=5 SpeedType=GROUNDSPEED'.

    Parameters go by the dialect's labels or as param1 to param7; what is not given is 0, and null stands for NaN.
    A label that the command does not have is refused with those that it has.
    """
    args: dict[str, Any] = {"command": name, "params": assignments(params), "frame": frame, "force": force}
    return order(vehicles, "command", args, as_json)
