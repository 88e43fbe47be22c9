"""What ``zmav doctor`` says of routers, and of the links between them."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.metadata import version

from zmav.doctor import topics
from zmav.doctor.findings import Finding
from zmav.doctor.survey import Survey
from zmav.doctor.ways import Link

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
