"""Three copters of an autopilot's own SITL whose planner is cut off in flight: whether they come home apart.

    python tests/bench/plan_return_flown.py tcp:127.0.0.1:5760 tcp:127.0.0.1:5770 tcp:127.0.0.1:5780
        --origin -35.363262,149.165237,584 [--height 12] [--after 5] [--land-after 5]

Start each SITL some metres from the others. Places are those that the vehicles say of themselves.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import itertools
import math
import os
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import zmav
from agents.planner.cli.asking import find
from agents.planner.live.agent import Agent
from agents.planner.live.settings import PlannerSettings
from tests.conftest import endpoint_of
from tests.waiting import until
from zmav import wire
from zmav.config import Failsafe
from zmav.onboard import Onboard, OnboardSettings
from zmav.session import SessionSettings, open_session
from zmav.waiting import together
from zmav.wire import swarm

PATIENCE_S = 180.0
ROUTER = SessionSettings(mode="router", listen=["tcp/127.0.0.1:0"], cfg=("scouting/delay:0",))


async def rise(vehicle: zmav.Vehicle, height: float) -> None:
    await vehicle.wait_until(lambda s: bool(s.connected and s.ready), PATIENCE_S)
    await vehicle.arm()
    await vehicle.takeoff(height)


async def fly(args: argparse.Namespace) -> None:
    lat, lon, alt = map(float, args.origin.split(","))
    origin = wire.Origin(lat_deg=lat, lon_deg=lon, alt_amsl=alt)
    failsafe = Failsafe(land_after=args.land_after, action="land", returns="together")
    names = [f"quad{i + 1}" for i in range(len(args.links))]
    async with contextlib.AsyncExitStack() as stack:
        router = stack.enter_context(open_session(ROUTER))
        for name, link in zip(names, args.links, strict=True):
            settings = OnboardSettings(link=link, name=name, origin=origin, failsafe=failsafe)
            await stack.enter_async_context(Onboard(router, settings))
        endpoint = endpoint_of(router)
        me = await stack.enter_async_context(zmav.open(connect=[endpoint]))
        vehicles = await me.wait_for(*names, timeout=PATIENCE_S)
        z = await stack.enter_async_context(zmav.open(connect=[endpoint]))
        agent = await stack.enter_async_context(Agent(z, PlannerSettings(name="ground", patience=1.0)))
        await agent.context.solver.until_ready(PATIENCE_S)
        await until(lambda: all(places(vehicles).values()), "places", PATIENCE_S)
        starts = places(vehicles)
        await together(*(rise(vehicle, args.height) for vehicle in vehicles))
        there = [(n + 40.0, e, -args.height) for n, e, _ in reversed(starts.values())]  # across each other
        planner = await find(me)
        await planner.order("submit", swarm.Submit(goal=swarm.GoTo(vehicles=names, to=there)))
        await until(lambda: all(home(vehicle) for vehicle in vehicles), "ways home", PATIENCE_S)
        print("all have a way home stored")
        least, rows = math.inf, 0
        await asyncio.sleep(args.after)
        agent.context.z.session.close()
        cut, said = time.monotonic(), set[str]()
        print("the planner is cut off")
        while time.monotonic() < cut + PATIENCE_S:
            now, rows = places(vehicles), rows + 1
            for a, b in itertools.combinations(now.values(), 2):
                least = min(least, math.hypot(a[0] - b[0], a[1] - b[1], (a[2] - b[2]) / 1.5))
            for vehicle in vehicles:
                state = vehicle.last_state
                word = f"{vehicle.name}: {state.mover}, {state.mode}" if state else ""
                if word and word not in said:
                    said.add(word)
                    print(f"{time.monotonic() - cut:6.1f} s  {word} at {[round(x, 1) for x in now[vehicle.name]]}")
            if all(vehicle.last_state and not vehicle.last_state.armed for vehicle in vehicles):
                break
            await asyncio.sleep(0.1)
        ends = places(vehicles)
        away = {name: round(math.dist(ends[name][:2], starts[name][:2]), 2) for name in names}
        print(f"nearest two ever {least:.2f} m apart, {rows} looks; m from where each took off: {away}", flush=True)
        os._exit(0)  # a session that was closed under its client cannot be left in order


def places(vehicles: list[zmav.Vehicle]) -> dict[str, wire.Vector]:
    return {v.name: v.last_state.local if v.last_state and v.last_state.local else () for v in vehicles}  # type: ignore[misc]


def home(vehicle: zmav.Vehicle) -> bool:
    state = vehicle.last_state
    return state is not None and state.segment is not None and state.segment.home is not None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("links", nargs="+")
    parser.add_argument("--origin", required=True)
    parser.add_argument("--height", type=float, default=12.0)
    parser.add_argument("--after", type=float, default=5.0)
    parser.add_argument("--land-after", type=float, default=5.0)
    asyncio.run(fly(parser.parse_args()))


if __name__ == "__main__":
    main()
