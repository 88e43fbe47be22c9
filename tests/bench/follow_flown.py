"""A rover followed by its pad, flown by the simulator's truth: on board and over a bad video link; and landings.

    python tests/bench/follow_flown.py [alone|board|ground|land] [--runs 1] [--seconds 60] [--speed 1] [--wind 5,light]

alone: what to compare with: no rover, no camera; the autopilot is told the same figure of eight exactly, place and
velocity, and how far it is off by its own estimate is what its own controller makes of that wind. board: pictures are
looked at beside the camera. ground: on the far side of a video link of 200 ms that loses 10 % of the pictures' chunks
and of the reports on them (all else goes another way), and followed from there. land: on a rover at rest, again and
again, measured as the feet come to the deck, through which they go.

Each run starts everything again (_follow_rig.py), and a mean begins 5 s after the first sight. Light gusts are
those of MIL-F-8785C for a mean wind of 7.7 m/s, moderate ones for 15 m/s. Ends with 1 where a mean distance, or a
landing, was worse than what is asked for: 0.2 m on board (0.3 m in moderate gusts), 0.6 m, 0.15 m.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import math
import os
import statistics
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from rich.console import Console

from deploy.demos.drive import Way, eight
from tests.bench._follow_rig import FLEET, QUAD, Demonstration, Rig, figures, fly, scene
from tests.bench._video import FAR, BadVideo
from zmav.children import Children, connect_once_up
from zmav.errors import ZmavError

ASKED = {"alone": math.inf, "board": 0.2, "ground": 0.6, "land": 0.15}
IN_MODERATE = {"board": 0.3}
"""m: what is allowed in moderate gusts, where that is more"""
DELAY, LOSS = 0.2, 0.1
SETTLED = 5.0
"""s from the first sight until the distance counts"""
TICK = 0.05


def at_rest(t: float) -> tuple[float, float]:
    return 0.0, 0.0


def run(what: str, args: argparse.Namespace, seed: int) -> float:
    """m: the mean distance while it was followed; of a landing, the last one."""
    way: Way = at_rest if what == "land" else eight(args.speed)
    options = ["--wind", args.wind, "--noise", "typical", "--seed", str(seed)]
    with contextlib.ExitStack() as stack:
        processes = stack.enter_context(Children(at_once=True, by_signals=True))
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="zmav-follow-"))
        if what == "ground":
            rig: Rig = stack.enter_context(contextlib.closing(Far(processes, Path(folder), options, True, FAR)))
        else:
            rig = Rig(processes, Path(folder), options, False)
        if what == "alone":
            found = statistics.mean(asyncio.run(alone(rig, way, args.seconds)))
            print(f"  {what}, seed {seed}: {found:.2f} m")
            return found
        try:
            shown = asyncio.run(
                fly(rig, Console(quiet=True), way, 5.0 if what == "land" else args.seconds, False, what == "land")
            )
        except ZmavError as e:
            print(f"  failed: {e}")
            for name in ("camera", "helipad", "follower"):
                print(name, processes.said(name, 8), sep="\n")
            return math.inf
        rows = shown.truth.rows
        begun = next((row[0] for row in rows if row[6] == "track"), math.inf) + SETTLED
        above = [math.dist(row[1:3], row[4:6]) for row in rows if row[0] > begun]
        found = shown.truth.touched() if what == "land" else statistics.mean(above)
        on_ground = f" ({math.dist(rows[-1][1:3], rows[-1][4:6]):.2f} m on the ground below)" if what == "land" else ""
        print(f"  {what}, seed {seed}: {found:.2f} m{on_ground}; {'; '.join(figures(shown))}", flush=True)
        return found


class Far(Rig):
    """Pictures come to the ground over a bad link."""

    _video: BadVideo | None = None

    def start_agents(self) -> None:
        self._video = BadVideo(self.board, self.ground, FLEET, QUAD, DELAY, LOSS)
        super().start_agents()

    def close(self) -> None:
        if self._video is not None:
            self._video.close()


async def alone(rig: Rig, way: Way, seconds: float) -> list[float]:
    """m off the place that the autopilot was told, by its own estimate, at each tick."""
    off = []
    async with contextlib.AsyncExitStack() as stack:
        rig.start(scene(False))
        z = await connect_once_up(stack, FLEET, rig.ground, rig.processes.check)
        shown = Demonstration(z, rig.control, Console(quiet=True))
        await shown.ready()
        quad = shown.quad
        lease = await stack.enter_async_context(quad.lease("bench"))
        await quad.arm()
        await quad.takeoff(5.0)
        north, east, down = quad.local
        begun = time.monotonic()
        while (t := time.monotonic() - begun) < SETTLED + seconds:
            (a, b), (c, d) = way(t), way(t + TICK)
            lease.setpoint(pos=(north + a, east + b, down), vel=((c - a) / TICK, (d - b) / TICK, 0.0), valid=0.4)
            if t > SETTLED:
                off.append(math.dist(quad.local[:2], (north + a, east + b)))
            await asyncio.sleep(TICK)
    return off


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="?", choices=[*ASKED, "all"], default="all")
    parser.add_argument("--runs", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--speed", type=float, default=1.0)
    parser.add_argument("--wind", default="5,light")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    good = True
    for what in ASKED if args.what == "all" else [args.what]:
        print(f"{what}, wind {args.wind}, rover up to {args.speed:g} m/s, load {os.getloadavg()[0]:.1f}:", flush=True)
        found = [run(what, args, args.seed + k) for k in range(args.runs)]
        most = IN_MODERATE.get(what, ASKED[what]) if "moderate" in args.wind else ASKED[what]
        word = "good" if (fine := max(found) <= most) else "MISSED"
        asked = f"; asked for {most:g} m: {word}" if math.isfinite(most) else ""
        worst, middle = max(found), statistics.median(found)
        print(f"{what}: {middle:.2f} m in the median, {worst:.2f} m at most of {len(found)}{asked}", flush=True)
        good &= fine
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
