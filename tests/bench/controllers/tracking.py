"""(e) How well a reference is tracked by EV1, EV2 and the autopilot's own cascade: the lemniscate in haste, and EV3's
square and upright rectangle, in the same wind, noise and seed.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any, TypeVar

import msgspec
import numpy as np

from agents.controllers.estimate import Estimate
from agents.controllers.loops.parts import GRAVITY, attitude_of
from agents.controllers.types import Array
from tests.bench.controllers.flight import BUILD_UP, CENTRE, STILL, YAW, airborne, follow, lemniscate, rest
from tests.bench.controllers.processes import Rig, frames_key
from zmav.errors import Refused, Stale, TimedOut
from zmav.mavlink import decode, parse_frame
from zmav.vehicle.lease import Lease

T = TypeVar("T")
PX4, NAVIGATOR = "px4", "navigator"
PILOTS = (PX4, "ev1", "ev2")
WIND, SEED = "5@240,moderate", 3
HEARD = {"ATTITUDE_QUATERNION": 250.0, "LOCAL_POSITION_NED": 250.0, "GLOBAL_POSITION_INT": 5.0}
"""Hz"""
STREAM_HZ = 100.0
"""setpoints a second for the autopilot's own cascade, whose outer loops look 50 times a second"""
AHEAD = 0.5 / STREAM_HZ
"""s: a setpoint holds until the next one, and so is made for the middle of that time"""
ATTEMPTS = 3
ROUTE_TIMEOUT = 300.0
"""s"""


class Errors(msgspec.Struct):
    """Of one flight along the lemniscate, between its build-up and its end."""

    rms: float
    """m"""
    peak: float
    attitude_deg: float
    """RMS of the angle to the attitude that the reference asks for in still air"""
    times: list[float]
    distances: list[float]
    """s since it began, and m off, thinned"""
    places: list[tuple[float, float]]
    """m north and east of its middle"""


class Tracking(msgspec.Struct):
    """By who flew: ``px4``, ``ev1``, ``ev2``."""

    lemniscate: dict[str, Errors]
    ev3: dict[str, dict[str, Any]]
    """the navigator's own summaries"""
    broken: list[str] = []
    """flights that were flown again, by whom, and why"""
    wind: str = WIND
    seed: int = SEED


def attitude_for(acc: Array, yaw: float) -> Array:
    """(4,) w, x, y, z that points the thrust so that it gives ``acc`` (m/s² NED) against gravity, at this heading."""
    down = np.array((0.0, 0.0, GRAVITY)) - acc
    x, y, z = (down / np.linalg.norm(down)).tolist()
    return np.array(attitude_of((x, y, z), yaw))


def angle(a: Array, b: Array) -> float:
    """rad between two attitudes."""
    return 2.0 * math.acos(min(abs(float(np.dot(a, b))), 1.0))


