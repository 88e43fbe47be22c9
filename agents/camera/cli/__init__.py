"""``zmav camera``: one verb a file."""

from __future__ import annotations

import click

from agents.camera.cli import run, view


@click.group("camera")
def camera() -> None:
    """Cameras of vehicles: send pictures, look at what comes of them and record it.

    'zmav camera run 0 --vehicle quad1' beside the camera; 'zmav camera view quad1' anywhere in the fleet.
    """


for each in (run.command, view.command):
    camera.add_command(each)
