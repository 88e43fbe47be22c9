"""The highest rate that gets through: doubled until it does not, then halved in between (as RFC 2544, section 26.1).

A rate passes where at most ``loss`` of the datagrams are lost, where they come as fast as they were sent (else they
only fill a buffer on the way), and where the fleet's realtime traffic does not suffer: small queries of that class run
beside each trial, and must be answered.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import msgspec

from mesh.bench.asker import Bench
from mesh.bench.flow import Flow, Stream
from mesh.units import duration, rate

KEEPS_UP = 0.97
"""of the rate it was sent at, at which it has to come"""
SUFFERS = 3.0
"""times the idle round trip"""
SUFFERS_FROM = 0.1
"""s by which the realtime round trip must have grown, too: less does not matter to a vehicle"""
GUARD_HZ = 10.0
TWICE = 2
"""times a rate has to fail: once may have been the weather, or a busy computer"""
CLOSE_ENOUGH = 1.1
"""the ratio of the lowest rate that failed to the highest that passed at which the search ends"""


class Limits(msgspec.Struct, kw_only=True, frozen=True):
    """Of a search. Rates are bit/s of payload."""

    start: float = 100e3
    most: float = 50e6
    loss: float = 0.01
    seconds: float = 60.0
    """for all trials together"""
    trial: float = 3.0
    """s of one"""


class Trial(msgspec.Struct, kw_only=True):
    """One rate that was tried."""

    bits: float
    passed: bool
    why: str
    """it failed, in words"""
    bandwidth: float
    loss: float
    rtt: float | None
    """s, median, of realtime queries beside it"""


class Found(msgspec.Struct, kw_only=True):
    """What a search came to."""

    best: float
    """bit/s of payload; 0: none passed"""
    trials: list[Trial]
    ended: str
    """why there was no further trial, in words"""


async def search(
    bench: Bench,
    a: str,
    b: str,
    stream: Stream,
    limits: Limits,
    *,
    until: asyncio.Event | None = None,
    on_trial: Callable[[Trial], None] | None = None,
) -> Found:
    """Raise the rate from ``a`` to ``b`` until it does not pass. ``stream`` says class and size."""
    first, _ = await bench.pair(a, b)
    most, cap = limits.most, f"the limit of {rate(limits.most)}"
    if first.budget is not None and 8.0 * first.budget < most:
        most, cap = 8.0 * first.budget, f"the budget of {first.host}'s radio"
    loop = asyncio.get_running_loop()
    end = loop.time() + limits.seconds
    trials: list[Trial] = []
    low, high, bits = 0.0, None, min(limits.start, most)
    ended = ""
    while not ended:
        for _ in range(TWICE):
            flow = await bench.stream(a, b, _at(stream, bits, limits.trial), until=until)
            trial = judge(flow, bits, limits.loss)
            trials.append(trial)
            if on_trial:
                on_trial(trial)
            if trial.passed or (until is not None and until.is_set()):
                break
        low, high = (bits, high) if trial.passed else (low, bits)
        if until is not None and until.is_set():
            ended = "asked to"
        elif low >= most:
            ended = cap
        elif high is not None and low and high / low < CLOSE_ENOUGH:
            ended = "found"
        elif high is not None and high < limits.start / 16.0:
            ended = "nothing passes"
        elif loop.time() > end:
            ended = f"its time ({limits.seconds:g} s)"
        bits = min(2.0 * bits, most) if high is None else ((low + high) / 2.0 if low else high / 2.0)
    return Found(best=low, trials=trials, ended=ended)


def _at(stream: Stream, bits: float, seconds: float) -> Stream:
    hz = bits / 8.0 / stream.size
    return msgspec.structs.replace(stream, hz=hz, seconds=max(seconds, 5.0 / hz), guard=GUARD_HZ)


def judge(flow: Flow, bits: float, most_lost: float) -> Trial:
    """Whether a rate passed."""
    idle, loaded = flow.idle, flow.loaded
    rtt = loaded.rtt.median if loaded and loaded.rtt else None
    why = ""
    if flow.faults:
        why = flow.faults[0]
    elif flow.loss > most_lost and flow.total.lost > 1:  # one of few is no share
        why = f"{100.0 * flow.loss:.1f} % lost"
    elif flow.bandwidth < KEEPS_UP * bits:
        why = f"came at {rate(flow.bandwidth)} only: a buffer fills"
    elif loaded and loaded.sent and (rtt is None or loaded.lost > 0.2 * loaded.sent):
        why = f"realtime queries unanswered beside it: {loaded.lost} of {loaded.sent}"
    elif idle and idle.rtt and rtt and rtt > max(SUFFERS * idle.rtt.median, idle.rtt.median + SUFFERS_FROM):
        why = f"realtime round trips took {duration(rtt)} instead of {duration(idle.rtt.median)}"
    return Trial(bits=bits, passed=not why, why=why, bandwidth=flow.bandwidth, loss=flow.loss, rtt=rtt)
