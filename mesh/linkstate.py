"""The map of the network that Zenoh's routers have, and the ways they take by it, from the links that each tells of.

Every Zenoh router floods its links to all others, and sends what is for another router along the shortest paths over
them: those of the fewest hops, and among equals the one that a fraction in the weights says, which both ends of a link
reckon alike from their ids. So the links, which every router tells of in its admin space (``@/*/router``), say the way.

The map itself (``linkstate/north``) and the tables that follow from it (``route/successor``) are there, too, and are
never asked for: a router of Zenoh 1.10.2 answers under a lock that it takes a second time for the answer, and where a
declaration comes between the two it stands still for good, with the process and all in it (zenoh pull request 2619).
"""

from __future__ import annotations

import heapq
import re
from collections.abc import Mapping

import msgspec

from zmav.client import Answer, Client

ROUTER_ID = re.compile(r"[0-9a-f]{1,32}\Z")
ASKED = "@/*/router"
LARGEST = 1_000_000
"""bytes of one router's answer that are read: some 2,000 links"""
WEIGHT = 100.0
"""of a link that nobody gave another one"""
Map = dict[str, dict[str, float]]
"""router's id -> those it is linked with, and the weights of these links"""
_MASK = (1 << 64) - 1


def read(answers: Mapping[str, bytes]) -> Map:
    """The map from what routers answered, by their ids; what is none of it is left out.

    There is a link where both ends tell of it, or the one that answered.
    """
    told = {zid: _neighbours(data) for zid, data in answers.items() if ROUTER_ID.match(zid)}
    found: Map = {zid: {} for zid in told}
    for one, others in told.items():
        for other in others - {one}:
            if one in told.get(other, (one,)):
                found[one][other] = found.setdefault(other, {})[one] = weight(one, other)
    return found


class _Session(msgspec.Struct):
    peer: str
    whatami: str


class _Router(msgspec.Struct):
    sessions: list[_Session]


def _neighbours(data: bytes) -> set[str]:
    try:
        sessions = msgspec.json.decode(data[:LARGEST], type=_Router).sessions
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return set()
    return {each.peer for each in sessions if each.whatami == "router" and ROUTER_ID.match(each.peer)}


def weight(one: str, other: str) -> float:
    """What Zenoh reckons a link to weigh that has no weight of its own (``update_edge`` in its ``network.rs``)."""
    low, high = sorted(int(zid, 16).to_bytes(16, "little") for zid in (one, other))
    share = siphash13(low + high) & 0xFFFFFFFF
    return WEIGHT * (1.0 + 0.01 * share / 0xFFFFFFFF)


def siphash13(data: bytes) -> int:
    """SipHash-1-3 (Aumasson and Bernstein 2012) with a key of zero, which is Rust's ``DefaultHasher``."""
    v = [0x736F6D6570736575, 0x646F72616E646F6D, 0x6C7967656E657261, 0x7465646279746573]
    padded = data + bytes(7 - len(data) % 8) + bytes([len(data) & 0xFF])
    for i in range(0, len(padded), 8):
        word = int.from_bytes(padded[i : i + 8], "little")
        v[3] ^= word
        _round(v)
        v[0] ^= word
    v[2] ^= 0xFF
    for _ in range(3):
        _round(v)
    return v[0] ^ v[1] ^ v[2] ^ v[3]


def _round(v: list[int]) -> None:
    for a, b, turn, c, d, more in ((0, 1, 13, 2, 3, 16), (2, 1, 17, 0, 3, 21)):
        v[a] = (v[a] + v[b]) & _MASK
        v[c] = (v[c] + v[d]) & _MASK
        v[b] = _turned(v[b], turn) ^ v[a]
        v[d] = _turned(v[d], more) ^ v[c]
        v[a] = _turned(v[a], 32)


def _turned(value: int, by: int) -> int:
    return (value << by | value >> 64 - by) & _MASK


def ways(links: Mapping[str, Mapping[str, float]], source: str) -> dict[str, list[str]]:
    """The way of least weight from ``source`` to each that it reaches, both ends included."""
    came: dict[str, str] = {}
    queue = [(0.0, source, source)]
    while queue:
        far, here, before = heapq.heappop(queue)
        if here in came:
            continue
        came[here] = before
        for there, more in links.get(here, {}).items():
            if there not in came:
                heapq.heappush(queue, (far + more, there, here))
    found: dict[str, list[str]] = {}
    for target in came:  # in the order they were reached: each after the one before it
        found[target] = [source] if target == source else [*found[came[target]], target]
    return found


def zid_of(key: str) -> str | None:
    """Whose answer it is, by its key; None: no router's."""
    parts = key.split("/")
    return parts[1] if len(parts) == 3 and ROUTER_ID.match(parts[1]) else None


async def trace(z: Client, source: str, timeout: float = 1.0, tries: int = 3) -> dict[str, list[str]]:
    """Ids of the routers from ``source`` to each that it reaches, both ends included, by what all tell of their links.

    Empty where it does not answer. ``source`` is the id of a router.
    """
    for _ in range(tries):
        answers = {}
        for answer in await z.ask(ASKED, timeout=timeout):
            if isinstance(answer, Answer) and (zid := zid_of(answer.key)):
                answers[zid] = answer.payload
        if source in answers:
            return ways(read(answers), source)
    return {}
