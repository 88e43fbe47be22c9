"""``zmav demo``: three simulated copters, each behind its own router, in a line whose first the ground sees."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NoReturn

import click
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

import zmav
from agents.demo.processes import Processes, connect, free_port, free_udp_ports
from agents.demo.watch import Watch
from zmav.cli.common import console
from zmav.cli.ls import fleet_view
from zmav.errors import ZmavError
from zmav.session import DEFAULT_ROUTER
from zmav.sim import Home

FLEET = "demo"
NAMES = ("quad1", "quad2", "quad3")
TIME_LIMIT = 115.0


@click.group("demo", invoke_without_command=True)
@click.option("--headless", is_flag=True, help="Lines instead of a live table (also where there is no terminal).")
@click.option("--endpoint", help="Where the ground's router listens, to look on with -e.  [default: a free port]")
@click.option("--stay", is_flag=True, help="Start them and leave the flying to you: scripts, other verbs.")
@click.pass_context
def demo(context: click.Context, headless: bool, endpoint: str | None, stay: bool) -> None:
    """Fly three simulated copters: take off, change places, land. Ends with a summary; 0 only if all got there.

    'zmav demo --stay' only starts them, where clients look for a router by themselves, until Ctrl-C ends it: then 'zmav
    top', 'zmav do quad1 arm' and the scripts in ground/examples find quad1, quad2 and quad3.

    'zmav demo follow' is another one: a quadrotor follows the letter H on a rover.
    """
    if context.invoked_subcommand is not None:
        return
    out = console()
    start = time.monotonic()
    if stay:
        with Processes() as processes:
            _stay(processes, endpoint or DEFAULT_ROUTER, out)
    with Processes() as processes:
        ground = endpoint or f"tcp/127.0.0.1:{free_port()}"
        start_fleet(processes, ground, out)
        code, watch = asyncio.run(_fly(processes, ground, out, live=out.is_terminal and not headless))
        said = processes.said("planner")
    out.print(summary(watch))
    if code != 0:
        out.print(f"the planner said:\n{said}", style="red", markup=False)
    verdict = "every vehicle got there" if code == 0 else "FAILED: not every vehicle got there"
    out.print(f"{verdict}, in {time.monotonic() - start:.0f} s", style="bold green" if code == 0 else "bold red")
    sys.exit(code)


@demo.command("follow")
@click.option("--way", type=click.Choice(["eight", "walk"]), default="eight", show_default=True, help="The rover's.")
@click.option("--speed", type=click.FloatRange(0.1, 2.0), default=1.0, show_default=True, help="m/s at most.")
@click.option("--seconds", type=click.FloatRange(5.0, 3600.0), default=120.0, show_default=True, help="To follow it.")
@click.option("--ground", is_flag=True, help="Look at the pictures, and follow, from the ground.")
@click.option("--bridge/--no-bridge", default=True, show_default=True, help="Something over the way that hides it.")
@click.option("--wind", default="3,light", show_default=True, help="As of 'zmav sim'.")
@click.option("--picture", type=click.Path(path_type=Path, dir_okay=False), help="Draw both tracks into a file.")
@click.option("--seed", type=int, default=1, show_default=True, help="Of the walk and of the weather.")
def follow(
    way: str, speed: float, seconds: float, ground: bool, bridge: bool, wind: str, picture: Path | None, seed: int
) -> None:
    """A quadrotor finds the letter H on a rover by its camera, follows it, and lands on it."""
    from agents.demo import follow as demonstration
    from agents.demo.tracks import draw

    out = console()
    with Processes() as processes, tempfile.TemporaryDirectory(prefix="zmav-follow-") as folder:
        options = ["--wind", wind, "--seed", str(seed), "--noise", "typical"]
        rig = demonstration.Rig(processes, Path(folder), options, ground)
        where = "on the ground" if ground else "on board"
        out.print(f"a rover drives a way of kind {way} at up to {speed:g} m/s; its pictures are looked at {where}")
        road = demonstration.ways(way, speed, seed)
        try:
            shown = asyncio.run(demonstration.fly(rig, out, road, seconds, hide=bridge))
        except ZmavError as e:
            for name in ("helipad", "follower", "camera"):
                out.print(f"{name} said:\n{processes.said(name)}", style="red", markup=False)
            raise e
        for line in demonstration.figures(shown):
            out.print(line, markup=False, highlight=False)
        if picture is not None:
            draw(shown.truth, picture, f"{way}, up to {speed:g} m/s, wind {wind}, pictures looked at {where}")
            out.print(f"tracks: {picture}", markup=False)


def _stay(processes: Processes, ground: str, out: Console) -> NoReturn:
    start_fleet(processes, ground, out)
    out.print("they stand ready in a few seconds: look with 'zmav top'; Ctrl-C ends them")
    while True:
        processes.check()
        time.sleep(0.5)


def start_fleet(processes: Processes, ground: str, console: Console) -> None:
    """Simulator, one ``zmav up`` a copter linked in a line 1-2-3, and the ground's router linked to the first."""
    home = Home()
    links = [f"udp/127.0.0.1:{free_port(socket.SOCK_DGRAM)}?rel=1;mixed_rel=1" for _ in NAMES]
    mavlink = free_udp_ports(len(NAMES))
    for port, (name, link, before) in enumerate(zip(NAMES, links, [None, *links], strict=False), start=mavlink):
        console.print(f"{name}: router at {link.split('?')[0]}" + (", linked to the one before" if before else ""))
        arguments = ["--link", f"udpin:127.0.0.1:{port}", "--name", name, "--fleet", FLEET, "-l", link]
        origin = ["--origin", str(home.lat_deg), str(home.lon_deg), str(home.alt_amsl_m)]
        processes.start(name, "up", *arguments, *origin, *(["-e", before] if before else []))
    console.print(f"ground: router at {ground}, linked to {NAMES[0]} only")
    processes.start("ground", "router", "-l", ground, "-e", links[0])
    console.print(f"simulator: {len(NAMES)} copters")
    endpoint = f"udp:127.0.0.1:{mavlink}+1"
    processes.start("sim", "sim", "--copters", str(len(NAMES)), "--spacing", "15", "--endpoint", endpoint)


