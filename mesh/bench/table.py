"""What was measured, as lines for a person: iperf's table, round trips, outages; and as a document."""

from __future__ import annotations

import statistics
from typing import Any

import msgspec

from mesh.bench.flow import Flow
from mesh.units import duration, rate, size
from zmav.wire.bench import BenchInterval, BenchOutage, BenchTrip

HEAD = f"{'interval':>14} {'transfer':>11} {'bandwidth':>14} {'jitter':>10} {'lost/total':>16} {'':>8} {'delay':>10}"


def interval_line(flow: Flow, interval: BenchInterval) -> str:
    """One line of the table."""
    span = max(interval.end - interval.start, 1e-9)
    share = interval.lost / interval.expected if interval.expected else 0.0
    delay = flow.delay(interval.transit)
    return (
        f"{f'{interval.start:.1f}-{interval.end:.1f} s':>14} {size(interval.bytes):>11} "
        f"{rate(8.0 * interval.bytes / span):>14} {duration(interval.jitter):>10} "
        f"{f'{interval.lost}/{interval.expected}':>16} {f'({100.0 * share:.2g} %)':>8} "
        f"{duration(delay[0] if delay else None):>10}"
    )


def summary(flow: Flow) -> list[str]:
    """The totals of a stream, with what they are worth."""
    sent, late, total = flow.sender, flow.sender.lateness, flow.total
    offered = 8.0 * sent.sent * flow.stream.size / sent.send_seconds if sent.send_seconds else 0.0
    own = f", each {duration(late.median)} (p99 {duration(late.p99)}) after its time" if late else ""
    lines = [
        interval_line(flow, total),
        f"{flow.source} sent {sent.sent} datagrams at {rate(offered)} of {rate(flow.stream.bits)} asked{own}",
    ]
    if delay := flow.delay(total.transit):
        assert flow.clock is not None
        lines.append(
            f"one way {flow.source} > {flow.target}: median {duration(delay[0])}, p99 {duration(delay[1])}, "
            f"± {duration(flow.clock.within)} (clocks compared by ping-pong; those of the day differ by "
            f"{duration(flow.clock.utc_offset)})"
        )
    for trip, when in ((flow.idle, "before"), (flow.loaded, "beside the stream")):
        if trip is not None and trip.sent:
            found = trip.rtt
            times = f"median {duration(found.median)}, p99 {duration(found.p99)}" if found else "no answer"
            lines.append(f"realtime round trip {when}: {times}; {trip.lost} of {trip.sent} without an answer")
    return [*lines, *(f"! {fault}" for fault in flow.faults)]


def trip_lines(trip: BenchTrip) -> list[str]:
    """Of the host that was asked: a head and a line."""
    found = trip.rtt
    times = (found.min, found.median, found.p95, found.p99, found.max) if found else (None,) * 5
    cells = " ".join(f"{duration(value):>10}" for value in times)
    head = f"{'host':<16} {'min':>10} {'median':>10} {'p95':>10} {'p99':>10} {'max':>10} {'lost':>12}"
    return [head, f"{trip.peer:<16} {cells} {f'{trip.lost}/{trip.sent}':>12}"]


def outage_line(number: int, outage: BenchOutage) -> str:
    return f"outage {number}: at {outage.start:.2f} s for {duration(outage.length)}, {outage.lost} datagrams"


def outages_summary(flow: Flow) -> str:
    """How long the way was cut: the median and the worst."""
    lengths, longer = [outage.length for outage in flow.outages], f"longer than {duration(flow.stream.silence)}"
    if not lengths:
        return f"no outage {longer}"
    return (
        f"{len(lengths)} outages {longer}: median {duration(statistics.median(lengths))}, "
        f"worst {duration(max(lengths))}"
    )


def document(flow: Flow) -> dict[str, Any]:
    """All of it, plain."""
    found: dict[str, Any] = msgspec.to_builtins(flow)
    delay = flow.delay(flow.total.transit)
    found["total"] = msgspec.to_builtins(flow.total)
    found["bandwidth_bits"], found["loss"] = flow.bandwidth, flow.loss
    found["delay"] = {"median": delay[0], "p99": delay[1]} if delay else None
    for side in ("sender", "receiver"):
        found[side]["intervals"], found[side]["outages"] = [], []  # they stand in the flow
    return found
