"""``zmav mesh bench``: bandwidth, jitter, loss, round trips and outages between two hosts."""

from __future__ import annotations

import asyncio
import statistics
from typing import Any

import click
import msgspec

from mesh.bench.asker import Bench
from mesh.bench.flow import Flow, Stream
from mesh.units import duration, rate, size
from zmav import keys
from zmav.cli.common import Between, Work, connected, dump, json_option
from zmav.client import Client
from zmav.config.mesh import bits_per_second
from zmav.errors import BadInput
from zmav.process import until_stopped
from zmav.waiting import alongside
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


RATE = 1e6
"""bit/s, as iperf's"""
USUAL = {
    "stream": Stream(seconds=20.0, hz=RATE / 8.0 / 1000.0, size=1000, qos="latest-wins"),
    "rtt": Stream(seconds=10.0, hz=50.0, size=64, qos="realtime"),
    # It goes on unasked for a minute: the cut may part us from the hosts.
    "recover": Stream(seconds=3600.0, hz=50.0, size=100, qos="realtime", guard=0.0, patience=60.0),
}


@click.command("bench")
@click.argument("a")
@click.argument("b")
@click.option("--seconds", type=Between(0.1, 3600.0), help="How long.  [default: 20; --rtt 10]")
@click.option(
    "--class",
    "qos",
    type=click.Choice([each.value for each in keys.Qos]),
    help="Class of service.  [default: latest-wins; --rtt and --recover realtime]",
)
@click.option("--rate", help="Payload offered: 1Mbit/s, 60kB/s.  [default: 1Mbit/s]")
@click.option("--hz", type=Between(0.01), help="Datagrams a second, instead of --rate.")
@click.option("--size", type=click.IntRange(20, 65_000), help="Bytes of payload.  [default: 1000; --rtt 64]")
@click.option("--rtt", "kind", flag_value="rtt", help="Round trips by query.")
@click.option("--recover", "kind", flag_value="recover", help="Watch for outages, until Ctrl-C.")
@json_option
@connected
def command(a: str, b: str, kind: str | None, as_json: bool, **given: Any) -> Work:
    """Measure between two hosts: 'zmav mesh bench quad1 ground', 'zmav mesh bench here quad3 --rtt'.

    A sends to B, over the routers that run and in the class of service asked for; 'here' is our own host's router.
    Rates and transfers are of payload.
    """
    kind = kind or "stream"
    stream = wanted(kind, **given)
    return lambda z: measure(z, a, b, kind, stream, as_json)


async def measure(z: Client, a: str, b: str, kind: str, stream: Stream, as_json: bool = False) -> None:
    bench, until = Bench(z), asyncio.Event()  # set by the first Ctrl-C: hosts are told, and what they saw is shown
    async with alongside(until_stopped()) as (stopped,):
        stopped.add_done_callback(lambda _: until.set())
        first, second = (pong.host for pong in await bench.pair(a, b))
        if kind == "rtt":
            await _rtt(bench, first, second, stream, until, as_json)
        else:
            await _stream(bench, first, second, stream, until, as_json, recover=kind == "recover")


def wanted(
    kind: str,
    seconds: float | None = None,
    qos: str | None = None,
    rate: str | None = None,
    hz: float | None = None,
    size: int | None = None,
) -> Stream:
    """What was asked for, and what is usual where nothing was said; raises :class:`BadInput`."""
    if rate and hz:
        raise BadInput("--rate or --hz, not both", field="rate", value=rate, expected="one of them")
    usual = USUAL[kind]
    size = size or usual.size
    if rate or (kind == "stream" and not hz):
        hz = (bits_per_second(rate) if rate else RATE) / 8.0 / size
    return msgspec.structs.replace(
        usual, seconds=seconds or usual.seconds, hz=hz or usual.hz, size=size, qos=qos or usual.qos
    )


async def _stream(
    bench: Bench, a: str, b: str, stream: Stream, until: asyncio.Event, as_json: bool, *, recover: bool
) -> None:
    seen = 0

    def on_interval(flow: Flow, interval: BenchInterval) -> None:
        if as_json:
            click.echo(dump({"interval": msgspec.to_builtins(interval)}))
        elif not recover:
            click.echo(interval_line(flow, interval))

    def on_outage(flow: Flow, outage: BenchOutage) -> None:
        nonlocal seen
        seen += 1
        if recover and not as_json:
            click.echo(outage_line(seen, outage))

    if not as_json:
        what = f"{stream.qos}, {stream.size} B, {stream.hz:g} Hz, {rate(stream.bits)} of payload"
        click.echo(f"{a} > {b}: {what}, {stream.seconds:g} s")
        click.echo(f"waiting for silences of {duration(stream.silence)} and more" if recover else HEAD)
    flow = await bench.stream(a, b, stream, until=until, on_interval=on_interval, on_outage=on_outage)
    lines = [*([outages_summary(flow)] if recover else ()), *summary(flow)]
    click.echo(dump(document(flow)) if as_json else "\n".join(lines))


async def _rtt(bench: Bench, a: str, b: str, stream: Stream, until: asyncio.Event, as_json: bool) -> None:
    trip = await bench.round_trips(a, b, stream, until=until)
    head = f"{a} > {b}: {stream.qos}, {stream.size} B, {stream.hz:g} Hz"
    click.echo(dump(msgspec.to_builtins(trip)) if as_json else "\n".join([head, *trip_lines(trip)]))
