"""The named kinds of network: how neighbours find each other in each, and how soon one that is gone is noticed.

``lan``    one wired segment: everybody hears everybody at little cost. Neighbours find each other by multicast, and
           each is linked with each: beyond a dozen hosts, name neighbours or take ``wds``.
``wds``    bridged Wi-Fi, one segment over several hops: everybody reaches everybody, and multicast is slow and lossy.
           Neighbours whose addresses the file has are called by address, the others found by multicast.
``mesh``   only neighbours hear each other, and who that is changes: single-hop ad-hoc Wi-Fi (IBSS, or 802.11s with
           forwarding off), where zmav's routers relay. Each that is heard by multicast is a neighbour. Where batman-adv
           or 802.11s forwards below, everybody is one segment again: use ``wds``, and name the few neighbours.
``multi``  several radios a host: each neighbour is called through all of them, the cheapest way preferred.
``cloud``  no host can be called but a rendezvous: everybody calls it, often enough that a NAT keeps the way open.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from zmav.config import Profile


@dataclass(frozen=True)
class Rules:
    """What a profile means for one router."""

    scouting: bool
    """hosts that are not named may be found by multicast, router to router"""
    calls_all: bool
    """without ``neighbours`` in the file, all hosts with an address on a network of ours are neighbours"""
    listens: bool
    """its radios can be called"""
    lease: float
    """s without a word after which a neighbour is lost"""
    keep_alive: int
    """words within a lease"""
    retry: float
    """s between attempts to reach a neighbour, at most"""
    opening: float
    """s that opening a link may take, three round trips and what is lost on them"""
    second_port: bool = False
    """radios where neighbours are found listen on two ports: a call that is lost half-way holds one for 30 s (Zenoh
    1.10), and who found us tries the other. Who calls by address would go on calling both for ever"""


# Measured on a segment of two hosts, Zenoh 1.10.2, four words a lease; B/s are both directions with all headers:
#
#   lease    udp?rel=1  quic   a cut is noticed    back after an outage of 3 to 10 s, median and worst
#    1 s      1206 B/s  2236   0.85 s              0.68, 1.61 s
#    2 s       520 B/s  1129   1.62 s              0.60, 1.47 s
#    5 s       358 B/s
#   10 s       175 B/s   262
#
# Opening within 1 s never succeeds at 300 ms one way. At 100 ms and 20 % loss each way, openings one after another for
# 80 s, median and worst: given 1 s, 3.1 and 24 s (udp), 22 and over 40 s (quic); given 2 s, 2.8 and 11 s, 1.7 and 14 s;
# given 3 s, 1.5 and 10 s, 2.1 and 8.4 s; longer brings nothing. After an outage, without loss: 0.8 s given 1 s, 1.0 s
# given 2 s, 0.8 s given 3 s, 1.5 s given 6 s. QUIC calls at once and after 1 and 3 s: a neighbour that is heard again
# shortly after the call at 1 s waits for the next opening. ``wds`` gives one 2 s and 0.2 s between two, so that no call
# is more than 1.2 s behind the last; at 100 ms and 20 % that opens as soon as 3 s and 1 s do (24 of each with 0.3 s:
# p90 5.0 and 6.0 s, 4.8 and 5.1 s). Who is away costs 1.1 kB/s then.
#
# Links lost at 100 ms and 20 %, udp and quic alike: 23 in 1440 s with leases of 1 s and 4 words (once none again for
# 295 s, with opening given 1 s); 7 in 1440 s with 2 s and 4 words; none in 1200 s with 3 s and 6, for the same bytes.
# What is lost is sent again after 0.3 s at best, and later each time, and holds up what comes behind it on its stream.
# With words on all seven streams (``mesh/quality/probe.py``) a short lease outlives that, for the same bytes:
#
#   lease    words of               links lost an hour, at 100 ms and 20 %, udp
#   1.0 s    Zenoh alone, 4         591
#   0.8 s    Zenoh alone, 8         576
#   0.8 s    four streams, 8         25
#   0.8 s    seven streams, 8         0 in 1.5 hours of links; 18 in 7.5 beside loads of 8 to 20 on two cores
#
# So ``wds`` and ``mesh`` notice a cut within 0.8 s. Ten words a second are much for a radio with a budget: ``SLOW``.
#
# An outage that is shorter than the lease loses nothing on the reliable lane and delivers it late, in
# a burst as old as the outage: the lease is also the greatest age of what is repeated.
PROFILES: Mapping[Profile, Rules] = {
    "lan": Rules(scouting=True, calls_all=False, listens=True, lease=1.0, keep_alive=4, retry=1.0, opening=2.0),
    "wds": Rules(scouting=True, calls_all=True, listens=True, lease=0.8, keep_alive=8, retry=0.2, opening=2.0),
    "mesh": Rules(
        scouting=True,
        calls_all=False,
        listens=True,
        lease=0.8,
        keep_alive=8,
        retry=1.0,
        opening=3.0,
        second_port=True,
    ),
    "multi": Rules(scouting=False, calls_all=True, listens=True, lease=2.0, keep_alive=4, retry=1.0, opening=4.0),
    "cloud": Rules(scouting=False, calls_all=False, listens=False, lease=10.0, keep_alive=4, retry=4.0, opening=5.0),
}
SLOW = 3.0, 6
"""``wds`` and ``mesh``: lease in s and words within it where a radio of the fleet has a budget"""


def timers(profile: Profile, budget: bool) -> tuple[float, int]:
    """Lease in s and words within it; ``budget``: some radio of the fleet has one."""
    rules = PROFILES[profile]
    return SLOW if budget and profile in ("wds", "mesh") else (rules.lease, rules.keep_alive)
