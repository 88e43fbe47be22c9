"""What ``zmav doctor`` looks at: checks, each a function from what was seen to findings."""

from __future__ import annotations

import asyncio
import platform
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import msgspec
import zenoh

import zmav
from zmav import keys, wire
from zmav.autopilots.safety import Safety
from zmav.cli.finding import Finding
from zmav.cli.info import routers
from zmav.cli.safetycheck import Value, judge, read_safety
from zmav.cli.trustcheck import Trust, judge_trust, look_at_trust
from zmav.client import Client
from zmav.errors import ZmavError
from zmav.trust.credentials import Credentials

PACKAGES = ("zmav", "eclipse-zenoh", "pymavlink", "fastcrc", "pyserial", "numpy", "msgspec")
MAX_LOSS = 0.02
MAX_BAD_CRC = 0.01
MAX_CLOCK_OFFSET = 0.1
"""s; a setpoint is valid for half a second, by the sender's clock"""
PINGS = 5


class Clock(msgspec.Struct, frozen=True):
    """A vehicle's clock less ours in seconds, and by how much that may be wrong: half the round trip."""

    offset: float
    within: float


class Seen(msgspec.Struct, frozen=True):
    """What was seen of the key space; the dicts are by vehicle, and lack those that said nothing."""

    vehicles: list[zmav.Vehicle]
    routers: list[dict[str, Any]]
    links: dict[str, list[wire.LinkQuality]]
    """oldest first"""
    clocks: dict[str, Clock | ZmavError]
    safety: dict[str, dict[Safety, Value | None] | ZmavError]
    trust: Trust | None = None


async def look(z: Client, seconds: float, own: Credentials | None = None) -> Seen:
    """Listen for ``seconds``, then ask; what is shown to prove who one is, is judged by our ``own`` credentials."""
    links: dict[str, list[wire.LinkQuality]] = defaultdict(list)

    def on_link(sample: zenoh.Sample) -> wire.LinkQuality:
        quality = wire.decode(sample.payload.to_bytes(), wire.LinkQuality, "link")
        links[_vehicle_in(str(sample.key_expr))].append(quality)
        return quality

    async def listen() -> None:
        async with z.subscribe(keys.LINK.key(z.fleet_name, "*", link="*"), on_link) as qualities:
            async for _ in qualities:
                pass

    listener = asyncio.create_task(listen())
    await asyncio.sleep(seconds)
    listener.cancel()
    vehicles = await z.settle()
    present = [v for v in vehicles if v.present]
    names = [label(v) for v in present]
    clocks = await asyncio.gather(*map(_clock_of, present))
    safety = await asyncio.gather(*map(read_safety, present))
    by_name = dict(zip(names, clocks, strict=True)), dict(zip(names, safety, strict=True))
    trust = await look_at_trust(z, own, [v.name for v in present])
    return Seen(vehicles, await routers(z), dict(links), *by_name, trust)


def label(vehicle: zmav.Vehicle) -> str:
    """``fleet/name``."""
    return f"{vehicle.fleet}/{vehicle.name}"


def _vehicle_in(key: str) -> str:
    return "/".join(key.split("/")[1:3])


async def _clock_of(vehicle: zmav.Vehicle) -> Clock | ZmavError:
    """By the quickest of a few round trips, taken to be as long there as back."""
    clocks = []
    try:
        for _ in range(PINGS):
            sent = time.time()
            there = float((await vehicle.order("ping", wire.Order()))["t"])
            back = time.time()
            clocks.append(Clock(there - (sent + back) / 2, (back - sent) / 2))
    except ZmavError as e:
        return e
    return min(clocks, key=lambda clock: clock.within)


def versions() -> Iterator[Finding]:
    """Python and the packages that carry zmav."""
    found, missing = [f"Python {platform.python_version()}"], []
    for package in PACKAGES:
        try:
            found.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            missing.append(package)
    if missing:
        yield Finding(False, "packages", f"not installed: {', '.join(missing)}", "install zmav with its dependencies")
    yield Finding(True, "packages", ", ".join(found))


def check_routers(seen: Seen) -> Iterator[Finding]:
    if not seen.routers:
        advice = "its admin space is off: set adminspace.enabled in its Zenoh configuration"
        yield Finding(False, "router", "one answers, but tells nothing about itself", advice)
    names = {v.last_state.instance: v.name for v in seen.vehicles if v.last_state}
    ours = version("eclipse-zenoh")
    for router in seen.routers:
        links = [link["whatami"] for link in router["links"]]
        who = f"router {names.get(router['zid'], router['zid'][:8])}"
        found = f"linked routers: {links.count('router')}, clients: {links.count('client')}"
        if router["version"].split(".")[:2] != ours.split(".")[:2]:
            found += f", Zenoh {router['version']}, but {ours} here"
            yield Finding(False, who, found, "install one version of Zenoh everywhere")
        else:
            yield Finding(True, who, f"{found}, on {' '.join(router['locators']) or 'no endpoint'}")


def check_vehicles(seen: Seen) -> Iterator[Finding]:
    if not seen.vehicles:
        advice = "start 'zmav up' beside an autopilot ('zmav sim' makes one), or name its router with -e"
        yield Finding(False, "vehicles", "none", advice)
    for vehicle in seen.vehicles:
        yield _presence(vehicle)


