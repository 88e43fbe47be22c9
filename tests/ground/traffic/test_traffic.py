"""Feeds by real sockets, reports by real sessions: several at once, that stop, jump, lie and come again."""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections.abc import AsyncIterator
from typing import TYPE_CHECKING, Any

import pytest
from click.testing import CliRunner

from ground.air import Listener
from ground.traffic.cli import command
from ground.traffic.feeds import BeastReader, Feed, SbsReader, parse_feed
from ground.traffic.program import SILENT_S
from tests.ground.traffic.conftest import ORIGIN
from tests.sbs import MadeUp, SbsSource, line
from tests.waiting import until
from zmav import geo, keys, wire
from zmav.errors import BadConfig, BadInput, BadUrl
from zmav.traffic import CURRENT_S, FORGET_S, MOST_TOLD, MOST_TRACKS, Tracks

if TYPE_CHECKING:
    from tests.conftest import Net
    from tests.ground.traffic.conftest import Sky

NEAR = MadeUp(0x3C4B12, "DEABC", (2000.0, 0.0, -300.0), (0.0, 60.0, -2.0))
OTHER = MadeUp(0x4B1900, "HBXYZ", (-4000.0, 500.0, -900.0), (40.0, 0.0, 0.0))
# Airborne positions, even and odd, a velocity and an identification of real aircraft (1090MHz Riddle, Junzi Sun).
EVEN, ODD = "8D40621D58C382D690C8AC2863A7", "8D40621D58C386435CC412692AD6"
SPEED, NAME = "8D485020994409940838175B284F", "8D4840D6202CC371C32CE0576098"


def feed_of(source: SbsSource) -> Feed:
    return Feed("sbs", "127.0.0.1", source.port)


def framed(message: str, kind: bytes = b"3") -> bytes:
    """As Beast has it: a clock and a level before it, and every 1a twice."""
    body = bytes.fromhex("001a22334455" + "7f" + message)
    return b"\x1a" + kind + body.replace(b"\x1a", b"\x1a\x1a")


async def test_several_feeds_are_one_picture(sky: Sky) -> None:
    async with (
        SbsSource(ORIGIN, [NEAR]) as one,
        SbsSource(ORIGIN, [OTHER, NEAR]) as two,
        sky.program(feed_of(one), feed_of(two), qnh=1013.25) as program,
    ):
        await until(lambda: len(sky.last) == 2, "both aircraft")
        assert list(sky.last) == ["DEABC", "HBXYZ"], "the nearest first"
        found = sky.last["DEABC"]
        assert found.velocity == pytest.approx((0.0, 60.0, -2.0), abs=0.1)
        assert found.alt == pytest.approx(ORIGIN.alt_amsl + 300.0, abs=60.0)
        assert (found.alt_from, found.icao) == ("pressure", "3c4b12")
        north, _, _ = geo.to_ned(ORIGIN, found.lat_deg, found.lon_deg, 0.0)
        assert north == pytest.approx(2000.0, abs=3.0)
        state, text, detail = program.status()
        assert state == "in-charge"
        assert "2 aircraft told of, 0 of 2 without position" in text
        assert [feed["state"] for feed in detail["feeds"]] == ["up", "up"]
        await until(lambda: program.listener.rows(), "its own list")


async def test_a_feed_that_is_lost_is_connected_to_again(sky: Sky) -> None:
    async with SbsSource(ORIGIN, [NEAR]) as source, sky.program(feed_of(source)) as program:
        await until(lambda: sky.last, "an aircraft")
        source.drop()
        await until(lambda: any("lost: it closed the connection" in said for said in sky.said), "a word on it")
        await until(lambda: program.sources[0].state == "up", "the feed again")


async def test_where_nobody_serves_it_says_so(sky: Sky) -> None:
    async with sky.program(Feed("sbs", "127.0.0.1", 1)) as program:
        await until(lambda: program.sources[0].state == "lost", "a word")
        state, text, _ = program.status()
    assert state == "lost"
    assert "127.0.0.1" in text
    assert sky.reports == []


async def test_a_feed_that_stops_is_silent_and_its_aircraft_are_forgotten(sky: Sky) -> None:
    async with SbsSource(ORIGIN, [NEAR]) as source, sky.program(feed_of(source)) as program:
        await until(lambda: sky.last, "an aircraft")
        source.fault = "stops"
        sky.ahead += SILENT_S
        await until(lambda: program.status()[0] == "silent", "a word on it")
        sky.ahead += FORGET_S - SILENT_S
        await until(lambda: not sky.reports[-1].aircraft, "an empty report")


async def test_a_feed_that_jumps_is_not_followed(sky: Sky) -> None:
    async with SbsSource(ORIGIN, [NEAR], fault="jumps") as source, sky.program(feed_of(source)) as program:
        await until(lambda: program.tracks.refused["jump"] >= 3, "jumps")
        places = [each.lat_deg for report in sky.reports for each in report.aircraft]
    assert places
    assert max(places) - min(places) < 0.01


