"""Plans flown by simulated copters over a bad mesh: how near they came to each other, by the simulator. Needs root.

    python tests/bench/plan_flown.py [swap|kill] [--vehicles 20] [--runs 20] [--loss 0.3] [--seed 0]

A lab of its own: namespaces, a radio that over two hops delays frames by 50 to 200 ms and loses the given share of
them, two in a row on average; storms that cut one to three vehicles off from everybody for 2 s, every 4 to 8 s;
'zmav up' for every copter, 'zmav swarm planner' on the ground. Obstacles stand in the middle.

swap: all change places at once, at random, again and again. kill: the planner is killed at random moments of such
swaps, its standby goes on with them and is killed in turn, until there were so many deaths as ``--runs`` says. Ends
with 1 where two vehicles came nearer than the sum of their radii, one nearer to an obstacle than its own, or a swap was
not done.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import itertools
import math
import random
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import AsyncIterator, Mapping, Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import zmav
from mesh.lab.lab import Lab
from mesh.lab.scenario import Scenario
from tests.mesh.proofs import rigs
from zmav import keys, wire
from zmav.errors import ZmavError
from zmav.sim import Remote
from zmav.wire import swarm

RADIUS = 1.0
"""m: what a copter's body is usually taken for"""
DOWNWASH = 1.5
RING = 18.0
HEIGHT = 12.0
TREES = [(4.0, 3.0), (-5.0, 4.0), (-3.0, -6.0), (6.0, -5.0), (0.0, 10.0), (10.0, 1.0)]
TRUNK = 0.8
LINK_LEASE = 8.0
"""s without a word after which a link is given up"""
MOMENTS = (0.0, 40.0)
"""s that a planner flies a swap, or goes on with it, until it is killed: by then its standby is ready"""
PATIENCE = 400.0
"""s for one swap, with all its storms"""


LOITER = {"action": "loiter"}


def scenario(count: int, standby: bool, resort: bool, failsafe: Mapping[str, Any] = LOITER) -> Scenario:
    """Copters on a ring, each hearing the next, every other one the ground, and the rest a standby's van where there is
    one: one or two hops, and two ways.
    """
    hosts: dict[str, Any] = {"ground": {"position": [0.0, 60.0]}}
    if standby:
        hosts["van"] = {"position": [0.0, -60.0]}
    for i, (north, east) in enumerate(ring(count)):
        hosts[f"quad{i + 1}"] = {"vehicle": "copter", "position": [north, east]}
    quads = [name for name in hosts if name.startswith("quad")]
    pairs = [*zip(quads, [*quads[1:], quads[0]], strict=True), *(("ground", name) for name in quads[::2])]
    if standby:
        pairs += [("van", name) for name in quads[1::2]] + [("ground", "van")]
    medium = {
        "kind": "radio",
        "name": "mesh",
        "interface": "wlan0",
        "pairs": pairs,
        "rate": "6 Mbit/s",
        "delay": "62 ms",
        "jitter": "37 ms",
        "loss": 0.0,
        "burst": 2.0,
    }
    # A link outlasts the storms: opened again with so much loss, it takes ten seconds to come back from one of two.
    more = {"failsafe": dict(failsafe), "separation": {"on": resort}, "mesh": {"lease": LINK_LEASE}}
    return rigs.scenario(name="swap", profile="mesh", hosts=hosts, media=[medium], fleet=more)


def ring(count: int) -> list[tuple[float, float]]:
    angles = [math.tau * i / count for i in range(count)]
    return [(round(RING * math.cos(a), 2), round(RING * math.sin(a), 2)) for a in angles]


