"""The second stage: the real autopilot, which flies a simulation; nothing turns.

A PX4 is flown on zmav's simulator over its USB or serial line; an ArduPilot simulates on its own hardware, and is flown
by its link as it is.
"""

from __future__ import annotations

import asyncio
import socket
import time
from pathlib import Path

import click

import zmav
from agents.hil.beside import begun, beside, check_device, closing, tell
from agents.hil.checkflight import CheckFlight
from agents.hil.proof import HIL_FLAG, HITL, ardupilot_simulates, px4_simulates
from agents.hil.report import Check, Report, find, hash_of
from zmav import wire
from zmav.children import Children, simulator_once_up
from zmav.config import FleetConfig, load_fleet
from zmav.errors import BadConfig, Refused
from zmav.process import free_port
from zmav.sim import Remote
from zmav.sim.spec import Home
from zmav.sim.status import HilLoop

HIL_S = 40.0
"""s for a controller to go to HIL"""
LEAST_SHARE, MOST_DROPPED, LEAST_SPEED = 0.5, 0.01, 0.98
"""of readings that controls answer; of readings that the line has no room for; of real time"""


async def bench(path: Path, name: str, reports: Path, device: str | None) -> int:
    """Fly the check flight with the autopilot at ``device`` (a link; None: the fleet file's); 0 where it passed."""
    file = load_fleet(path)
    link = device or file.vehicle(name).link
    check_device(link)
    report = begun("bench", file, name, link)
    click.echo(f"bench: {file.fleet}/{name} from {path}, the autopilot at {link}")
    tell(_after_sil(file, name, reports))
    with closing(report, reports), Children() as children:
        async with beside(children, path, file, name, link) as (client, router):
            flight = CheckFlight(client, file, name, router, children, report, tell)
            await flight.meet()
            assert report.identity is not None
            ours = report.identity.autopilot == "px4"
            if ours:
                _check_hitl(flight)
            else:
                _believe(report, ardupilot_simulates(report.params))
                await flight.fly()
        if ours:
            await _fly_on_ours(children, path, file, name, link, report)
    return 0 if report.passed else 1


def _after_sil(file: FleetConfig, name: str, reports: Path) -> Check:
    """A word on the stage before; the gate will want it."""
    before = find(reports, name, "sil")
    if before is None or not before.passed or before.fleet_hash != hash_of(file, name):
        text = "no green report of this fleet file: fly 'zmav hil sil' first; 'flight' wants it"
        return Check("sil", "left out", text)
    return Check("sil", "ok", "passed with this fleet file")


def _believe(report: Report, proof: list[str]) -> None:
    report.proof = proof
    for each in proof:
        click.echo(f"         simulated: {each}")


def _check_hitl(flight: CheckFlight) -> None:
    """See that SYS_HITL is 1; raises :class:`Refused` that says how it gets there."""
    name, value = flight.vehicle.name, flight.report.params.get(HITL)
    if value is None:
        raise Refused(f"it has no {HITL}: its firmware knows no HITL")
    if value != 1:
        raise Refused(
            f"{HITL} is {value}: set it to 1 ('zmav param set {name} {HITL}=1') and reboot the controller. It stays so "
            "until it is set back"
        )
    flight.say(HITL, "1")


async def _fly_on_ours(children: Children, path: Path, file: FleetConfig, name: str, link: str, report: Report) -> None:
    """A PX4 with SYS_HITL 1 on zmav's simulator."""
    port = free_port(socket.SOCK_DGRAM)
    control, device = children.folder / "control", link.removeprefix("serial:").replace(",", ":")
    if not device.startswith("/"):
        text = f"HIL needs PX4's own serial line, and not {link}"
        raise BadConfig(text, field="device", value=link, expected="a device")
    usual = Home()
    origin = file.origin or wire.Origin(lat_deg=usual.lat_deg, lon_deg=usual.lon_deg, alt_amsl=usual.alt_amsl_m)
    home = f"{origin.lat_deg},{origin.lon_deg},{origin.alt_amsl},0"
    where = ["--endpoint", f"onboard:0:{port}", "--home", home, "--control", str(control)]
    children.start("simulator", "sim", "--hil", device, *where)
    with await simulator_once_up(control, children.check) as simulator:
        await _in_hil(children, simulator)
        async with beside(children, path, file, name, f"udpin:127.0.0.1:{port}") as (client, router):
            flight = CheckFlight(client, file, name, router, children, report, tell)
            await flight.meet()
            base_mode = str((await flight.vehicle.message("HEARTBEAT")).fields["base_mode"])
            _believe(report, px4_simulates(report.params, base_mode))
            before, began = simulator.status(), time.monotonic()
            await flight.fly(_stays_in_hil(flight.vehicle))
            after, took = simulator.status(), time.monotonic() - began
            first, last = before.vehicles[0].loop, after.vehicles[0].loop
            if first is not None and last is not None:
                speed = (after.time_s - before.time_s) / took
                judged = judge_loop(first, last, took, speed, least_share=LEAST_SHARE, least_speed=LEAST_SPEED)
                flight.report.checks.append(judged)
                tell(flight.report.checks[-1])


async def _in_hil(children: Children, simulator: Remote) -> None:
    """Wait until the controller flies in the simulator."""
    deadline = time.monotonic() + HIL_S
    while simulator.status().vehicles[0].mode != "external":
        children.check()
        if time.monotonic() > deadline:
            said = children.said("simulator")
            raise Refused(f"it did not go to HIL within {HIL_S:.0f} s; the simulator said:\n{said}")
        await asyncio.sleep(0.2)


async def _stays_in_hil(vehicle: zmav.Vehicle) -> None:
    """While it flies: raises as soon as a HEARTBEAT does not say that it is in HIL."""
    async with vehicle.stream("HEARTBEAT") as beats:
        async for beat in beats:
            if beat.compid == 1 and HIL_FLAG not in str(beat.fields["base_mode"]):
                raise Refused("it has left HIL in flight")


def judge_loop(
    first: HilLoop, last: HilLoop, took: float, speed: float, *, least_share: float, least_speed: float
) -> Check:
    """The loop's timing between two looks at it, ``took`` wall seconds apart; ``speed``: times real time."""
    readings, controls, dropped = (
        getattr(last, what) - getattr(first, what) for what in ("readings", "controls", "dropped")
    )
    found = (
        f"{readings / took:.1f} readings/s sent, {controls / took:.1f} controls/s heard, {dropped} readings dropped, "
        f"{1e3 * last.longest_s:.0f} ms without controls at most, the world at ×{speed:.3f} real time"
    )
    well = controls >= least_share * readings > 0 and dropped <= MOST_DROPPED * readings and speed >= least_speed
    return Check("loop", "ok" if well else "BAD", found)