async def test_a_feed_that_lies_is_bounded_and_one_of_garbage_counted(sky: Sky) -> None:
    async with SbsSource(ORIGIN, [NEAR], fault="lies") as source, sky.program(feed_of(source)) as program:
        await until(lambda: program.tracks.refused["full"] > 100, "too many")
        assert len(program.tracks) == MOST_TRACKS
        await until(lambda: "DEABC" in sky.last, "the one that is there")
        assert len(sky.reports[-1].aircraft) <= MOST_TOLD
        source.fault = "garbage"
        await until(lambda: program.sources[0].skipped > 3, "lines that are none")
        assert program.tracks.refused["position"] == 0, "what is no number is not there"


async def test_of_two_with_the_same_feed_one_stands_by_and_takes_over(sky: Sky) -> None:
    async with SbsSource(ORIGIN, [NEAR]) as source, contextlib.AsyncExitStack() as stack:
        first = await stack.enter_async_context(sky.program(Feed("sbs", "localhost", source.port)))
        await until(lambda: sky.last, "the first one's report")
        async with sky.program(feed_of(source)) as second:
            await until(lambda: second.stands_by_for == "gs", "a standby")
            assert second.status()[0] == "standby"
            assert first.status()[0] == "in-charge"
            assert {report.instance for report in sky.reports} == {sky.reports[0].instance}
            await stack.aclose()
            sky.ahead += CURRENT_S
            await until(lambda: len({report.instance for report in sky.reports}) == 2, "the second one's report")
            assert second.status()[0] == "in-charge"


async def test_other_feeds_are_told_of_beside_it(sky: Sky) -> None:
    async with (
        SbsSource(ORIGIN, [NEAR]) as one,
        SbsSource(ORIGIN, [OTHER]) as two,
        sky.program(feed_of(one), name="a"),
        sky.program(feed_of(two), name="b"),
    ):
        await until(lambda: {report.source for report in sky.reports} == {"a", "b"}, "both")


async def test_what_is_far_from_everybody_is_left_out(sky: Sky) -> None:
    far = MadeUp(7, "FAR", (90_000.0, 0.0, -300.0), (0.0, 0.0, 0.0))
    async with SbsSource(ORIGIN, [NEAR, far]) as source, sky.program(feed_of(source)):
        await until(lambda: sky.last and sky.reports[-1].left_out == 1, "a report")
        assert list(sky.last) == ["DEABC"]


# Beast.


@contextlib.asynccontextmanager
async def served(first: bytes, data: bytes) -> AsyncIterator[int]:
    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError, asyncio.CancelledError):
            writer.write(first)
            while True:
                writer.write(data)
                await writer.drain()
                await asyncio.sleep(0.2)

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    try:
        yield server.sockets[0].getsockname()[1]
    finally:
        server.close()


async def test_a_beast_feed(sky: Sky) -> None:
    place = (52.2572, 3.9194)
    first = framed(EVEN) + b"\x1a\x1a3 noise" + framed("5d40621d3b1b9a", b"2") + framed("0000", b"1") + framed(ODD)
    async with served(3 * first, framed(EVEN)) as port, sky.program(Feed("beast", "127.0.0.1", port), at=place):
        await until(lambda: sky.reports and sky.reports[-1].aircraft, "an aircraft")
        (found,) = sky.reports[-1].aircraft
    assert (found.icao, found.alt_from) == ("40621d", "pressure")
    assert (found.lat_deg, found.lon_deg) == pytest.approx(place, abs=0.01)
    assert found.alt == pytest.approx(38_000 * 0.3048, abs=0.1)


def test_beast_in_pieces_of_any_size_and_with_damage() -> None:
    whole = b"".join(framed(each) for each in (EVEN, ODD, SPEED, NAME))
    for size in (1, 7, 23, 500):
        tracks, reader = Tracks(), BeastReader()
        for at in range(0, len(whole), size):
            reader.feed(whole[at : at + size], tracks, 1000.0 + at / 1e3)
        assert (len(tracks), reader.skipped) == (3, 0)
    tracks, reader = Tracks(), BeastReader()
    damaged = bytearray(whole)
    damaged[15] ^= 4
    reader.feed(bytes(damaged) + b"\x1a3" * 5000 + b"\x1a" * 5000 + whole, tracks, 0.0)
    assert (len(tracks), reader.skipped) == (3, 1)


# SBS, line by line.


