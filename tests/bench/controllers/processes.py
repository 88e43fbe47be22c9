"""What a measurement starts: ``zmav`` verbs as processes of their own on free loopback ports, all ended on leaving."""

from __future__ import annotations

import asyncio
import contextlib
import os
import time
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import zmav
from zmav import keys, wire
from zmav.children import Children, connect_once_up
from zmav.errors import Refused, TimedOut, ZmavError
from zmav.process import free_port, say
from zmav.waiting import within

FLEET, VEHICLE = "bench", "hex1"
START = 40.0
"""s for interpreters to start, perhaps on a busy machine"""
SWITCH = 7
"""the radio's channel with the pilot's switch"""
TICKS = os.sysconf("SC_CLK_TCK")


@contextlib.contextmanager
def last_words() -> Iterator[Children]:
    """Children that say their last words where an error of ours ends them."""
    with Children() as children:
        try:
            yield children
        except ZmavError:
            for name in children.names():
                say(f"{name} said last:\n{children.said(name)}")
            raise


class Rig(NamedTuple):
    """A vehicle's agent with its router, and we as its client."""

    processes: Children
    endpoint: str
    z: zmav.Client
    vehicle: zmav.Vehicle

    def run_controller(self, controller: str, name: str) -> None:
        """Start the supervisor of a controller, a file or an installed one."""
        self.run_agent(controller, name, "-o", f"name={name}")

    def run_agent(self, what: str, name: str, *arguments: str) -> None:
        """``zmav agent run WHAT``, as a process called ``name``."""
        where = ("--vehicle", VEHICLE, "--fleet", FLEET, "-e", self.endpoint)
        self.processes.start(name, "agent", "run", what, *where, *arguments)

    @contextlib.contextmanager
    def listening(self, calls: Mapping[str, Callable[[Any], None]]) -> Iterator[None]:
        """While it lasts, hand each sample under a key to its call, on Zenoh's threads."""
        with contextlib.ExitStack() as stack:
            for key, call in calls.items():
                stack.callback(self.z.session.declare_subscriber(key, call).undeclare)
            yield

    async def fly_by(self, controller: str, name: str) -> None:
        """Start a controller (see :meth:`run_controller`), and have it take over."""
        self.run_controller(controller, name)
        await self.ready(name)
        await self.be_patient(name)
        await self.engage(name)

    async def be_patient(self, agent: str) -> None:
        """Have no stall of this machine end what is measured, as far as a supervisor allows."""
        for guard, most in (("guard_late", 25.0), ("guard_silent", 1.0)):
            await self.vehicle.tell(agent, "set", name=guard, value=most)

    async def engage(self, agent: str) -> None:
        """Have a controller take over, as soon as it may: the autopilot's state must flow, and the pilot let go."""
        await self._repeat(agent, "engage", Refused)

    async def status(self, agent: str, true: Callable[[wire.AgentStatus], bool], timeout: float) -> wire.AgentStatus:
        """The first of its statuses from now on for which ``true``; raises :class:`~zmav.errors.TimedOut`."""
        key, last = keys.AGENT_STATUS.key(FLEET, VEHICLE, agent=agent), ""

        def read(sample: Any) -> wire.AgentStatus:
            return wire.decode(sample.payload.to_bytes(), wire.AgentStatus, "status")

        async def wait(heard: zmav.Subscription[wire.AgentStatus]) -> wire.AgentStatus:
            nonlocal last
            while True:
                status = await heard.get()
                last = f"{status.state}: {status.text}"
                if true(status):
                    return status

        try:
            async with self.z.subscribe(key, read) as heard:
                return await within(timeout, wait(heard))
        except asyncio.TimeoutError:
            raise TimedOut(f"{agent} did not come so far within {timeout:g} s; it says: {last or 'nothing'}") from None

    async def ready(self, controller: str) -> None:
        """Wait until the supervisor of a controller has loaded it and hears the autopilot, and knows its height: it
        guards that from the engagement on.
        """
        await self.vehicle.wait_until(lambda state: bool(state.armed) and state.position is not None, START)
        await self.answers(controller)
        await self.status(controller, lambda status: float(status.detail.get("hz") or 0.0) > 1.0, START)

    async def answers(self, agent: str) -> None:
        """Wait until an agent hears orders; raises what became of the processes, or :class:`TimedOut`."""
        await self._repeat(agent, "params", ZmavError)

    async def _repeat(self, agent: str, order: str, passing: type[ZmavError]) -> None:
        """Give an order until it is taken; raises any other error than ``passing``, and that after a while."""
        deadline = time.monotonic() + START
        while True:
            self.processes.check()
            try:
                await self.vehicle.tell(agent, order)
                return
            except passing:
                if time.monotonic() > deadline:
                    raise
                await asyncio.sleep(0.05)


def fleet_file(processes: Children, link: str, sim: str = "", world: str = "") -> Path:
    """A fleet of one hexarotor with a pilot's switch. ``sim``: its table, ``world``: that of the simulator."""
    path = processes.folder / "fleet.toml"
    path.write_text(
        f'fleet = "{FLEET}"\n'
        "[origin]\nlat_deg = -35.363261\nlon_deg = 149.165230\nalt_amsl = 584.09\n"
        f"{world}"
        f'[vehicles.{VEHICLE}]\nlink = "{link}"\nsysid = 1\n'
        f"[vehicles.{VEHICLE}.pilot_switch]\nchannel = {SWITCH}\n"
        f"{sim}"
    )
    return path


@contextlib.asynccontextmanager
async def rig(processes: Children, file: Path) -> AsyncIterator[Rig]:
    """``zmav up`` for the vehicle, and a client of its router."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    processes.start("up", "up", "--file", str(file), "--name", VEHICLE, "-l", endpoint)
    async with contextlib.AsyncExitStack() as stack:
        z = await connect_once_up(stack, FLEET, endpoint, processes.check)
        (vehicle,) = await z.wait_for(VEHICLE, timeout=START)
        yield Rig(processes, endpoint, z, vehicle)


def cpu_seconds(pid: int) -> float:
    """Of a process and its threads so far, user and system (proc(5), fields 14 and 15 of stat); 0 once it is gone."""
    try:
        rest = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(rest[11]) + int(rest[12])) / TICKS


def children(pid: int) -> list[int]:
    """The processes that it started and that still run."""
    found: list[int] = []
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        with contextlib.suppress(OSError):
            found += [int(child) for child in task.read_text().split()]
    return found


def signals_key(agent: str) -> str:
    """The key of a controller's signals."""
    return keys.AGENT_OUT.key(FLEET, VEHICLE, agent=agent, topic="signals")


def frames_key(message: str) -> str:
    """The key of a message of the autopilot's; "*": of all."""
    return keys.RX.key(FLEET, VEHICLE, sys="1", comp="1", msg=message)


def signals_of(sample: Any) -> wire.Signals:
    """What a sample under :func:`signals_key` says."""
    return wire.decode(sample.payload.to_bytes(), wire.Signals, "signals")


def load() -> float:
    """Of this machine over the last minute: runnable tasks, beside its processors."""
    return os.getloadavg()[0]