def errors(rows: list[tuple[float, Array, Array]], begin: float, seconds: float, centre: Array, yaw: float) -> Errors:
    """``rows``: UTC s, position (3,) and attitude (4,). Raises :class:`Stale` where none is of it."""
    times, distances, angles, places = [], [], [], []
    for at, pos, q in rows:
        t = at - begin
        if not BUILD_UP <= t <= seconds:
            continue
        ref, _, acc = lemniscate(t, seconds, centre)
        times.append(t)
        distances.append(float(np.linalg.norm(pos - ref)))
        angles.append(math.degrees(angle(q, attitude_for(acc, yaw))))
        places.append((float(pos[0] - centre[0]), float(pos[1] - centre[1])))
    if not times:
        raise Stale("nothing was heard of the flight")
    thin = slice(None, None, max(1, len(times) // 1000))
    return Errors(
        rms=_rms(distances),
        peak=max(distances),
        attitude_deg=_rms(angles),
        times=[round(t, 3) for t in times[thin]],
        distances=[round(d, 4) for d in distances[thin]],
        places=[(round(n, 3), round(e, 3)) for n, e in places[thin]],
    )


def _rms(values: list[float]) -> float:
    return math.sqrt(sum(value * value for value in values) / len(values))


class Recorder:
    """Where the autopilot says that it is, as controllers are told it."""

    def __init__(self, run: Rig, stack: contextlib.ExitStack) -> None:
        self._run, self._estimate = run, Estimate((1, 2, 3, 4))
        self.rows: list[tuple[float, Array, Array]] = []
        for name, hz in HEARD.items():
            stack.enter_context(run.vehicle.rates.want(name, hz))
        stack.enter_context(run.listening({frames_key(name): self._taker(name) for name in HEARD}))

    def _taker(self, name: str) -> Callable[[Any], None]:
        estimate, dialect = self._estimate, self._run.z.dialect

        def take(sample: Any) -> None:
            fields = decode(parse_frame(sample.payload.to_bytes(), dialect), dialect)
            if name == "LOCAL_POSITION_NED":
                estimate.local(fields)
            elif name == "GLOBAL_POSITION_INT":
                self._anchor()
                estimate.globally(fields)
            elif estimate.attitude(fields) and estimate.ready and estimate.boot_t is not None:
                self.rows.append((estimate.state.t, estimate.state.pos.copy(), estimate.state.q.copy()))

        return take

    def _anchor(self) -> None:
        state = self._run.vehicle.last_state
        if state is not None and state.clock is not None and state.position is not None and state.local is not None:
            self._estimate.boot_t = state.clock.boot_t
            self._estimate.anchor(state.position, state.local)


async def measure(
    found: Tracking, seconds: float, side: float, height: float, pilots: tuple[str, ...] = PILOTS
) -> None:
    """Fills ``found``, flight by flight. ``seconds`` of the lemniscate; metres of EV3's square and of the rectangle
    above it, 0 m: without that.
    """
    for who in pilots:
        found.lemniscate[who] = await _again(found, who, partial(_lemniscate, who, seconds))
        if side > 0.0 and who != "ev2":
            found.ev3[who] = await _again(found, who, partial(_ev3, who, side, height))


async def _again(found: Tracking, who: str, fly: Callable[[], Awaitable[T]]) -> T:
    """What a flight gives; one that is broken off by the guard, on a machine that stood still, is flown again."""
    for _ in range(ATTEMPTS - 1):
        try:
            return await fly()
        except (Refused, Stale, TimedOut) as e:
            found.broken.append(f"{who}: {e}")
    return await fly()


async def _lemniscate(who: str, seconds: float) -> Errors:
    async with airborne(wind=WIND, seed=SEED) as run:
        with contextlib.ExitStack() as stack:
            recorder = Recorder(run, stack)
            if who == PX4:
                begin = await _by_the_autopilot(run, seconds)
            else:
                begin = await _by_a_controller(run, who, seconds)
            return errors(recorder.rows, begin, seconds, np.array(CENTRE), YAW)


async def _ev3(who: str, side: float, height: float) -> dict[str, Any]:
    """By the navigator: its summary."""
    async with airborne(wind=WIND, seed=SEED) as run:
        if who != PX4:
            await run.fly_by(who, who)
            await rest(run, who)
        run.run_agent(NAVIGATOR, NAVIGATOR)
        await run.answers(NAVIGATOR)
        by = "" if who == PX4 else who
        await run.vehicle.tell(NAVIGATOR, "fly", route="ev3", speed=1.0, side=side, height=height, controller=by)
        status = await run.status(NAVIGATOR, lambda status: status.state == "idle", ROUTE_TIMEOUT)
        if not status.text.startswith("flew"):
            raise Refused(status.text)
        return {**status.detail.get("summary", {}), "text": status.text}


async def _by_a_controller(run: Rig, name: str, seconds: float) -> float:
    """Gives when the lemniscate began (UTC s)."""
    await run.fly_by(name, name)
    begin = await follow(run, name, seconds)
    await asyncio.sleep(begin + seconds + 0.5 - time.time())
    await run.vehicle.tell(name, "hold")  # refused where it does not fly any more: then somebody else has flown
    return begin


async def _by_the_autopilot(run: Rig, seconds: float) -> float:
    """The same reference, position with velocity and acceleration, streamed as one point after the other."""
    centre = np.array(CENTRE)
    async with run.vehicle.lease("bench", ttl=3.0) as lease:
        begin = time.time() + 2.0 * STILL
        at = time.monotonic()
        while (now := time.time()) < begin + seconds + 0.5:
            _put(lease, lemniscate(now + AHEAD - begin, seconds, centre), YAW)
            at += 1.0 / STREAM_HZ
            await asyncio.sleep(max(0.0, at - time.monotonic()))
    return begin


def _put(lease: Lease, point: tuple[Array, Array, Array], yaw: float) -> None:
    (n, e, d), (vn, ve, vd), (an, ae, ad) = (each.tolist() for each in point)
    lease.setpoint(pos=(n, e, d), vel=(vn, ve, vd), acc=(an, ae, ad), yaw=yaw)