async def _fly(processes: Processes, ground: str, console: Console, live: bool) -> tuple[int, Watch]:
    async with contextlib.AsyncExitStack() as stack:
        z = await connect(stack, FLEET, ground, processes)
        watch = Watch(z, NAMES)
        watching = asyncio.create_task(watch.run())
        planner = processes.start("planner", "swarm", "swap", *NAMES, "--fleet", FLEET, "-e", ground, may_end=True)
        view = Live(console=console, refresh_per_second=4) if live else None
        with view or contextlib.nullcontext():
            code = await _until_ended(planner, processes, z, watch, view, console)
        watching.cancel()
        return code, watch


async def _until_ended(
    planner: subprocess.Popen[bytes], processes: Processes, z: zmav.Client, watch: Watch, view: Live | None,
    console: Console,
) -> int:  # fmt: skip
    deadline, said = time.monotonic() + TIME_LIMIT, 0.0
    while planner.poll() is None:
        if time.monotonic() > deadline:
            console.print(f"not done within {TIME_LIMIT:.0f} s", style="red")
            return 1
        if planner.poll() is None:
            processes.check()
        if view is not None:
            view.update(_picture(z, watch))
        elif time.monotonic() - said > 5.0:
            said = time.monotonic()
            console.print(_picture(z, watch))
        await asyncio.sleep(0.2)
    return int(planner.returncode)


def _phase(watch: Watch) -> str:
    return f"planner: {watch.planner.state if watch.planner else 'waiting for the vehicles to be ready'}"


def _picture(z: zmav.Client, watch: Watch) -> Group:
    return Group(Text(_phase(watch), style="bold"), fleet_view(z.fleet()))


def summary(watch: Watch) -> Group:
    """What was flown, and what the network did meanwhile."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in ("vehicle", "relays", "arrived", "off goal", "flown", "setpoints", "lost", "MAVLink lost", "RTT"):
        table.add_column(name, justify="left" if name == "vehicle" else "right", no_wrap=True)
    parts = watch.planner.detail if watch.planner else {}
    for relays, (name, track) in enumerate(watch.tracks.items()):
        part = parts.get(name, {})
        away, sent = part.get("away"), part.get("setpoints", 0)
        table.add_row(
            name,
            str(relays),
            "yes" if part.get("arrived") else "NO",
            "-" if away is None else f"{away:.2f} m",
            f"{track.distance:.0f} m",
            str(sent),
            str(sent - watch.received(name)),
            f"{track.mavlink_lost}/{track.mavlink_frames}",
            f"{1e3 * statistics.median(track.rtts):.1f} ms" if track.rtts else "-",
        )
    per_hop = watch.delay_per_hop()
    closest = f"closest approach {watch.closest:.2f} m ({' and '.join(watch.closest_pair)})"
    delay = f"delay per relay {'-' if per_hop is None else f'{1e3 * per_hop:.2f} ms'} one way"
    return Group(table, Text(f"{closest}; {delay}"))