class Truth:
    """Where the simulated vehicles really are, twenty times a second; straight on between two looks.

    ``radii``: of each (:data:`RADIUS`); ``trees``: (m north, m east) of what stands there.
    """

    def __init__(
        self, control: Path, names: list[str], radii: Sequence[float] = (), trees: Sequence[tuple[float, float]] = TREES
    ) -> None:
        self._remote, self.names, self._trees = Remote(control), names, trees
        self._radii = radii or [RADIUS] * len(names)
        self._stop = threading.Event()
        self.places: list[wire.Vector] = []
        self.reset()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def reset(self) -> None:
        self.apart, self.pair, self.clear, self.looks = math.inf, ("", ""), math.inf, 0
        """m of the nearest two, of larger ones so much less as their radii are larger; who; m to a tree; how often"""
        self._last: list[wire.Vector] | None = None

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._remote.close()

    def _run(self) -> None:
        while not self._stop.wait(0.05):
            found = {vehicle.name: vehicle.ned_m for vehicle in self._remote.status().vehicles}
            places = [found[name] for name in self.names]
            before = self._last or places
            for i, j in itertools.combinations(range(len(places)), 2):
                away = _nearest(before[i], places[i], before[j], places[j]) + 2 * RADIUS
                away -= self._radii[i] + self._radii[j]
                if away < self.apart:
                    self.apart, self.pair = away, (self.names[i], self.names[j])
            for place, (north, east) in itertools.product(places, self._trees):
                self.clear = min(self.clear, math.hypot(place[0] - north, place[1] - east) - TRUNK)
            self._last, self.places, self.looks = places, places, self.looks + 1


def _nearest(p0: wire.Vector, p1: wire.Vector, q0: wire.Vector, q1: wire.Vector) -> float:
    """The least distance of two that go straight from their first place to their second; height counts by downwash."""
    a = (p0[0] - q0[0], p0[1] - q0[1], (p0[2] - q0[2]) / DOWNWASH)
    b = (p1[0] - q1[0], p1[1] - q1[1], (p1[2] - q1[2]) / DOWNWASH)
    d = [y - x for x, y in zip(a, b, strict=True)]
    square = sum(x * x for x in d)
    share = min(1.0, max(0.0, -sum(x * y for x, y in zip(a, d, strict=True)) / square)) if square else 0.0
    return math.hypot(*(x + share * y for x, y in zip(a, d, strict=True)))


class Planners:
    """The book of the one in charge, and orders for him."""

    def __init__(self, z: zmav.Client) -> None:
        self._z = z
        self.book: swarm.Book | None = None
        key = keys.FLEET.key(z.fleet_name, topic="goal")
        self._news = asyncio.Event()
        self._books = z.subscribe(key, lambda s: wire.decode(s.payload.to_bytes(), swarm.Book, "book"))
        self._task = asyncio.create_task(self._read())

    async def _read(self) -> None:
        async with self._books as books:
            async for book in books:
                if self.book is None or book.term >= self.book.term:
                    self.book = book
                    self._news.set()

    async def until(self, true: Any, timeout: float = PATIENCE) -> swarm.Book:
        deadline = time.monotonic() + timeout
        while self.book is None or not true(self.book):
            self._news.clear()
            left = deadline - time.monotonic()
            if left <= 0.0:
                raise TimeoutError(f"it did not come true; the last book: {self.book}")
            with contextlib.suppress(asyncio.TimeoutError):
                await asyncio.wait_for(self._news.wait(), left)
        return self.book

    async def order(self, verb: str, args: wire.Order) -> dict[str, Any]:
        """Asked until it is answered: the id makes it one order."""
        assert self.book is not None
        for _ in range(20):
            key = keys.SWARM.key(self._z.fleet_name, self.book.planner, verb=verb)
            for answer in await self._z.ask(key, wire.encode(args), timeout=3.0, channel=keys.SWARM):
                if isinstance(answer, ZmavError):
                    raise answer
                outcome = wire.decode(answer.payload, wire.Outcome, verb)
                if outcome.status == "done":
                    return outcome.result
        raise TimeoutError(f"nobody answers {verb}")


async def storms(lab: Lab, rng: random.Random) -> None:
    """Every few seconds some vehicles are cut off from everybody for 2 s."""
    links = {
        name: [edge.name for edge in lab.network.wiring.edges if name in (edge.a, edge.b)]
        for name in lab.scenario.hosts
    }
    while True:
        await asyncio.sleep(rng.uniform(2.0, 6.0))
        hit = rng.sample([name for name in links if name.startswith("quad")], k=rng.randint(1, 3))
        cut = {link for name in hit for link in links[name]}
        for link in cut:
            lab.cut(link)
        await asyncio.sleep(2.0)
        for link in cut:
            lab.heal(link)


