"""What ``zmav doctor`` judges of routers, vehicles and the fleet: checks, each a function from what was seen to
findings.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import version

import msgspec

from zmav import keys, wire
from zmav.doctor import topics
from zmav.doctor.air import check_remote_id, check_traffic
from zmav.doctor.computer import check_host, check_versions
from zmav.doctor.credentials import judge_trust
from zmav.doctor.facts import Facts, facts_of
from zmav.doctor.failsafes import judge
from zmav.doctor.findings import Finding
from zmav.doctor.link import MAX_BAD_CRC
from zmav.doctor.rules import reasons
from zmav.doctor.survey import Survey, label
from zmav.doctor.topics import Topic
from zmav.doctor.ways import Link, loss_level
from zmav.errors import ZmavError
from zmav.vehicle.vehicle import Vehicle

NEARER = "look at antennas, distance, channel and power; 'watch zmav mesh graph' shows it while you move one"


def check_routers(seen: Survey) -> Iterator[Finding]:
    if not seen.routers:
        advice = "its admin space is off: set adminspace.enabled in its Zenoh configuration"
        yield topics.ROUTER.wrong("one answers, but tells nothing about itself that can be read", advice)
    names = {v.last_state.instance: v.name for v in seen.vehicles if v.last_state}
    names |= {token["instance"]: token["vehicle"] for token in seen.tokens if token["role"] == "router"}
    ours = version("eclipse-zenoh")
    for zid, router in seen.routers.items():
        links = [session.whatami for session in router.sessions]
        who = names.get(zid, zid[:8])
        found = f"linked routers: {links.count('router')}, clients: {links.count('client')}"
        zenoh = router.version.removeprefix("v").partition("-")[0]
        if zenoh.split(".")[:2] != ours.split(".")[:2]:
            found += f", Zenoh {zenoh}, but {ours} here"
            yield topics.ROUTER.wrong(found, "install one version of Zenoh everywhere: pip install eclipse-zenoh", who)
        else:
            yield topics.ROUTER.well(f"{found}, on {' '.join(router.locators) or 'no endpoint'}", who)


def check_ways(seen: Survey) -> Iterator[Finding]:
    """Both ends' words on each link between two routers put together, the weakest link first."""
    pairs = {(min(ends), max(ends)) for ends in seen.neighbours}
    links = [Link(a, b, seen.neighbours.get((a, b)), seen.neighbours.get((b, a))) for a, b in pairs]
    links.sort(key=Link.badness, reverse=True)
    well = True
    for link in links:
        words, name = _words(link), f"{link.a} - {link.b}"
        well = well and link.grade in ("good", "unknown")
        if link.state == "down":
            yield topics.WAY.wrong(f"{words}, within the last minute", f"is that host on? {NEARER}", name)
        elif link.state == "silent" and link.age is None:
            yield topics.WAY.advise(f"{words}, nothing measured", "is it a 'zmav router' or a 'zmav up'?", name)
        elif link.grade in ("down", "poor"):
            yield topics.WAY.wrong(words, NEARER, name)
        elif link.grade == "fair":
            yield topics.WAY.advise(words, NEARER, name)
    if links and well:
        weakest = links[0]
        yield topics.WEAKEST.well(f"of {len(links)}: {weakest.a} - {weakest.b}: {_words(weakest)}")


def _words(link: Link) -> str:
    lost = [] if link.worst_loss is None else [f"{link.worst_loss:.0%} lost"]
    trip = [] if link.rtt is None else [f"round trip {1e3 * link.rtt:.1f} ms"]
    return ", ".join([link.state, *lost, *trip])


MAX_CLOCK_OFFSET = 0.1
"""s; a setpoint is valid for half a second, by the sender's clock"""
SYNCHRONISE = "setpoints will be dropped as too late or too early: synchronise the clocks (chrony, GPS, PTP)"
OTHER_ID = "give one another MAV_SYSID (SYSID_THISMAV, MAV_SYS_ID) and restart its autopilot"
UNIQUE = ("planner", "router")
"""roles of which a name stands for one program; of vehicles, they tell it themselves"""


