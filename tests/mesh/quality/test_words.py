"""Words on many streams: what a lease outlives, reckoned over hours of a link that loses; and which are sent."""

from __future__ import annotations

import asyncio
import itertools
import random
from collections import Counter

import pytest
import zenoh
from zenoh import handlers

from mesh.profiles import PROFILES
from mesh.quality.meter import Meter, Stamp, unpack
from mesh.quality.probe import LANES, WORDS
from tests.mesh.quality.conftest import Routers
from tests.waiting import until
from zmav import keys

ONE_WAY_S, LOSS = 0.1, 0.2
AGAIN_S = 2 * ONE_WAY_S * 9 / 8 + 0.1
"""until QUIC takes a datagram for lost and sends it again: 9/8 round trips (RFC 9002, 6.1.2), and a word's time until
something later is acknowledged"""


def arrivals(hours: float, lease: float, streams: int, rng: random.Random) -> list[float]:
    """When words come out of the streams, in s: in order within each stream, however long one of it is repeated."""
    every, came = lease / WORDS, []
    free = [0.0] * streams
    for number in range(int(hours * 3600 / every)):
        there = number * every + ONE_WAY_S
        while rng.random() < LOSS:
            there += AGAIN_S
        stream = number % streams
        free[stream] = max(free[stream], there)
        came.append(free[stream])
    return sorted(came)


def single(hours: float, lease: float, rng: random.Random) -> list[float]:
    """When one of Zenoh's own words comes that nobody repeats."""
    every = lease / PROFILES["mesh"].keep_alive
    return [number * every for number in range(int(hours * 3600 / every)) if rng.random() >= LOSS]


def given_up(came: list[float], lease: float) -> int:
    """Silences of a whole lease."""
    return sum(b - a > lease for a, b in itertools.pairwise(came))


@pytest.mark.parametrize("profile", ["wds", "mesh"])
def test_a_link_that_loses_a_fifth_is_given_up_less_than_once_an_hour(profile: str) -> None:
    """Both directions of both lanes, for the hours that make a rate of one an hour certain to show."""
    lease, hours, rng = PROFILES[profile].lease, 10.0, random.Random(1)  # type: ignore[index]
    lost = sum(given_up(arrivals(hours, lease, len(LANES), rng), lease) for _ in range(2))
    lost += sum(given_up(single(hours, lease, rng), lease) for _ in range(2))
    assert lost / hours < 1.0


def test_on_one_stream_the_same_words_lose_it_every_minute() -> None:
    """So it was measured: 576 an hour with Zenoh's own words, at the same loss and delay."""
    lease = PROFILES["mesh"].lease
    assert given_up(arrivals(1.0, lease, 1, random.Random(1)), lease) > 60


def test_a_link_loses_until_it_is_known_not_to() -> None:
    one, two = Meter(bytes(8), 0.0), Meter(bytes(8), 0.0)
    assert one.loses(0.0)
    for number in range(40):
        now = 0.1 * number
        one.take(unpack(two.stamp(now, 0.1)), now)
        two.take(unpack(one.stamp(now, 0.1)), now)
    assert not one.loses(4.0)
    one.take(Stamp(bytes(8), 0.1, 42, 5_000_000, loss=0.0), 5.0)  # 41 is missing
    assert one.loses(5.0)
    assert two.loses(30.0)  # it hears nothing more


async def test_words_take_every_lane_in_turn_where_a_link_loses_and_none_where_it_does_not(routers: Routers) -> None:
    relay = routers.relay(await routers.open("quad1"))
    await routers.open("quad2", relay.endpoint)
    one, two = routers.sessions["quad1"], routers.sessions["quad2"]
    lanes: Counter[str] = Counter()

    def on_sample(sample: zenoh.Sample) -> None:
        if not len(sample.payload):
            lanes[str(sample.priority)] += 1

    key = keys.PROBE.key("demo", "*", to=one.info.zid())
    one.declare_subscriber(key, handlers.Callback(on_sample, indirect=False))
    parts = [await routers.measure("quad1"), await routers.measure("quad2")]
    await until(lambda: bool(parts[1].prober.neighbours), "linked")
    near = parts[1].prober.neighbours[str(one.info.zid())]
    await until(lambda: not near.meter.loses(near.meter.heard or 0.0), "known to lose nothing")
    lanes.clear()
    await asyncio.sleep(0.5)
    assert sum(lanes.values()) <= 1  # one may have been under way
    rng = random.Random(1)
    relay.drop = [lambda data: rng.random() < 0.3] * 2
    await until(lambda: set(lanes) == set(map(str, LANES)), "a word on each lane of a link that loses")
    assert parts[0].prober.refused == parts[1].prober.refused == 0
    assert str(two.info.zid()) in parts[0].prober.neighbours
