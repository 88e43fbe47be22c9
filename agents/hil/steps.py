"""The checks of the check flight, each a function that returns what it found; :data:`STEPS` names them.

Places are global, so that a vehicle without a declared origin is flown alike.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Awaitable, Callable
from typing import Any

from agents.hil.flight import Failed, Flight, LeftOut
from zmav import geo, wire
from zmav.errors import NotHolder, Refused

READY_S, ARM_S, HOME_S = 180.0, 90.0, 240.0
"""s: patience with an autopilot whose estimates settle, and that flies home from tens of metres"""
PERIOD = 0.1
"""s between setpoints"""
HOLD_SLACK = 0.2
"""s beyond ``hold_after`` within which the hold is said: the stream's own period, and a busy machine's"""
PILOT_S = 1.0
"""s from the pilot's switch or mode to the lease's end: RC_CHANNELS comes ten times a second, a HEARTBEAT once"""
AGAIN = 2.0
RADIO_CHANNELS = 8
"""that the simulated radio has"""
FOLLOWS = ("GUIDED", "OFFBOARD")
"""the modes that follow setpoints"""


async def ready(f: Flight) -> str:
    """It says that it is ready to arm, and has a position."""
    began = time.monotonic()
    await f.until(lambda s: bool(s.ready) and s.position is not None, READY_S, "ready to arm")
    f.here = f.place()
    f.check_room()
    return f"after {time.monotonic() - began:.1f} s, at {f.here.lat_deg:.6f} {f.here.lon_deg:.6f}"


async def arm(f: Flight) -> str:
    """It arms; an autopilot may say that it is ready some seconds before it is."""
    began = time.monotonic()
    f.arming = True
    while True:
        try:
            await f.vehicle.arm()
            break
        except Refused:
            if time.monotonic() - began > ARM_S:
                raise
            await asyncio.sleep(AGAIN)
    return f"after {time.monotonic() - began:.1f} s"


async def takeoff(f: Flight) -> str:
    """It climbs to the height."""
    began = time.monotonic()
    with f.hurried():
        await f.vehicle.takeoff(f.height)
    reached = f.place().alt_rel
    if abs(reached - f.height) > max(1.5, 0.4 * f.height):
        raise Failed(f"{reached:.1f} m, and {f.height:.1f} m were asked for")
    return f"{reached:.1f} m of {f.height:.1f} m, after {time.monotonic() - began:.0f} s"


async def square(f: Flight) -> str:
    """Four corners by a stream of positions under a lease."""
    before, began, side = f.counts(), time.monotonic(), f.side
    misses = []
    async with f.vehicle.lease("check") as lease:
        for north, east in ((side, 0.0), (side, side), (0.0, side), (0.0, 0.0)):
            corner = f.from_here(north, east)
            deadline, closest = time.monotonic() + f.kind.leg, math.inf
            while closest > f.kind.near:
                if time.monotonic() > deadline:
                    raise Failed(f"{closest:.1f} m off a corner after {f.kind.leg:.0f} s; {f.last_words()}")
                lease.setpoint(**corner)
                await asyncio.sleep(PERIOD)
                closest = min(closest, f.away(corner))
            misses.append(closest)
        sent = lease.sent
        await asyncio.sleep(0.5)  # the state counts the last one
    flown = sum(f.counts().get(name, 0) - before.get(name, 0) for name in ("flown", "engaging"))
    if flown < 0.9 * sent:
        raise Failed(f"only {flown} of {sent} setpoints were taken: {f.state.setpoints}")
    took = time.monotonic() - began
    return f"{side:.0f} m sides in {took:.0f} s, corners within {max(misses):.2f} m, {flown} of {sent} setpoints taken"


async def holder_killed(f: Flight) -> str:
    """The program that streams is killed: the vehicle holds within its time."""
    most = f.table.failsafe.hold_after + HOLD_SLACK if f.table.failsafe else 0.5 + HOLD_SLACK
    f.children.start("holder", "fly", f.vehicle.name, *_streamed(f), "--for", "60", "--fleet", f.fleet, "-e", f.router)
    await f.until(lambda s: _flown_by(s, "fly") and f.speed(s) > 0.5, 40.0, "flown by a program")
    since, killed = len(f.events), time.time()
    f.children.kill("holder")
    held = await f.event(lambda e: "holding position" in e.text, since, most + 5.0, "a hold")
    took = held.t - killed
    if took > most:
        raise Failed(f"held {took:.2f} s after its program was killed; expected {most:.2f} s at most")
    if f.kind.rests:
        began = time.monotonic()
        await f.until(lambda s: f.speed(s) < 0.4, 20.0, "at rest")
        return f"held after {took:.2f} s (at most {most:.2f}), at rest after another {time.monotonic() - began:.1f} s"
    return f"held after {took:.2f} s (at most {most:.2f}); it circles"


def _flown_by(state: wire.VehicleState, holder: str) -> bool:
    return state.lease is not None and state.lease.holder == holder and state.mode in FOLLOWS


def _streamed(f: Flight) -> list[str]:
    """Options of ``zmav fly`` that keep it moving."""
    if f.kind.velocity is not None:
        scale = min(1.0, 0.8 * f.most_speed / 1.5)
        north, east, down = (scale * v for v in f.kind.velocity)
        return ["--vel", f"{north:g},{east:g},{-down:g}"]
    far = f.from_here(f.side, 0.0)
    return ["--at", f"{far['lat_deg']:.7f}", f"{far['lon_deg']:.7f}", "--alt", f"{far['alt_rel']:g}"]


async def fence(f: Flight) -> str:
    """A setpoint beyond the geofence is not flown."""
    beyond = f.beyond()
    if beyond is None:
        raise LeftOut("the fleet file has no geofence that would limit this vehicle")
    where, point = beyond
    await _dropped(f, "fence", point)
    return f"a setpoint {where} was dropped, and the vehicle stayed"


async def speed_limit(f: Flight) -> str:
    """A velocity above the limit is not flown."""
    limit = f.table.limits.speed if f.table.limits else None
    if limit is None:
        raise LeftOut("the fleet file limits no speed")
    await _dropped(f, "speed", {"vel": (1.5 * limit, 0.0, 0.0)})
    return f"{1.5 * limit:g} m/s were dropped: the limit is {limit:g} m/s"


async def _dropped(f: Flight, why: str, point: dict[str, Any]) -> None:
    """Stream it for two seconds: each is dropped for that reason, and it moves no more than it did."""
    before, start = f.counts(), f.place()
    async with f.vehicle.lease("check") as lease:
        for _ in range(20):
            lease.setpoint(**point)
            await asyncio.sleep(PERIOD)
        await asyncio.sleep(0.5)
    new = {name: number - before.get(name, 0) for name, number in f.counts().items() if number != before.get(name, 0)}
    if new.get(why, 0) < 15 or new.get("flown", 0) or new.get("engaging", 0):
        raise Failed(f"20 such setpoints became {new}; expected each to be dropped ({why})")
    moved = geo.horizontal_distance(start.lat_deg, start.lon_deg, f.place().lat_deg, f.place().lon_deg)
    if f.kind.rests and moved > 2.0:
        raise Failed(f"they were dropped ({why}), but it moved {moved:.1f} m")


async def pilot(f: Flight) -> str:
    """The pilot's switch, or else a mode of his, ends the lease at once, and no setpoint takes it back."""
    switch = f.table.pilot_switch
    async with f.vehicle.lease("check") as lease:
        point = f.from_here(0.0, 0.0)
        await _stream(lease, point, lambda: f.state.mode in FOLLOWS)
        if switch is not None and f.radio is not None and switch.channel <= RADIO_CHANNELS:
            on = (switch.low + switch.high) // 2
            f.radio(switch.channel, on)
            took = await _lost(f, lease, point, f"the switch, channel {switch.channel} at {on} µs")
            f.radio(switch.channel, 1100 if switch.low > 1200 else switch.high + 100)
            await f.until(lambda s: s.pilot is None, 5.0, "the switch back")
            return f"the switch (channel {switch.channel} at {on} µs) took it after {took:.2f} s, and gave it back"
        if switch is not None:
            f.say("pilot's switch", "not tried, as no simulated radio turns it: turn it yourself", "left out")
        await f.pilots_mode()
        took = await _lost(f, lease, point, f.kind.pilots_mode)
    await f.until(lambda s: s.mode == f.kind.pilots_mode, 3.0, f"in the pilot's mode {f.kind.pilots_mode}")
    await f.vehicle.hold()
    why = "" if switch else "; the fleet file has no pilot_switch"
    return f"mode {f.kind.pilots_mode} took it after {took:.2f} s{why}"


