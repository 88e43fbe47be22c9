"""The named kinds of network: how neighbours find each other in each, and how soon one that is gone is noticed.

``lan``    one wired segment: everybody hears everybody at little cost. Neighbours find each other by multicast.
``wds``    bridged Wi-Fi, one segment over several hops: everybody reaches everybody, and multicast is slow and lossy.
           Neighbours whose addresses the file has are called by address, the others found by multicast.
``mesh``   only neighbours hear each other, and who that is changes: single-hop ad-hoc Wi-Fi (IBSS, or 802.11s with
           forwarding off), where zmav's routers relay. Whoever is heard by multicast is a neighbour. Where batman-adv
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


PROFILES: Mapping[Profile, Rules] = {
    "lan": Rules(scouting=True, calls_all=False, listens=True, lease=1.0, keep_alive=4, retry=1.0),
    "wds": Rules(scouting=True, calls_all=True, listens=True, lease=2.0, keep_alive=4, retry=1.0),
    "mesh": Rules(scouting=True, calls_all=False, listens=True, lease=2.0, keep_alive=4, retry=2.0),
    "multi": Rules(scouting=False, calls_all=True, listens=True, lease=2.0, keep_alive=4, retry=1.0),
    "cloud": Rules(scouting=False, calls_all=False, listens=False, lease=10.0, keep_alive=4, retry=4.0),
}
