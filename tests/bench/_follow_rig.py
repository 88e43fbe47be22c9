"""The follower's demonstration as a bench flies it, every part a process of its own: simulator, two ``zmav up``, the
ground's router, camera, helipad and follower agents; on board, or on the far side of the network.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import socket
import statistics
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from rich.console import Console

import zmav
from deploy.demos.drive import Way, drive
from tests.ports import free_udp_ports
from zmav import keys, wire
from zmav.children import Children, connect_once_up
from zmav.errors import TimedOut
from zmav.process import free_port
from zmav.sim import Home, Remote
from zmav.sim.lineup import ROVERS_SOUTH

FLEET, QUAD, ROVER = "demo", "quad1", "rover1"
DECK = 0.31
"""m: a simulated rover's top, where its pad is, above the ground"""
HEIGHT = 5.0
AWAY = 15.0
"""m that the rover stands south of the quadrotor at the start"""
FIELD = """ground = "grass"
[[roads]]
points = [[-60.0, 4.0], [60.0, -4.0]]
"""
BRIDGE = """[[roofs]]
center = [{north}, {east}]
size = [5.0, 5.0]
height_m = 2.5
"""
READY, SEEN = 90.0, 90.0
"""s for the vehicles and the agents to be there, and for the rover to be seen"""
EVERY = 0.1
"""s between two looks at where everything truly is"""


@dataclass
class Truth:
    """Where both truly are, ten times a second: s, quad (north, east, height), rover (north, east), phase."""

    rows: list[tuple[float, float, float, float, float, float, str]] = field(default_factory=list)

    def off(self, *phases: str) -> list[float]:
        """m between the two over the ground, in these phases."""
        return [math.dist(row[1:3], row[4:6]) for row in self.rows if row[6] in phases]

    def touched(self) -> float:
        """m between the two as the landing vehicle's feet, which no deck stops here, came to the deck's height."""
        stands = self.rows[-1][3]
        down = next(
            (row for row in self.rows if row[6] in ("touch", "land") and row[3] - stands <= DECK), self.rows[-1]
        )
        return math.dist(down[1:3], down[4:6])


class Rig:
    """The processes of one demonstration; ``with Rig(processes, ...)``."""

    def __init__(
        self, processes: Children, folder: Path, options: list[str], on_ground: bool, camera: str = "down"
    ) -> None:
        """``camera``: whose pictures are looked at."""
        self.processes, self.folder, self.on_ground, self._camera = processes, folder, on_ground, camera
        self.ground = f"tcp/127.0.0.1:{free_port()}"
        self.control = folder / "sim.sock"
        self._options = options

    def start(self, scene: str) -> None:
        start, home = self.processes.start, Home()
        (self.folder / "scene.toml").write_text(scene)
        links = [f"udp/127.0.0.1:{free_port(socket.SOCK_DGRAM)}?rel=1;mixed_rel=1" for _ in (QUAD, ROVER)]
        mavlink, pictures = free_udp_ports(2), free_port()
        origin = ["--origin", str(home.lat_deg), str(home.lon_deg), str(home.alt_amsl_m)]
        local = [f"tcp/127.0.0.1:{free_port()}" for _ in (QUAD, ROVER)]
        for port, name, link, own in zip((mavlink, mavlink + 1), (QUAD, ROVER), links, local, strict=True):
            more = ["-e", links[0]] if name == ROVER else []
            start(
                name,
                "up",
                "--link",
                f"udpin:127.0.0.1:{port}",
                "--name",
                name,
                "--fleet",
                FLEET,
                "-l",
                link,
                "-l",
                own,
                *origin,
                *more,
            )
        start("ground", "router", "-l", self.ground, "-e", links[0])
        spacing = str(AWAY / ROVERS_SOUTH)
        start(
            "sim",
            "sim",
            "--copters",
            "1",
            "--rovers",
            "1",
            "--spacing",
            spacing,
            "--control",
            str(self.control),
            "--endpoint",
            f"udp:127.0.0.1:{mavlink}+1",
            "--camera",
            "quad1:15",
            "--pad",
            "rover1",
            "--camera-port",
            str(pictures),
            "--scene",
            str(self.folder / "scene.toml"),
            *self._options,
        )
        self.board, self._pictures = local[0], f"http://127.0.0.1:{pictures}/quad1.mjpeg"

    def start_agents(self) -> None:
        """Once the vehicles are there: the camera on board; the others there or on the ground."""
        where = self.ground if self.on_ground else self.board
        run = ("agent", "run")
        common = ("--vehicle", QUAD, "--fleet", FLEET)
        start = self.processes.start
        budget = "60kB/s" if self.on_ground else "300kB/s"  # to begin with
        start("camera", "camera", "run", self._pictures, *common, "--rate", "15", "--budget", budget, "-e", self.board)
        deck = ("-o", f"target={ROVER}", "-o", f"deck_m={DECK}")
        see = ("-o", f"camera={self._camera}")
        start("helipad", *run, "helipad", *common, *deck, *see, "-e", where)
        start("follower", *run, "follower", *common, "-o", f"deck_m={DECK}", "-e", where)


