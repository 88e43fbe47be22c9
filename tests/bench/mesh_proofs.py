"""The mesh's proofs in the lab, at full length. Needs root and /dev/net/tun.

    python tests/bench/mesh_proofs.py [chain6] [ring6] [loss] [partition] [wds] [fleet30] [--credentials] [--quick]

Each proof is a lab of its own: network namespaces, links that are relayed, delayed, lost and cut, simulated copters
behind 'zmav up'. Prints what was measured; ends with 1 where something that must never happen did. The short versions
are tests (tests/mesh/proofs). With --credentials the links are QUIC with mutual TLS, and what the vehicles are told is
signed; without, UDP.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import os
import statistics
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path

import msgspec

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import zmav
from mesh.lab.lab import Lab
from mesh.lab.scenario import Scenario
from tests.mesh.proofs import proofs, rigs
from tests.mesh.proofs.tap import Tap
from zmav import keys

HOPS = 5
failures: list[str] = []


def must(true: bool, text: str) -> None:
    """What is to hold however slow the machine is."""
    print(f"  {'ok' if true else 'FAILED'}: {text}")
    if not true:
        failures.append(text)


@contextlib.asynccontextmanager
async def running(scenario: Scenario, host: str = "ground") -> AsyncIterator[tuple[Lab, zmav.Client]]:
    """A lab whose vehicles are all heard at a client of that host."""
    async with Lab(scenario) as lab:
        try:
            await lab.ready()
            async with rigs.station(lab, host) as z:
                await rigs.all_heard(z, lab)
                yield lab, z
        except Exception:
            print(rigs.logs(lab))
            raise


async def chain6(credentials: bool, quick: bool) -> None:
    """ground and five copters in a line, no delay of the links' own."""
    async with running(rigs.chain(HOPS, credentials=credentials)) as (lab, z):
        count, medians, ages = 20 if quick else 200, [], []
        for i in range(1, HOPS + 1):
            vehicle = z.vehicle(f"quad{i}")
            took = await rigs.pings(vehicle, count)
            medians.append(statistics.median(took))
            states = await _delays(z, lab, vehicle.name, 3.0 if quick else 10.0)
            ages.append(statistics.median(states))
            print(
                f"  {i} hops: order and answer {rigs.milliseconds(took)}; "
                f"state one way {rigs.milliseconds(states)}, {len(states)} of them"
            )
            must(len(took) == count, f"{len(took)} of {count} orders were answered over {i} hops")
        each = (medians[-1] - medians[0]) / (HOPS - 1) / 2
        print(f"  per added hop, one way: orders {1e3 * each:.2f} ms, states {1e3 * (ages[-1] - ages[0]) / 4:.2f} ms")
        last = z.vehicle(f"quad{HOPS}")
        await rigs.in_the_air(last)
        must(last.state.armed is True and last.state.landed is not True, "the last vehicle took off when told to")
        await last.land()
        must(last.state.armed is not True, "and landed")


async def _delays(z: zmav.Client, lab: Lab, name: str, seconds: float) -> list[float]:
    """s from a state's own time to its arrival: all hosts of a lab have one clock."""
    found: list[float] = []

    def convert(sample: object) -> None:
        payload = sample.payload.to_bytes()  # type: ignore[attr-defined]  # a zenoh.Sample
        found.append(time.time() - float(msgspec.json.decode(payload)["t"]))

    subscriber = z.session.declare_subscriber(keys.STATE.key(lab.fleet, name), convert)
    await asyncio.sleep(seconds)
    subscriber.undeclare()
    return found


async def ring6(credentials: bool, quick: bool) -> None:
    """Six hosts in a ring, 2 ms a hop; the path in use is cut, with orders and setpoints under way.

    With links that are given up after 3 s first, for comparison, and then with the profile's own.
    """
    for lease, cuts in ((3.0, 4 if quick else 10), (None, 4 if quick else 20)):
        print(f"  lease {lease or 'of the profile'}:")
        await _cut_ring(rigs.ring(credentials=credentials, delay="2 ms", lease=lease), cuts)