def planner(lab: Lab, host: str, *more: str) -> subprocess.Popen[bytes]:
    log = (lab.directory / f"planner-{host}.log").open("ab")
    command = ["-m", "zmav", "swarm", "planner", "--name", host, *more]
    return lab.spawn(host, sys.executable, *command, stdout=log, stderr=log)


@contextlib.asynccontextmanager
async def fleet(
    args: argparse.Namespace,
    standby: bool,
    trees: Sequence[tuple[float, float]] = TREES,
    failsafe: Mapping[str, Any] = LOITER,
) -> AsyncIterator[tuple[Lab, zmav.Client, list[str], Truth]]:
    """All in the air, at their places on the ring."""
    count, loss = args.vehicles, args.loss
    async with Lab(scenario(count, standby, not args.alone, failsafe)) as lab:
        await lab.ready()
        async with rigs.station(lab) as z:
            await rigs.all_heard(z, lab, 180.0)
            names = [f"quad{i + 1}" for i in range(count)]
            await asyncio.gather(*(rigs.in_the_air(z.vehicle(name), HEIGHT) for name in names))
            for edge in lab.network.wiring.edges:
                lab.set(edge.name, loss=1.0 - math.sqrt(1.0 - loss))
            truth = Truth(lab.directory / "sim.sock", names, trees=trees)
            try:
                yield lab, z, names, truth
            finally:
                truth.close()


async def campaign(args: argparse.Namespace, kill: bool) -> bool:
    rng = random.Random(args.seed)
    async with fleet(args, kill) as (lab, z, names, truth):
        try:
            rows = await _runs(args, kill, lab, Planners(z), names, truth, rng)
        except Exception:
            _logs(lab)
            raise
        good = all(row["good"] for row in rows)
        if not good:
            _logs(lab)
    took = [row["took"] for row in rows]
    deaths = f", {sum(row['kills'] for row in rows)} planners killed" if kill else ""
    print(
        f"{sum(row['good'] for row in rows)} of {len(rows)} good{deaths}: "
        f"least separation {min(row['apart'] for row in rows):.2f} m (must be {2 * RADIUS:.2f}), "
        f"least clearance {min(row['clear'] for row in rows):.2f} m (must be {RADIUS:.2f}); "
        f"took {statistics.median(took):.0f} s in the median, {max(took):.0f} s at most"
    )
    return good


async def _runs(
    args: argparse.Namespace,
    kill: bool,
    lab: Lab,
    planners: Planners,
    names: list[str],
    truth: Truth,
    rng: random.Random,
) -> list[dict[str, Any]]:
    running = {"ground": planner(lab, "ground")}
    await planners.until(lambda book: book.planner == "ground")
    if kill:
        running["van"] = planner(lab, "van", "--standby")
    for i, (north, east) in enumerate(TREES):
        tree = swarm.Cylinder(center=(north, east), radius=TRUNK, floor=0.0, ceiling=40.0)
        obstacle = swarm.Obstacle(name=f"tree{i}", t=time.time(), what=tree)
        await planners.order("obstacle", swarm.GiveObstacle(id=f"tree{i}", obstacle=obstacle))
    await _known(planners, names)
    weather = asyncio.create_task(storms(lab, rng))
    rows: list[dict[str, Any]] = []
    try:
        while (sum(row["kills"] for row in rows) if kill else len(rows)) < args.runs:
            if kill:
                left = args.runs - sum(row["kills"] for row in rows)
                rows.append(await killed(lab, planners, names, truth, rng, running, len(rows), left))
            else:
                rows.append(await swapped(planners, names, truth, rng, len(rows)))
        return rows
    finally:
        weather.cancel()


async def _known(planners: Planners, names: list[str]) -> None:
    """The planner has heard of all, and not long ago: it takes goals for them."""
    while not set(names) <= set((await planners.order("status", wire.Order()))["vehicles"]):
        await asyncio.sleep(0.5)


