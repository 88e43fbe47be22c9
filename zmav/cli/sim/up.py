"""``zmav sim --up``: beside each simulated vehicle its ``zmav up``, and a router where clients look for one."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import sys
from collections.abc import Iterator

import click

from zmav import keys
from zmav.config import FleetConfig, load_fleet
from zmav.session import ANY_PORT, CONNECT, DEFAULT_ROUTER
from zmav.sim import World

ROUTER = "router"
"""what the log of the router's process is called"""


@contextlib.contextmanager
def companions(world: World, fleet_file: str | None) -> Iterator[None]:
    """They run as long as the block, which runs the world; where one ends, the world is stopped. Raises
    :class:`~zmav.errors.ZmavError` with its last words then. In the main thread.
    """
    from zmav.children import Children  # and all that it loads, where there are some

    file = load_fleet(fleet_file) if fleet_file else FleetConfig()
    fleet = file.fleet if fleet_file else keys.check_name(os.environ.get("ZMAV_FLEET", file.fleet), "fleet")
    home = world.home
    own = ["--file", fleet_file] if fleet_file else ["--fleet", fleet]
    if file.origin is None:
        own += ["--origin", *map(str, (home.lat_deg, home.lon_deg, home.alt_amsl_m))]
    endpoint = next(iter(os.environ.get(CONNECT, "").split()), DEFAULT_ROUTER)
    joined = is_open(endpoint)
    with Children(at_once=True) as processes:

        def look(*_: object) -> None:
            if any(processes.ended(name) is not None for name in processes.names()):
                world.stop()

        before = signal.signal(signal.SIGCHLD, look)
        try:
            if not joined:
                processes.start(ROUTER, "router", "--fleet", fleet, "-l", endpoint)
            vehicles = [vehicle for vehicle in world.status().vehicles if vehicle.url]
            for vehicle in vehicles:
                where = ("--name", vehicle.name, "--link", vehicle.url, "-l", ANY_PORT, "-e", endpoint)
                processes.start(f"up {vehicle.name}", "up", *own, *where)
            _announce(vehicles[0].name if vehicles else "NAME", fleet, endpoint, joined)
            yield
            processes.check()
        finally:
            signal.signal(signal.SIGCHLD, before)


def is_open(endpoint: str) -> bool:
    """Somebody listens there: a router that 'zmav up', 'zmav router' or 'zmav demo --stay' has opened."""
    protocol, _, place = endpoint.partition("/")
    host, _, port = place.rpartition(":")
    if protocol != "tcp" or not port.isdigit():
        return True  # named for clients by who opened it
    with contextlib.suppress(OSError), socket.create_connection((host.strip("[]"), int(port)), timeout=1.0):
        return True
    return False


def _announce(name: str, fleet: str, endpoint: str, joined: bool) -> None:
    """Say how to look at them; nobody need be there to read it."""
    option = "" if fleet == FleetConfig().fleet else f" (each with --fleet {fleet})"
    router = f"at the router {endpoint}, which was there" if joined else f"with a router at {endpoint}"
    with contextlib.suppress(OSError):
        click.echo(f"beside each starts 'zmav up', in the fleet {fleet}, {router}")
        click.echo(f"look: zmav ls, zmav top, zmav echo {name}, zmav http (a page for a browser){option}")
        click.echo(f"fly: zmav do {name} arm, zmav do {name} takeoff alt_rel=10; Ctrl-C here ends all of it")
        sys.stdout.flush()