class Demonstration:
    """What is flown, watched from the ground and by the simulator's truth."""

    def __init__(self, z: zmav.Client, control: Path, console: Console) -> None:
        self.z, self.console, self.truth = z, console, Truth()
        self.quad, self.rover = z.vehicle(QUAD), z.vehicle(ROVER)
        self.status: dict[str, wire.AgentStatus] = {}
        self.phases: list[str] = []
        self.delays: list[float] = []
        """ms from shutter to setpoint, as the follower says"""
        self._control, self._stop = control, threading.Event()

    @property
    def phase(self) -> str:
        told = self.status.get("follower")
        return told.state if told is not None else ""

    def place(self, name: str) -> tuple[float, float]:
        local = self.z.vehicle(name).local
        return local[0], local[1]

    @contextlib.contextmanager
    def watching(self) -> Iterator[None]:
        thread = threading.Thread(target=self._watch, daemon=True)
        thread.start()
        try:
            yield
        finally:
            self._stop.set()
            thread.join()

    def _watch(self) -> None:
        remote, begun = Remote(self._control), time.monotonic()
        try:
            while not self._stop.wait(EVERY):
                quad, rover = (vehicle.ned_m for vehicle in remote.status().vehicles)
                row = (time.monotonic() - begun, quad[0], quad[1], -quad[2], rover[0], rover[1], self.phase)
                self.truth.rows.append(row)
        finally:
            remote.close()

    async def listen(self) -> None:
        """To what the agents say, for ever."""

        def convert(sample: object) -> wire.AgentStatus:
            return wire.decode(sample.payload.to_bytes(), wire.AgentStatus, "status")  # type: ignore[attr-defined]

        async with self.z.subscribe(keys.AGENT_STATUS.key(FLEET, QUAD, agent="*"), convert) as said:
            async for status in said:
                before = self.phase
                self.status[status.agent] = status
                if "delay_ms" in status.detail:
                    self.delays += [float(status.detail["delay_ms"])] if status.agent == "follower" else []
                if self.phase != before:
                    self.phases.append(self.phase)
                    self.console.print(f"  {self.phase}", markup=False, highlight=False)

    async def until(self, true: object, what: str, timeout: float) -> None:
        """Wait until ``true()``; raises :class:`TimedOut`."""
        deadline = time.monotonic() + timeout
        while not true():  # type: ignore[operator]
            if time.monotonic() > deadline:
                raise TimedOut(f"{what} did not come within {timeout:.0f} s; phases: {', '.join(self.phases)}")
            await asyncio.sleep(0.1)

    async def ready(self) -> None:
        await self.z.wait_for(QUAD, ROVER, timeout=READY)
        for name in (QUAD, ROVER):
            await self.z.vehicle(name).wait_until(lambda s: s.ready is True and s.local is not None, READY)

    async def follow(self, way: Way, seconds: float) -> None:
        """The rover drives, the quadrotor takes off, finds it and stays above it for so long."""
        driving = asyncio.create_task(drive(self.rover, way, self.place(ROVER), seconds + SEEN + 10.0))
        try:
            await self.quad.tell("follower", "follow", target=ROVER, height=HEIGHT)
            await self.until(lambda: self.phase == "track", "the sight of the rover", SEEN)
            begun = time.monotonic()
            while time.monotonic() < begun + seconds:
                if driving.done():
                    driving.result()
                await asyncio.sleep(0.2)
        finally:
            driving.cancel()
            await asyncio.gather(driving, return_exceptions=True)

    async def land(self) -> None:
        await self.quad.tell("follower", "land")


def scene(bridge: bool) -> str:
    """With something over the way that hides the rover for longer than a prediction is flown."""
    return FIELD + (BRIDGE.format(north=6.0 - AWAY, east=4.0) if bridge else "")


async def fly(rig: Rig, console: Console, way: Way, seconds: float, hide: bool, land: bool = True) -> Demonstration:
    """All of it. Raises what went wrong, in words."""
    async with contextlib.AsyncExitStack() as stack:
        rig.start(scene(hide))
        z = await connect_once_up(stack, FLEET, rig.ground, rig.processes.check)
        shown = Demonstration(z, rig.control, console)
        await shown.ready()
        rig.start_agents()
        listening = asyncio.create_task(shown.listen())
        try:
            await shown.until(lambda: {"helipad", "follower"} <= set(shown.status), "the agents' word", READY)
            with shown.watching():
                await shown.follow(way, seconds)
                if land:
                    await asyncio.sleep(2.0)  # the rover has stopped
                    await shown.land()
        finally:
            listening.cancel()
            await asyncio.gather(listening, return_exceptions=True)
        return shown


def figures(shown: Demonstration) -> list[str]:
    """What is to be said of it."""
    lines = []
    above = shown.truth.off("track")
    if above:
        far = sorted(above)[int(0.95 * len(above))]
        lines.append(f"above the rover by {statistics.mean(above):.2f} m in the mean, {far:.2f} m at 95 %")
    helipad = shown.status.get("helipad")
    if helipad is not None:
        seen, took = helipad.detail.get("delay_ms"), helipad.detail.get("took_ms")
        lines.append(f"a picture was looked at in {took} ms, and its sight told {seen} ms after the shutter")
    if shown.delays:
        lines.append(f"from shutter to setpoint {statistics.median(shown.delays):.0f} ms")
    lines.append(f"phases: {', '.join(shown.phases)}")
    return lines