@pytest.mark.parametrize(
    "bad",
    ["MSG", "MSG,3,,,", "XYZ,3" + "," * 20, "MSG,3,1,1,GGGGGG" + "," * 17, "MSG,3,1,1,3C4B1" + "," * 17, "x" * 10_000],
)
def test_lines_that_are_none_are_counted(bad: str) -> None:
    reader, tracks = SbsReader(), Tracks()
    reader.feed(f"{bad}\r\n{line(1, 50.0, 8.0, 100.0)}\n".encode(), tracks, 0.0)
    assert (reader.skipped, len(tracks)) == (1, 1)


def test_a_line_without_end_fills_no_memory() -> None:
    reader, tracks = SbsReader(), Tracks()
    for _ in range(1000):
        reader.feed(b"M" * 16_000, tracks, 0.0)
    reader.feed(f"\n{line(1, 50.0, 8.0, 100.0)}\n".encode(), tracks, 0.0)
    assert (reader.skipped, len(tracks)) == (1, 1)


def test_numbers_that_are_none_are_not_there() -> None:
    reader, tracks = SbsReader(), Tracks()
    reader.feed(b"MSG,3,1,1,3C4B12,1,,,,,,nan,inf,1e999,NaN,-inf,x,,,,,0\n", tracks, 0.0)
    assert (len(tracks), tracks.refused, reader.skipped) == (1, {}, 0)


# The command line.


@pytest.mark.parametrize(
    ("words", "error", "says"),
    [
        (["nowhere"], BadUrl, "no feed 'nowhere'"),
        (["sbs:h:0"], BadUrl, "no feed"),
        (["sbs:h:99999"], BadUrl, "no feed"),
        (["sbs:h", "--at", "1"], BadInput, "no place '1'"),
        (["sbs:h", "--at", "91,0"], BadInput, "no place"),
        (["sbs:h", "--ours", "xyz"], BadInput, "no ICAO address 'xyz'"),
    ],
)
def test_refusals(words: list[str], error: type[Exception], says: str) -> None:
    result = CliRunner().invoke(command, words)
    assert isinstance(result.exception, error)
    assert says in str(result.exception)


def test_feeds_as_they_are_written() -> None:
    assert parse_feed("sbs:pi") == Feed("sbs", "pi", 30003)
    assert parse_feed("beast://10.0.0.7:1234/") == Feed("beast", "10.0.0.7", 1234)
    assert parse_feed("sbs:[fe80::1]:1") == Feed("sbs", "fe80::1", 1)


def test_one_fleet_is_named(net: Net) -> None:
    _, endpoint = net.router()
    result = CliRunner().invoke(command, ["sbs:127.0.0.1:1", "--fleet", "*", "-e", endpoint])
    assert isinstance(result.exception, BadConfig)
    assert "one fleet" in str(result.exception)


async def test_what_is_told_is_listed(sky: Sky) -> None:
    async with SbsSource(ORIGIN, [NEAR]) as source, sky.program(feed_of(source)):
        await until(lambda: sky.last, "an aircraft")
        words = ["--for", "2.5", "-e", sky.endpoint]
        as_json = await asyncio.to_thread(CliRunner().invoke, command, [*words, "--json"])
        table = await asyncio.to_thread(CliRunner().invoke, command, words)
    (row,) = [json.loads(text) for text in as_json.stdout.splitlines()]
    assert (row["callsign"], row["source"], row["alt_from"], row["vehicle"]) == ("DEABC", "gs", "pressure", None)
    assert "DEABC" in table.stdout
    assert abs(time.time() - sky.reports[-1].t) < 60.0


async def test_a_vehicle_that_says_what_cannot_be_spoils_no_list(sky: Sky) -> None:
    here = {"lat_deg": ORIGIN.lat_deg, "lon_deg": ORIGIN.lon_deg, "alt_amsl": ORIGIN.alt_amsl, "alt_rel": 0.0}
    nowhere = [{"lat_deg": 1e308}, {"lat_deg": 1e300}, {"lon_deg": 1e300}, {"alt_amsl": -1e300}]
    places = [wire.GlobalPosition(**here | wrong) for wrong in (*nowhere, {})]
    about: dict[str, Any] = {
        "fleet": "demo",
        "instance": "1",
        "connected": True,
        "sysid": 1,
        "compid": 1,
        "velocity": (1e200, 0.0, 0.0),
    }
    async with (
        SbsSource(ORIGIN, [NEAR]) as source,
        sky.program(feed_of(source)),
        sky.client() as z,
        contextlib.AsyncExitStack() as stack,
    ):
        stack.enter_context(listener := Listener(z))
        for number, place in enumerate(places):
            state = wire.VehicleState(t=time.time(), name=f"quad{number}", position=place, **about)
            z.session.put(keys.STATE.key("demo", state.name), wire.encode(state))
        await until(lambda: len(z.fleet()) == len(places), "all vehicles")
        await until(lambda: listener.picture.aircraft(time.monotonic()), "an aircraft")
        (row,) = listener.rows()
        assert (row["vehicle"], row["distance"]) == ("quad4", pytest.approx(2000, abs=300))