def _logs(lab: Lab) -> None:
    for log in lab.directory.glob("planner-*.log"):
        print(log.name, log.read_text()[-3000:], sep="\n")


def _swap(names: list[str], rng: random.Random, run: int) -> swarm.Submit:
    places = ring(len(names))
    rng.shuffle(places)
    to = [(north, east, -HEIGHT) for north, east in places]
    return swarm.Submit(id=f"swap{run}-{rng.random():.9f}", goal=swarm.GoTo(vehicles=names, to=to))


async def swapped(planners: Planners, names: list[str], truth: Truth, rng: random.Random, run: int) -> dict[str, Any]:
    """One swap to its end."""
    await _known(planners, names)
    truth.reset()
    start = time.monotonic()
    given = await planners.order("submit", _swap(names, rng, run))
    return await _ended(planners, str(given["goal"]), truth, start, run, "")


async def killed(
    lab: Lab,
    planners: Planners,
    names: list[str],
    truth: Truth,
    rng: random.Random,
    running: dict[str, Any],
    run: int,
    most: int,
) -> dict[str, Any]:
    """One swap whose planner dies again and again on the way; the other goes on with it, the dead one comes again."""
    await _known(planners, names)
    truth.reset()
    start = time.monotonic()
    given = await planners.order("submit", _swap(names, rng, run))
    goal, deaths = str(given["goal"]), list[str]()
    while len(deaths) < most:
        book = await planners.until(
            lambda book: any(e.id == goal and e.state in ("flying", "done", "failed", "cancelled") for e in book.goals)
        )
        await asyncio.sleep(rng.uniform(*MOMENTS))
        if planners.book is not None:
            book = planners.book
        if any(e.id == goal and e.state in ("done", "failed", "cancelled") for e in book.goals):
            break
        victim = book.planner
        deaths.append(f"{victim} after {time.monotonic() - start:.0f} s")
        print(f"       killed {deaths[-1]}, so far {truth.apart:.2f} m apart, trees {truth.clear:.2f} m", flush=True)
        running[victim].kill()
        running[victim].wait()
        running[victim] = planner(lab, victim, "--standby")
        await planners.until(lambda book, victim=victim: book.planner != victim)
    row = await _ended(planners, goal, truth, start, run, f"{len(deaths)} killed: {', '.join(deaths)};")
    return {**row, "kills": len(deaths)}


async def _ended(planners: Planners, goal: str, truth: Truth, start: float, run: int, more: str) -> dict[str, Any]:
    ended = ("done", "failed", "cancelled")
    book = await planners.until(lambda book: any(e.id == goal and e.state in ended for e in book.goals))
    entry = next(e for e in book.goals if e.id == goal)
    row = {"took": time.monotonic() - start, "apart": truth.apart, "clear": truth.clear, "state": entry.state}
    row["good"] = truth.apart >= 2 * RADIUS and truth.clear >= RADIUS and entry.state == "done"
    print(
        f"  {run + 1:3d}: {entry.state} in {row['took']:5.1f} s (plan {entry.makespan or 0.0:.1f} s), separation "
        f"{truth.apart:.2f} m {truth.pair}, trees {truth.clear:.2f} m, {truth.looks} looks {more} {entry.text}",
        flush=True,
    )
    return row


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="?", choices=["swap", "kill"], default="swap")
    parser.add_argument("--vehicles", type=int, default=20)
    parser.add_argument("--runs", type=int, default=2)
    parser.add_argument("--loss", type=float, default=0.3)
    parser.add_argument("--alone", action="store_true", help="without the vehicles' own last resort")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    if not rigs.able():
        return 0
    over = f"over two hops loss {args.loss:.0%} and 50-198 ms"
    print(f"{args.what}: {args.vehicles} copters, {over}, storms of 2 s", flush=True)
    return 0 if asyncio.run(campaign(args, args.what == "kill")) else 1


if __name__ == "__main__":
    sys.exit(main())