ALARMS: dict[str, Topic] = {
    "state": topics.PRESENCE,
    "autopilot": topics.PRESENCE,
    "status": topics.PRESENCE,
    "clash": topics.IDENTITY,
    "disbelieved": topics.IDENTITY,
    "link-poor": topics.HEARING,
    "link-loss": topics.HEARING,
    "not-ready": topics.READINESS,
    "gps-fix": topics.READINESS,
    "gps-weak": topics.READINESS,
    "position-old": topics.READINESS,
    "corrections-old": topics.CORRECTIONS,
    "corrections-far": topics.CORRECTIONS,
    "corrections-unused": topics.CORRECTIONS,
    "traffic-close": topics.NEAR,
    "traffic-coming": topics.NEAR,
    "battery-empty": topics.BATTERY,
    "battery-low": topics.BATTERY,
    "clock": topics.CLOCK,
    "recording": topics.PRESENCE,
}
"""where what :mod:`zmav.doctor.rules` finds wrong stands; what else it knows of is for who watches a flight"""
GROUNDING = ("not-ready", "clock")
"""less than bad in flight, and reason enough not to begin one"""


def check_vehicles(seen: Survey) -> Iterator[Finding]:
    """What is wrong with each by the rules that all share; then, of what is not, how it is."""
    for vehicle in seen.vehicles:
        told = set[str]()
        for reason in reasons(facts_of(vehicle, link=_heard(seen.links.get(label(vehicle))))):
            topic = ALARMS.get(reason.rule)
            if topic is None:
                continue
            wrong = reason.level == "bad" or reason.rule in GROUNDING
            told.add(topic.name)
            yield (topic.wrong if wrong else topic.advise)(reason.text, reason.advice, label(vehicle))
        yield from (each for each in _well(vehicle) if each.topic not in told)


def _heard(qualities: list[wire.LinkQuality] | None) -> wire.LinkQuality | None:
    """The link's quality by what came between two reports, so that an old trouble that is over is none."""
    if not qualities:
        return None
    first, last = qualities[0], qualities[-1]
    frames, lost = last.rx_frames - first.rx_frames, last.lost - first.lost
    return msgspec.structs.replace(last, loss=lost / (frames + lost) if frames + lost else 0.0)


def _well(vehicle: Vehicle) -> Iterator[Finding]:
    state, who = vehicle.last_state, label(vehicle)
    if state is None or not state.connected:
        return
    what = " ".join(filter(None, (state.kind, "by", state.autopilot, state.firmware)))
    armed = "armed" if state.armed else "disarmed"
    yield topics.PRESENCE.well(f"{what}, system id {state.sysid}, {armed} in {state.mode}", who)
    gps = f"GPS {state.gps.fix}, {state.gps.satellites} satellites" if state.gps else "no GPS heard"
    yield topics.READINESS.well(f"{'armed' if state.armed else 'ready to arm'}, {gps}", who)
    if (found := state.corrections) is not None and found.age is not None:
        far = "" if found.baseline is None else f", base {found.baseline / 1e3:.1f} km away"
        yield topics.CORRECTIONS.well(f"from {found.source}, {found.age:.1f} s old, {found.rate:.0f} B/s{far}", who)
    if state.battery is not None and state.battery.remaining is not None:
        yield topics.BATTERY.well(f"{state.battery.remaining:.0%} left", who)


def check_links(seen: Survey) -> Iterator[Finding]:
    for vehicle in seen.vehicles:
        qualities = seen.links.get(label(vehicle))
        if qualities:
            yield from _judge_link(label(vehicle), qualities[0], qualities[-1])


def _judge_link(who: str, first: wire.LinkQuality, last: wire.LinkQuality) -> Iterator[Finding]:
    """By what came between two reports, too; what is lost of them, the rules judge."""
    frames = last.rx_frames - first.rx_frames
    bad, dropped = last.bad_crc - first.bad_crc, last.rx_dropped - first.rx_dropped
    quality = _heard([first, last])
    ok = quality is not None and loss_level(quality.loss) == "ok"
    if bad > MAX_BAD_CRC * (frames + bad):
        ok = False
        advice = "look at baud rate, ground and cable; another --dialect may be spoken"
        yield topics.HEARING.wrong(f"{bad} of {frames + bad} frames damaged", advice, who)
    if dropped:
        ok = False
        advice = "raise net.core.rmem_max (sysctl), and see what else keeps this computer busy"
        yield topics.HEARING.wrong(f"{dropped} datagrams dropped by the kernel", advice, who)
    if ok:
        rtt = "-" if last.rtt is None else f"{1e3 * last.rtt:.1f} ms"
        found = f"{last.url} {last.state}, {last.rx_rate:.0f} frames/s, round trip {rtt}"
        yield topics.HEARING.well(found, who)