async def _cut_ring(scenario: Scenario, cuts: int) -> None:
    async with running(scenario) as (lab, z):
        await rigs.in_the_air(z.vehicle("quad1"))
        saw = await proofs.recovery(lab, z, cuts)
        gaps = sorted(saw.gaps)
        print(f"  {len(gaps)} cuts: without telemetry {rigs.milliseconds(gaps)} median (worst)")
        print(f"  orders: {saw.orders.done} done, {len(saw.orders.lost)} lost, slowest {saw.orders.slowest:.1f} s")
        must(not saw.orders.lost and saw.orders.done > len(gaps), f"no order was lost {saw.orders.lost[:3]}")
        print(f"  leases that ended: {len(saw.ended)} {saw.ended[:3]}")
        must(0 < saw.flown <= saw.sent, f"{saw.flown} of {saw.sent} setpoints were flown, and no more")


async def loss(credentials: bool, quick: bool) -> None:
    """20 % loss and 100 ms in each direction of every hop, with the profile's own leases."""
    hops = 3 if quick else HOPS
    lab_file = rigs.chain(1, relays=hops - 1, credentials=credentials, loss=0.2, delay="100 ms")
    async with running(lab_file) as (lab, z):
        saw = await proofs.must_arrive(lab, z, "quad1", 5 if quick else 30)
        print(f"  {hops} hops: {len(saw.given)} orders in {saw.took:.0f} s, {len(saw.failed)} failed {saw.failed[:2]}")
        must(not saw.failed, "every order was answered")
        must(saw.heard == saw.given, "each was done once, and every event came once and in order")
        if saw.heard != saw.given:
            print(saw.given, saw.heard, sep="\n")
        print(f"  ping: {rigs.milliseconds(await rigs.pings(z.vehicle('quad1'), 20))}")


async def partition(credentials: bool, quick: bool) -> None:
    """A vehicle two hops away that flies a stream, cut off for a minute while the planner goes on."""
    seconds = 6.0 if quick else 60.0
    with tempfile.TemporaryDirectory(prefix="zmav-proof-") as folder:
        scenario, link = tapped(rigs.chain(1, relays=1, credentials=credentials, delay="5 ms"), Path(folder))
        directory = Path(folder) / "lab"
        with Tap(directory / "quad1.pty", link) as tap:
            async with Lab(scenario, directory) as lab:
                try:
                    await lab.ready()
                    async with rigs.station(lab) as z:
                        await rigs.all_heard(z, lab)
                        await rigs.in_the_air(z.vehicle("quad1"))
                        saw = await proofs.partition(lab, z, tap, "relay1-quad1", seconds)
                except Exception:
                    print(rigs.logs(lab))
                    raise
    print(f"  alone for {saw.healed - saw.cut:.0f} s; heard again {saw.back:.2f} s after the link came back")
    print(f"  the vehicle said: {saw.said}")
    print(f"  the planner was told: {saw.lost}")
    print(f"  from put to the last frame made of it: {saw.oldest:.2f} s at most")
    must(any("hold" in text for text in saw.said), "it held")
    must(quick or any("RTL" in text for text in saw.said), "and came home when it stayed alone")
    must(saw.before > 20, f"its autopilot was given {saw.before} setpoints of the stream before the cut")
    must(saw.alone > 20, f"the planner put {saw.alone} while it was alone")
    must(not saw.during, f"nothing of the stream reached the autopilot while it was alone {sorted(saw.during)[:5]}")
    must(not saw.stale, f"nor later, of what was put meanwhile {sorted(saw.stale)[:5]}")
    must(saw.again > 0, f"under a new lease it flies again ({saw.again} setpoints)")


def tapped(scenario: Scenario, folder: Path) -> tuple[Scenario, Path]:
    """The scenario with quad1's serial line leading through ``folder / "tap"``."""
    link = folder / "tap"
    quad = msgspec.structs.replace(scenario.hosts["quad1"], arguments=["--link", str(link)])
    return msgspec.structs.replace(scenario, hosts={**scenario.hosts, "quad1": quad}), link