async def _stream(lease: Any, point: dict[str, Any], true: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 10.0
    while not true():
        if time.monotonic() > deadline:
            raise Failed("it does not follow a stream of setpoints any more")
        lease.setpoint(**point)
        await asyncio.sleep(PERIOD)


async def _lost(f: Flight, lease: Any, point: dict[str, Any], what: str) -> float:
    """Go on streaming until the pilot has it by ``what``: the seconds that took."""
    since = time.monotonic()
    while time.monotonic() - since < 3.0:
        try:
            lease.setpoint(**point)
        except NotHolder as e:
            if e.detail.get("reason") != "pilot":
                raise Failed(f"the lease ended, but not by the pilot: {e}") from e
            took = time.monotonic() - since
            if took > PILOT_S + PERIOD:
                raise Failed(f"the pilot had it after {took:.2f} s; expected {PILOT_S:.1f} s at most") from e
            return took
        await asyncio.sleep(0.02)
    raise Failed(f"the pilot took it ({what}), and the lease is still {f.state.lease}")


async def home(f: Flight) -> str:
    """RTL from some way off; it ends disarmed where the kind does that by itself."""
    with f.hurried():
        await f.vehicle.goto(**f.from_here(f.side, 0.0), tolerance=f.kind.near)
        began, far = time.monotonic(), f.from_start()
        await f.vehicle.rtl()
        if f.kind.lands:
            await f.until(lambda s: s.armed is False, HOME_S, "disarmed at home")
            f.arming = False
        else:
            await f.until(lambda s: f.from_start() < f.kind.near, HOME_S, "home")
    how = "landed and disarmed" if f.kind.lands else "there"
    return f"{how} after {time.monotonic() - began:.0f} s from {far:.0f} m off: {f.from_start():.1f} m beside its start"


STEPS: dict[str, Callable[[Flight], Awaitable[str]]] = {
    "ready": ready,
    "arm": arm,
    "takeoff": takeoff,
    "square": square,
    "holder killed": holder_killed,
    "fence": fence,
    "speed limit": speed_limit,
    "pilot": pilot,
    "home": home,
}
