"""``zmav view``."""

from __future__ import annotations

import contextlib
from pathlib import Path

import click

from ground.view import viewer
from ground.view.screen import LOST, PainterSettings, Screen, Sink
from ground.view.table import Table
from ground.view.watch import Watch
from zmav.cli.common import Between, Work, connected
from zmav.client import Client
from zmav.errors import BadConfig, ZmavError
from zmav.process import say, until_stopped
from zmav.waiting import alongside, until_any


@click.command("view")
@click.option("--save", type=click.Path(dir_okay=False), metavar="FILE.rrd", help="Write a recording for Rerun.")
@click.option("--web", is_flag=True, help="Serve the viewer as a web page, on loopback.")
@click.option(
    "--port",
    type=click.IntRange(1, 65534),
    default=9090,
    show_default=True,
    help="Of the web page; its data come over the next one.",
)
@click.option("--vehicles", multiple=True, metavar="PATTERN", help="Only these: quad1, quad*  (repeatable).")
@click.option(
    "--size",
    type=Between(0.05, 100.0),
    default=1.0,
    show_default=True,
    help="Of the models, which are about 2 m across.",
)
@click.option("--cameras/--no-cameras", default=True, show_default=True, help="Fetch pictures over the network.")
@click.option("--signals/--no-signals", default=True, show_default=True, help="And what controllers stream.")
@connected
def command(
    save: str | None, web: bool, port: int, vehicles: tuple[str, ...], size: float, cameras: bool, signals: bool
) -> Work:
    """Show the fleet in three dimensions, over time and in words, in Rerun's viewer.

    Without an option a window opens; --web serves a page instead, --save writes a file (beside either, or alone). It
    ends when the window is closed, or with Ctrl-C.
    """
    viewer.check_extra()
    sinks = sinks_of(save, web, port)

    async def view(z: Client) -> None:
        table = Table()
        watch = Watch(z, table, vehicles or ("*",), cameras, signals)
        await _paint(watch, [Screen(table, PainterSettings(sink, z.fleet_name == "*", size), say) for sink in sinks])

    return view


def sinks_of(save: str | None, web: bool, port: int) -> list[Sink]:
    """Where to log to; raises :class:`BadConfig` for what cannot be."""
    found = []
    if save is not None:
        path = Path(save)
        if path.exists() and not path.is_file():  # a pipe would wait for its reader
            text = f"cannot write {save}: it is no regular file"
            raise BadConfig(text, field="save", value=save, expected="a file")
        try:
            path.open("ab").close()
        except OSError as e:
            raise BadConfig(f"cannot write {save}: {e.strerror}", field="save", value=save, expected="a file") from e
        found.append(Sink("save", path=str(path)))
    if web:
        found.append(viewer.web_sink(port))
    if not found:
        viewer.check_display()
        found.append(viewer.native_sink())
    return found


async def _paint(watch: Watch, screens: list[Screen]) -> None:
    """Until a signal, or until a painter ends: its window was closed, or its sink is of no use."""
    async with contextlib.AsyncExitStack() as stack:
        for screen in screens:
            await stack.enter_async_context(screen)
        async with alongside(_tell(screens)):
            await until_any(until_stopped(), watch.run(), *map(_serve, screens))


async def _serve(screen: Screen) -> None:
    """Raises why its painter ended, where nobody closed the window."""
    sink, code = screen.sink, await screen.serve()
    if code == LOST:
        raise ZmavError(f"{sink.path} does not grow any more: is its disk full, or has it been deleted?")
    if code != 0:
        raise ZmavError(f"{sink.words} could not be kept up: its painter ended with {code}")


async def _tell(screens: list[Screen]) -> None:
    """Say where to look, once there is something."""
    for screen in screens:
        sink = screen.sink
        await screen.started.wait()
        if sink.kind == "web":
            say(f"open {viewer.page(sink)}")
        elif sink.kind == "save":
            say(f"recording to {sink.path}; Ctrl-C ends it")
