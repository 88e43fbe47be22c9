"""``zmav sim traffic``."""

from __future__ import annotations

import click

from zmav.cli.common import run
from zmav.sim.sbs import FAULTS


@click.command("traffic")
@click.option(
    "--port", type=click.IntRange(0, 65535), default=30003, show_default=True, help="Where the feed is served."
)
@click.option(
    "--origin",
    type=float,
    nargs=3,
    metavar="LAT LON AMSL",
    default=(-35.363261, 149.165230, 584.09),
    show_default=True,
    help="What they circle about.",
)
@click.option("--count", type=click.IntRange(1, 500), default=3, show_default=True, help="How many aircraft.")
@click.option("--fault", type=click.Choice(FAULTS), help="What is wrong with the feed from the beginning.")
def traffic(port: int, origin: tuple[float, float, float], count: int, fault: str | None) -> None:
    """Serve a feed of made-up aircraft, as dump1090 does (BaseStation): then 'zmav traffic sbs:127.0.0.1'."""
    from zmav.config import origin_of
    from zmav.process import log, until_stopped
    from zmav.sim.sbs import Fault, SbsSource, circling

    async def serve(fault: Fault) -> None:
        async with SbsSource(origin_of(*origin), circling(count), port=port, fault=fault) as source:
            log(f"{count} made-up aircraft at sbs:127.0.0.1:{source.port}")
            await until_stopped()

    run(serve(fault or ""))  # type: ignore[arg-type]