def check_clocks(seen: Survey) -> Iterator[Finding]:
    for who, clock in seen.clocks.items():
        if isinstance(clock, ZmavError):
            yield topics.CLOCK.wrong(f"it does not answer: {clock}", "is its 'zmav up' overloaded?", who)
            continue
        found = f"{1e3 * clock.offset:+.1f} ms against ours, ±{1e3 * clock.within:.1f} ms"
        if abs(clock.offset) - clock.within > MAX_CLOCK_OFFSET:
            yield topics.CLOCK.wrong(found, SYNCHRONISE, who)
        else:
            yield topics.CLOCK.well(found, who)


def check_safety(seen: Survey) -> Iterator[Finding]:
    """What the autopilot does by itself when its companion is dead."""
    for vehicle in seen.vehicles:
        values, who = seen.safety.get(label(vehicle)), label(vehicle)
        if isinstance(values, ZmavError):
            yield topics.FAILSAFE.wrong(f"its parameters cannot be read: {values}", "is its link up?", who)
        elif values:
            yield from judge(vehicle, values, who)


def check_terrain(seen: Survey) -> Iterator[Finding]:
    """Nothing of who keeps no ground and is asked for none."""
    for who, told in seen.terrain.items():
        if told is None:
            continue
        for name, why in told.faults.items():
            yield topics.TERRAIN.wrong(f"{name} cannot be read: {why}", "load it again: zmav terrain load", who)
        if told.missing:
            asked = f"its autopilot asks for ground that is not there: {', '.join(told.missing[:4])}"
            yield topics.TERRAIN.advise(asked, "zmav terrain load, with a larger --radius", who)
        elif told.pieces:
            heights = f"{told.pending} grids pending" if told.pending else "its autopilot waits for nothing"
            yield topics.TERRAIN.well(f"{len(told.pieces)} pieces of ground, {heights}", who)


def check_air(seen: Survey) -> Iterator[Finding]:
    yield from check_remote_id(seen.remote_ids)
    yield from check_traffic(seen.agents)


def check_gimbals(seen: Survey) -> Iterator[Finding]:
    """Nothing of who has none."""
    for who, told in seen.gimbals.items():
        if told is not None:
            at = f", looks at {told['at']}" if told.get("at") else ""
            yield topics.GIMBAL.well(f"a gimbal answers, controlled by {told['controller']}{at}", who)


def check_trust(seen: Survey) -> Iterator[Finding]:
    yield from judge_trust(seen.trust, time.time())


def check_hosts(seen: Survey) -> Iterator[Finding]:
    """The computers of vehicles and of ground hosts."""
    for who, told in sorted(seen.hosts.items()):
        if isinstance(told, wire.HostReport):
            yield from check_host(told, who)
        else:
            text = f"tells nothing that can be read here: {told if isinstance(told, ZmavError) else 'another zmav'}"
            yield topics.COMPUTER.advise(text, "bring its zmav to the version used here", who)
    ground = {f"{token['fleet']}/{token['vehicle']}" for token in seen.tokens if token["role"] == "router"}
    vehicles = {label(v) for v in seen.vehicles if v.present}
    for who in sorted((ground | vehicles) - seen.hosts.keys()):
        yield topics.COMPUTER.advise("tells nothing of itself", "bring its zmav to the version used here", who)


# The fleet as a whole.


def check_fleet(seen: Survey) -> Iterator[Finding]:
    there = {vehicle.name for vehicle in seen.vehicles if vehicle.present}
    if not seen.vehicles:
        advice = "start 'zmav up' beside an autopilot ('zmav sim' makes one), or name its router with -e"
        yield topics.VEHICLES.wrong("none", advice)
    missing = [name for name in seen.file.vehicles if name not in there] if seen.file else []
    if missing:
        found = f"not heard: {', '.join(missing)}"
        if seen.name in (seen.file.vehicles if seen.file else {}) and seen.name not in missing:
            yield topics.VEHICLES.advise(found, "where they should be on: are their routers linked to this one?")
        else:
            yield topics.VEHICLES.wrong(found, "is 'zmav up' running there, and its router linked to this one?")
    elif seen.vehicles:
        whole = " (all of the fleet file)" if seen.file else ""
        yield topics.VEHICLES.well(f"{len(there)} present{whole}")