async def wds(credentials: bool, quick: bool) -> None:
    """Three access points in a row, a host behind each; the hop in the middle goes and comes."""
    async with running(rigs.wds(credentials=credentials, delay="3 ms", rate="6 Mbit/s")) as (lab, z):
        states: list[bytes] = []
        z.session.declare_subscriber(keys.STATE.key(lab.fleet, "*"), lambda s: states.append(s.payload.to_bytes()))
        for name in ("quad1", "quad2"):
            print(f"  {name}: order and answer {rigs.milliseconds(await rigs.pings(z.vehicle(name), 20))}")
        vehicle, times = z.vehicle("quad2"), rigs.Gaps(z, lab.fleet, "quad2")
        for _ in range(1 if quick else 5):
            at = time.monotonic()
            for link in rigs.BEHIND_THE_HOP:
                lab.cut(link)
            await asyncio.sleep(6.0)  # twice a lease: the routers part
            healed = time.monotonic()
            for link in rigs.BEHIND_THE_HOP:
                lab.heal(link)
            await times.again(healed)
            print(f"  cut for 6 s: telemetry {times.longest(at) - (healed - at):.2f} s after the hop was back")
        async with proofs.giving_orders(vehicle) as orders:
            await asyncio.sleep(2.0)
        must(not orders.lost and orders.done > 0, f"orders go through again ({orders.done} done)")
        must(proofs.states_twice(states) == 0, f"no state came twice ({len(states)} came)")


async def fleet30(credentials: bool, quick: bool) -> None:
    """Thirty hosts on a grid of 6 by 5, each hearing its neighbours."""
    width, height = (3, 2) if quick else (6, 5)
    hosts = width * height
    start = time.monotonic()
    async with Lab(rigs.grid(width, height, credentials=credentials)) as lab:
        await lab.ready(timeout=180.0)
        print(f"  {hosts} routers' processes are up {time.monotonic() - start:.1f} s after the start")
        async with rigs.station(lab, "h0") as z:
            first = await proofs.formed(z.session, hosts, 120.0)
            print(f"  all answer the first {first:.1f} s after the last was up")
            took = []
            for _ in range(1 if quick else 3):
                lab.cut("all")
                await asyncio.sleep(4.0)
                lab.heal("all")
                took.append(await proofs.formed(z.session, hosts, 120.0))
            print(f"  every link cut for 4 s and healed: all answer after {', '.join(f'{t:.1f}' for t in took)} s")
            async with rigs.station(lab, f"h{hosts - 1}") as far:
                await proofs.formed(far.session, hosts, 60.0)
            must(True, "the host in the far corner hears all, too")
        await asyncio.sleep(3.0)
        before, seconds = lab.network.counted(), 5.0 if quick else 20.0
        await asyncio.sleep(seconds)
        after = lab.network.counted()
        rates = [
            sum(after.channels[n].arrived_bytes - before.channels[n].arrived_bytes for n in (edge.ab, edge.ba))
            / seconds
            for edge in lab.network.wiring.edges
        ]
        print(f"  idle: {statistics.median(rates):.0f} B/s a link both ways (median), {max(rates):.0f} at most")


PROOFS: dict[str, Callable[[bool, bool], Awaitable[None]]] = {
    each.__name__: each for each in (chain6, ring6, loss, partition, wds, fleet30)
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("proof", nargs="*", help=", ".join(PROOFS))
    parser.add_argument("--credentials", action="store_true", help="QUIC with mutual TLS, and proofs of origin")
    parser.add_argument("--quick", action="store_true", help="shorter, for a look")
    args = parser.parse_args()
    if unknown := set(args.proof) - set(PROOFS):
        parser.error(f"no proof {', '.join(unknown)}; there are {', '.join(PROOFS)}")
    if not rigs.able():
        return 0
    for name in args.proof or PROOFS:
        print(f"{name}, load {os.getloadavg()[0]:.1f}: {PROOFS[name].__doc__}", flush=True)
        try:
            asyncio.run(_run(PROOFS[name](args.credentials, args.quick)))
        except Exception as e:  # the other proofs are still worth running
            must(False, f"{name} ended: {e!r}")
        print(f"  load at the end {os.getloadavg()[0]:.1f}", flush=True)
    return 1 if failures else 0


async def _run(proof: Awaitable[None]) -> None:
    await proof


if __name__ == "__main__":
    sys.exit(main())
