"""What was measured, as lines for a person: iperf's table, a histogram, outages."""

from __future__ import annotations

import csv
import statistics
from pathlib import Path
from typing import Any

import msgspec

from mesh.bench.flow import Flow, StreamResult
from mesh.bench.statistics import bin_start
from mesh.bench.units import duration, rate, size
from zmav.wire.bench import BenchInterval, BenchOutage, BenchReport, BenchTrip, Spread

BAR = 40
HEAD = (
    f"{'interval':>14} {'transfer':>11} {'bandwidth':>14} {'jitter':>10} {'lost/total':>16} {'':>8} "
    f"{'order':>6} {'twice':>6} {'delay':>10}"
)


def interval_line(flow: Flow, interval: BenchInterval, label: str = "") -> str:
    """One line of the table; ``order`` counts datagrams out of order, ``twice`` repeated ones."""
    span = max(interval.end - interval.start, 1e-9)
    share = interval.lost / interval.expected if interval.expected else 0.0
    delay = flow.delay(interval.transit)
    return (
        f"{f'{interval.start:.1f}-{interval.end:.1f} s':>14} {size(interval.bytes):>11} "
        f"{rate(8.0 * interval.bytes / span):>14} {duration(interval.jitter):>10} "
        f"{f'{interval.lost}/{interval.expected}':>16} {f'({100.0 * share:.2g} %)':>8} "
        f"{interval.out_of_order:>6} {interval.duplicates:>6} {duration(delay[0]) if delay else '-':>10}{label}"
    )


def ways(flow: Flow) -> str:
    return f"  {flow.source} > {flow.target}"


def summary(result: StreamResult) -> list[str]:
    """The totals of a stream, with what they are worth."""
    lines: list[str] = []
    for flow in result.flows:
        label = ways(flow) if len(result.flows) > 1 else ""
        lines.append(interval_line(flow, flow.total, label))
        sent, late = flow.sender, flow.sender.lateness
        asked = result.stream.bits
        offered = 8.0 * sent.sent * result.stream.size / sent.send_seconds if sent.send_seconds else 0.0
        own = f", each {duration(late.median)} (p99 {duration(late.p99)}) after its time" if late else ""
        lines.append(f"{flow.source} sent {sent.sent} datagrams at {rate(offered)} of {rate(asked)} asked{own}")
        if delay := flow.delay(flow.total.transit):
            assert flow.clock is not None
            clock = flow.clock
            lines.append(
                f"one way {flow.source} > {flow.target}: median {duration(delay[0])}, p99 {duration(delay[1])}, "
                f"± {duration(clock.within)} (clocks compared by ping-pong; those of the day differ by "
                f"{duration(clock.utc_offset)})"
            )
        if flow.receiver.foreign:
            lines.append(f"{flow.target} left out {flow.receiver.foreign} datagrams that were none of this run's")
    for trip, when in ((result.idle, "before"), (result.loaded, "beside the stream")):
        if trip is not None and trip.sent:
            lines.append(f"realtime round trip {when}: {trip_words(trip)}")
    lines.extend(f"! {fault}" for fault in result.faults)
    return lines


def trip_words(trip: BenchTrip) -> str:
    found = trip.rtt
    times = (
        f"min {duration(found.min)}, median {duration(found.median)}, p95 {duration(found.p95)}, "
        f"p99 {duration(found.p99)}, max {duration(found.max)}"
        if found
        else "no answer"
    )
    return f"{times}; {trip.lost} of {trip.sent} without an answer" + (f", {trip.late} late" if trip.late else "")


def histogram(spread: Spread) -> list[str]:
    """A bar a bin, ten bins a decade."""
    if not spread.bins:
        return []
    counts = dict(spread.bins)
    most, lines = max(counts.values()), []
    for k in range(min(counts), max(counts) + 1):
        count = counts.get(k, 0)
        bar = "█" * round(BAR * count / most) or ("▏" if count else "")
        lines.append(f"{duration(bin_start(k)):>10} - {duration(bin_start(k + 1)):<10} {count:>8} {bar}")
    return lines


def trips_table(report: BenchReport) -> list[str]:
    """One line for each host that was asked."""
    head = f"{'host':<16} {'min':>10} {'median':>10} {'p95':>10} {'p99':>10} {'max':>10} {'lost':>12}"
    lines = [head]
    for trip in report.trips:
        found = trip.rtt
        times = (found.min, found.median, found.p95, found.p99, found.max) if found else ()
        cells = " ".join(f"{duration(value):>10}" for value in times) or " ".join(f"{'-':>10}" for _ in range(5))
        lines.append(f"{trip.peer:<16} {cells} {f'{trip.lost}/{trip.sent}':>12}")
    return lines


def outage_line(number: int, outage: BenchOutage) -> str:
    return f"outage {number}: at {outage.start:.2f} s for {duration(outage.length)}, {outage.lost} datagrams"


def outages_summary(result: StreamResult) -> list[str]:
    """How long the ways were cut: the median and the worst."""
    lines = []
    for flow in result.flows:
        lengths = [outage.length for outage in flow.outages]
        if not lengths:
            lines.append(f"{flow.source} > {flow.target}: no outage longer than {duration(result.stream.silence)}")
            continue
        lines.append(
            f"{flow.source} > {flow.target}: {len(lengths)} outages longer than {duration(result.stream.silence)}: "
            f"median {duration(statistics.median(lengths))}, worst {duration(max(lengths))}"
        )
    return lines


def as_json(result: StreamResult) -> dict[str, Any]:
    """All of it, plain."""
    found: dict[str, Any] = msgspec.to_builtins(result)
    for flow, table in zip(result.flows, found["flows"], strict=True):
        table["total"] = msgspec.to_builtins(flow.total)
        table["bandwidth_bits"], table["loss"] = flow.bandwidth, flow.loss
        delay = flow.delay(flow.total.transit)
        table["delay"] = {"median": delay[0], "p99": delay[1]} if delay else None
        for side in ("sender", "receiver"):
            table[side]["intervals"], table[side]["outages"] = [], []  # they stand in the flow
    return found


def write_csv(path: Path, result: StreamResult) -> None:
    """A row for each second of each way. Raises OSError."""
    with path.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        rows.writerow(
            (
                "source",
                "target",
                "start_s",
                "end_s",
                "bytes",
                "bits_per_s",
                "jitter_s",
                "lost",
                "expected",
                "out_of_order",
                "duplicates",
                "delay_median_s",
                "clock_within_s",
            )
        )
        for flow in result.flows:
            for each in flow.intervals:
                delay = flow.delay(each.transit)
                rows.writerow(
                    (
                        flow.source,
                        flow.target,
                        each.start,
                        each.end,
                        each.bytes,
                        8.0 * each.bytes / (each.end - each.start),
                        each.jitter,
                        each.lost,
                        each.expected,
                        each.out_of_order,
                        each.duplicates,
                        delay[0] if delay else "",
                        flow.clock.within if flow.clock else "",
                    )
                )