def check_sysids(seen: Survey) -> Iterator[Finding]:
    by_id: dict[int, list[Vehicle]] = defaultdict(list)
    for vehicle in seen.vehicles:
        state = vehicle.last_state
        if state is None or state.sysid is None or not state.connected:
            continue
        by_id[state.sysid].append(vehicle)
        table = seen.file.vehicles.get(vehicle.name) if seen.file else None
        if table is not None and table.sysid not in (None, state.sysid):
            text = (
                f"{label(vehicle)} is {state.sysid}, and vehicles.{vehicle.name}.sysid of the fleet file {table.sysid}"
            )
            yield topics.SYSIDS.wrong(
                text, "correct the file, or its autopilot's MAV_SYSID (SYSID_THISMAV, MAV_SYS_ID)"
            )
    for sysid, vehicles in sorted(by_id.items()):
        if len({v.fleet for v in vehicles}) == len(vehicles):
            continue  # one of each fleet
        uids = [v.last_state.uid for v in vehicles if v.last_state]
        if None in uids or len(set(uids)) > 1:  # else one autopilot, heard by several companions
            yield topics.SYSIDS.wrong(f"{', '.join(map(label, vehicles))} all have {sysid}", OTHER_ID)


def check_firmware(seen: Survey) -> Iterator[Finding]:
    found: dict[str, dict[str, list[str]]] = defaultdict(lambda: defaultdict(list))
    for vehicle in seen.vehicles:
        state = vehicle.last_state
        if state and state.connected and state.firmware:
            found[f"{state.autopilot} {state.kind}"][state.firmware].append(vehicle.name)
    for kind, versions in sorted(found.items()):
        if len(versions) > 1:
            said = "; ".join(f"{number}: {', '.join(names)}" for number, names in sorted(versions.items()))
            yield topics.FIRMWARE.advise(f"{kind}: {said}", "flash one version, so that they fly alike")
        else:
            yield topics.FIRMWARE.well(f"{kind}: {next(iter(versions))}")


def check_names(seen: Survey) -> Iterator[Finding]:
    instances: dict[tuple[str, str, str], set[str]] = defaultdict(set)
    for token in seen.tokens:
        instances[token["role"], token["fleet"], token["vehicle"]].add(token["instance"])
    for (role, fleet, name), found in sorted(instances.items()):
        if len(found) > 1 and role in (*UNIQUE, keys.VEHICLE):
            yield topics.NAMES.wrong(f"{len(found)} of the role {role} are named {fleet}/{name}", "end one of them")
    for vehicle in seen.vehicles:
        if not keys.NAME.match(vehicle.name):
            yield topics.NAMES.wrong(f"{vehicle.name!r} cannot be a name", "see who says that: zmav echo 'zmav/**'")


def check_agents(seen: Survey) -> Iterator[Finding]:
    for agent in seen.agents:
        said = f"{agent.fleet}/{agent.host} {agent.name}: {agent.state}{', ' if agent.text else ''}{agent.text}"
        said += f", silent for {agent.age:.0f} s" if agent.stale else ""
        found = reasons(Facts(name=agent.host, agents=(agent,)))
        yield topics.AGENTS.wrong(said, found[0].advice) if found else topics.AGENTS.well(said)


def check_version(seen: Survey) -> Iterator[Finding]:
    yield from check_versions({who: told for who, told in seen.hosts.items() if not isinstance(told, ZmavError)})


def check_doctor(seen: Survey) -> Iterator[Finding]:
    for what in seen.unfinished:
        yield topics.DOCTOR.wrong(what, "try again; if it stays, look at the hosts one by one with -e")


CHECKS: tuple[Callable[[Survey], Iterator[Finding]], ...] = (
    check_routers,
    check_ways,
    check_vehicles,
    check_links,
    check_clocks,
    check_safety,
    check_terrain,
    check_air,
    check_gimbals,
    check_trust,
    check_hosts,
    check_fleet,
    check_sysids,
    check_names,
    check_version,
    check_firmware,
    check_agents,
    check_doctor,
)


def examine(seen: Survey, checks: Sequence[Callable[[Survey], Iterator[Finding]]] = CHECKS) -> Iterator[Finding]:
    """All of it. A check that fails, by whatever somebody out there says, is a finding and ends no other."""
    for check in checks:
        try:
            yield from list(check(seen))
        except Exception as e:
            name = check.__name__.removeprefix("check_")
            yield topics.DOCTOR.wrong(f"the check of {name} failed: {e!r}", "please report this line")
