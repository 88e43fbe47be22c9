"""``zmav swarm``: orders for several vehicles at once, planned together."""

from __future__ import annotations

import click

from agents.planner.cli import agent, goals, orders
from agents.planner.cli.survey import survey


@click.group("swarm")
def swarm() -> None:
    """Move several vehicles at once, planned together.

    'zmav swarm planner' runs the planner; the other verbs find it and tell it what to do. Places are metres north and
    east of the fleet's origin and above it: 30,-5,15.
    """


for each in (agent.planner, *goals.COMMANDS, survey, *orders.COMMANDS):
    swarm.add_command(each)