def _presence(vehicle: zmav.Vehicle) -> Finding:
    who, state, age = label(vehicle), vehicle.last_state, vehicle.age
    if state is None or age is None:
        return Finding(False, who, "present, but its state does not come", "is its zmav of the version used here?")
    if age > (keys.STATE.stale_after or 0.0):
        advice = "is its computer on, and its router linked to this one?"
        return Finding(False, who, f"last heard {age:.0f} s ago", advice)
    if not state.connected:
        found = "its autopilot is silent" if state.sysid else "no autopilot has been heard"
        advice = "on the vehicle, look at power, cable, port and baud rate; 'zmav doctor --link URL' tells more there"
        return Finding(False, who, f"{found} (link {state.link})", advice)
    what = " ".join(filter(None, (state.kind, "by", state.autopilot, state.firmware)))
    armed = "armed" if state.armed else "disarmed"
    return Finding(True, who, f"{what}, system id {state.sysid}, {armed} in {state.mode}")


def check_clashes(seen: Seen) -> Iterator[Finding]:
    for vehicle in seen.vehicles:
        if vehicle.last_state and vehicle.last_state.clash:
            advice = "give one another --name, or another MAV_SYSID (SYSID_THISMAV, MAV_SYS_ID)"
            yield Finding(False, f"{label(vehicle)} identity", vehicle.last_state.clash, advice)


def check_links(seen: Seen) -> Iterator[Finding]:
    for vehicle in seen.vehicles:
        qualities = seen.links.get(label(vehicle))
        if qualities:
            yield from _judge_link(f"{label(vehicle)} link", qualities[0], qualities[-1])


def _judge_link(who: str, first: wire.LinkQuality, last: wire.LinkQuality) -> Iterator[Finding]:
    """By what came between two reports, so that an old trouble that is over is none."""
    frames, lost = last.rx_frames - first.rx_frames, last.lost - first.lost
    bad, dropped = last.bad_crc - first.bad_crc, last.rx_dropped - first.rx_dropped
    ok = True
    if lost > MAX_LOSS * (frames + lost):
        ok = False
        advice = "ask for fewer messages, or a higher baud rate with flow control; on a radio, look at the antennas"
        yield Finding(False, who, f"{lost} of {frames + lost} frames lost", advice)
    if bad > MAX_BAD_CRC * (frames + bad):
        ok = False
        advice = "look at baud rate, ground and cable; another --dialect may be spoken"
        yield Finding(False, who, f"{bad} of {frames + bad} frames damaged", advice)
    if dropped:
        ok = False
        advice = "raise net.core.rmem_max (sysctl), and see what else keeps this computer busy"
        yield Finding(False, who, f"{dropped} datagrams dropped by the kernel", advice)
    if ok:
        rtt = "-" if last.rtt is None else f"{1e3 * last.rtt:.1f} ms"
        yield Finding(True, who, f"{last.url} {last.state}, {last.rx_rate:.0f} frames/s, round trip {rtt}")


def check_readiness(seen: Seen) -> Iterator[Finding]:
    for vehicle in seen.vehicles:
        state = vehicle.last_state
        if state is None or not state.connected:
            continue
        gps = f"GPS {state.gps.fix}, {state.gps.satellites} satellites" if state.gps else "no GPS heard"
        if state.armed or state.ready:
            yield Finding(True, f"{label(vehicle)} readiness", f"{'armed' if state.armed else 'ready to arm'}, {gps}")
        else:
            advice = f"wait for GPS and EKF under open sky; its reasons: zmav echo {vehicle.name}/event"
            yield Finding(False, f"{label(vehicle)} readiness", f"{'; '.join(state.not_ready)} ({gps})", advice)


def check_clocks(seen: Seen) -> Iterator[Finding]:
    for who, clock in seen.clocks.items():
        if isinstance(clock, ZmavError):
            yield Finding(False, f"{who} clock", f"it does not answer: {clock}", "is its 'zmav up' overloaded?")
            continue
        found = f"{1e3 * clock.offset:+.1f} ms against ours, ±{1e3 * clock.within:.1f} ms"
        if abs(clock.offset) - clock.within > MAX_CLOCK_OFFSET:
            advice = "setpoints will be dropped as too late or too early: synchronise the clocks (chrony, GPS, PTP)"
            yield Finding(False, f"{who} clock", found, advice)
        else:
            yield Finding(True, f"{who} clock", found)


def check_safety(seen: Seen) -> Iterator[Finding]:
    """What the autopilot does by itself when its companion is dead."""
    for vehicle in seen.vehicles:
        values, who = seen.safety.get(label(vehicle)), f"{label(vehicle)} failsafe"
        if isinstance(values, ZmavError):
            yield Finding(False, who, f"its parameters cannot be read: {values}", "is its link up?")
        elif values:
            yield from (Finding(ok, who, found, advice) for ok, found, advice in judge(vehicle, values))


def check_trust(seen: Seen) -> Iterator[Finding]:
    yield from judge_trust(seen.trust, time.time())


CHECKS: tuple[Callable[[Seen], Iterator[Finding]], ...] = (
    check_routers,
    check_vehicles,
    check_clashes,
    check_links,
    check_readiness,
    check_clocks,
    check_safety,
    check_trust,
)
