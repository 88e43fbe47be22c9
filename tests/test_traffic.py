"""When a position is believed, what sources know together, and who comes near whom."""

from __future__ import annotations

import math

import pytest

from zmav import geo, wire
from zmav.errors import BadInput
from zmav.traffic import (
    FORGET_S,
    GONE_S,
    MATES,
    MOST_SOURCES,
    MOST_TOLD,
    AirPicture,
    Alarm,
    Seen,
    Sighting,
    Tracks,
    approach,
    mate_address,
    read,
)

ICAO, HERE = 0x3C4B12, (50.0, 8.0)


def told(tracks: Tracks, now: float, places: tuple[tuple[float, float], ...] = ()) -> wire.Traffic:
    report = wire.Traffic(t=1000.0, source="gs", instance=1, serves="x")
    tracks.tell(report, places, 50_000.0, now)
    return report


def flies(tracks: Tracks, place: tuple[float, float], now: float, **more: object) -> None:
    tracks.hear(Sighting(ICAO, place, **more), now)  # type: ignore[arg-type]


def test_a_position_is_believed_when_a_second_one_agrees() -> None:
    tracks = Tracks()
    flies(tracks, HERE, 0.0, velocity=(60.0, 0.0, 0.0))
    assert (told(tracks, 0.0).aircraft, told(tracks, 0.0).unplaced) == ([], 1)
    flies(tracks, (50.0005, 8.0), 1.0)
    (aircraft,) = told(tracks, 2.0).aircraft
    assert (aircraft.icao, aircraft.lat_deg, aircraft.age, aircraft.positions) == ("3c4b12", 50.0005, 1.0, 2)


def test_a_jump_is_not_believed_until_it_is_confirmed() -> None:
    tracks = Tracks()
    for step in range(5):
        flies(tracks, (50.0 + 5e-4 * step, 8.0), float(step), velocity=(60.0, 0.0, 0.0))
    flies(tracks, (51.0, 8.0), 5.0)
    flies(tracks, (50.003, 8.0), 6.0)
    (aircraft,) = told(tracks, 6.0).aircraft
    assert aircraft.lat_deg == 50.003
    assert tracks.refused["jump"] == 1
    flies(tracks, (52.0, 8.0), 7.0)
    flies(tracks, (52.0005, 8.0), 8.0)
    (aircraft,) = told(tracks, 8.0).aircraft
    assert (aircraft.lat_deg, aircraft.positions) == (52.0005, 2)


@pytest.mark.parametrize(
    ("first", "second"),
    [((10.0, 179.9999), (10.0, -179.9999)), ((89.9999, 10.0), (89.9999, -170.0)), ((-90.0, 0.0), (-89.9999, 90.0))],
    ids=["date line", "north pole", "south pole"],
)
def test_poles_and_the_date_line_are_no_jumps(first: tuple[float, float], second: tuple[float, float]) -> None:
    tracks = Tracks()
    flies(tracks, first, 0.0)
    flies(tracks, second, 1.0)
    assert len(told(tracks, 1.0, (first,)).aircraft) == 1


@pytest.mark.parametrize(
    ("more", "reason"),
    [
        ({"place": (math.nan, 8.0)}, "position"),
        ({"place": (91.0, 8.0)}, "position"),
        ({"place": (50.0, 181.0)}, "position"),
        ({"place": (0.0, 0.0)}, "position"),
        ({"alt": math.inf}, "altitude"),
        ({"alt": 1e6}, "altitude"),
        ({"velocity": (math.nan, 0.0, 0.0)}, "velocity"),
        ({"velocity": (900.0, 0.0, 0.0)}, "velocity"),
    ],
)
def test_what_cannot_be_is_counted(more: dict[str, object], reason: str) -> None:
    tracks = Tracks()
    tracks.hear(Sighting(ICAO, **more), 0.0)  # type: ignore[arg-type]
    assert tracks.refused == {reason: 1}


def test_ten_thousand_aircraft_are_bounded_and_the_nearest_told_of() -> None:
    tracks = Tracks(most=1000)
    for icao in range(10_000):
        for step in range(2):
            tracks.hear(Sighting(icao, (50.0 + 1e-5 * icao, 8.0), callsign="X" * 50), float(step))
    assert (len(tracks), tracks.refused["full"]) == (1000, 18_000)
    report = told(tracks, 1.0, (HERE,))
    assert [each.icao for each in report.aircraft] == [f"{icao:06x}" for icao in range(MOST_TOLD)]
    assert report.left_out == 1000 - MOST_TOLD
    assert report.aircraft[0].callsign == "X" * 8
    assert read(wire.encode(report)) == report
    tracks.hear(Sighting(20_000, HERE), 2.0 + GONE_S)
    assert len(tracks) == 1


def test_what_was_not_heard_of_late_is_told_of_no_more() -> None:
    tracks = Tracks()
    for step in range(2):
        flies(tracks, HERE, float(step))
    assert len(told(tracks, 1.0 + FORGET_S).aircraft) == 1
    assert told(tracks, 1.1 + FORGET_S).aircraft == []


def test_ours_are_no_traffic() -> None:
    tracks = Tracks(ours=(ICAO,))
    for icao in (ICAO, MATES, MATES + 0xFFFF, mate_address("demo", "quad1", hash)):
        tracks.hear(Sighting(icao, HERE), 0.0)
    assert (len(tracks), tracks.refused) == (0, {"ours": 4})


# Several sources.


def aircraft(north: float = 0.0, **more: object) -> wire.Aircraft:
    lat = 50.0 + north / 111_229.0
    known = {"icao": "3c4b12", "lat_deg": lat, "lon_deg": 8.0, "age": 0.0, "alt": 1000.0}
    return wire.Aircraft(**{**known, **more})  # type: ignore[arg-type]


def report(*found: wire.Aircraft, **more: object) -> wire.Traffic:
    known = {"t": 1000.0, "source": "gs", "instance": 1, "serves": "sbs:a:1", "since": 900.0}
    return wire.Traffic(**{**known, **more}, aircraft=list(found))  # type: ignore[arg-type]


def test_of_processes_with_the_same_feeds_one_is_heard() -> None:
    air = AirPicture()
    assert air.hear(report(), 0.0, 1000.0)
    assert not air.hear(report(instance=2, since=950.0), 0.0, 1000.0)
    assert air.hear(report(instance=3, since=990.0, priority=1), 0.0, 1000.0)
    assert not air.hear(report(), 1.0, 1000.0)
    assert air.hear(report(t=1006.0), 6.0, 1006.0), "the one in charge is silent"
    assert air.hear(report(instance=9, serves="sbs:b:1", since=999.0), 6.0, 1004.0)
    assert len(list(air.reports(6.0))) == 2


def test_what_is_not_of_now_is_left_out() -> None:
    air = AirPicture()
    assert not air.hear(report(aircraft(), t=900.0), 0.0, 1000.0)
    assert not air.hear(report(aircraft(), t=1e10), 0.0, 1000.0)
    assert air.aircraft(0.0) == []


def test_invented_sources_fill_no_memory() -> None:
    air = AirPicture()
    heard = [air.hear(report(serves=f"s{i}"), 0.0, 1000.0) for i in range(100)]
    assert sum(heard) == MOST_SOURCES
    assert air.hear(report(serves="later", t=1100.0), 100.0, 1100.0)


def test_of_each_aircraft_the_newest_place_counts_and_goes_on() -> None:
    air = AirPicture()
    air.hear(report(aircraft(age=3.0)), 0.0, 1000.0)
    air.hear(report(aircraft(1000.0, velocity=(50.0, 0.0, -2.0), age=1.0), source="quad1", serves=""), 0.0, 1001.0)
    (seen,) = air.aircraft(2.0)
    assert (seen.source, seen.age) == ("quad1", 4.0)
    assert geo.horizontal_distance(50.0, 8.0, seen.lat_deg, seen.lon_deg) == pytest.approx(1200.0, abs=2.0)
    assert seen.amsl == 1008.0
    assert air.aircraft(30.0) == []


@pytest.mark.parametrize(
    ("alt_from", "qnh", "amsl", "error"),
    [("pressure", None, 1000.0, 250.0), ("pressure", 1023.25, 1082.7, 60.0), ("geometric", 1023.25, 1000.0, 60.0)],
)
def test_heights(alt_from: str, qnh: float | None, amsl: float, error: float) -> None:
    air = AirPicture()
    air.hear(report(aircraft(alt_from=alt_from), qnh=qnh), 0.0, 1000.0)
    (seen,) = air.aircraft(0.0)
    assert seen.amsl == pytest.approx(amsl, abs=0.2)
    assert seen.height_error == error


@pytest.mark.parametrize(
    "wrong",
    [
        b"[" * 4000,
        b"x" * 9000,
        wire.encode(report(aircraft(lat_deg=91.0))),
        wire.encode(report(aircraft(age=-1.0))),
        wire.encode(report(aircraft(velocity=(500.0, 0.0, 0.0)))),
        wire.encode(report(aircraft(alt=1e9))),
        wire.encode(report(qnh=10.0)),
        wire.encode(report(t=-5.0)),
        wire.encode(report(*[aircraft()] * 33)),
    ],
)
def test_what_is_no_report_is_refused(wrong: bytes) -> None:
    with pytest.raises(BadInput):
        read(wrong)


# Near.


def seen(north: float, east: float, up: float | None, velocity: wire.Vector | None) -> Seen:
    origin = wire.Origin(lat_deg=50.0, lon_deg=8.0, alt_amsl=100.0)
    lat, lon, _ = geo.to_global(origin, (north, east, 0.0))
    known = wire.Aircraft(icao="3c4b12", lat_deg=lat, lon_deg=lon, age=0.0, velocity=velocity)
    return Seen(known, "gs", 0.0, lat, lon, None if up is None else 100.0 + up, 20.0)


PLACE = wire.GlobalPosition(lat_deg=50.0, lon_deg=8.0, alt_amsl=100.0, alt_rel=50.0)


def test_the_closest_approach() -> None:
    found = approach(seen(1000.0, 300.0, 40.0, (-50.0, 0.0, 0.0)), PLACE, None)
    assert found == pytest.approx((math.hypot(1000.0, 300.0), 40.0, 300.0, 20.0), abs=0.01)
    together = approach(seen(1000.0, 0.0, None, (10.0, 0.0, 0.0)), PLACE, (10.0, 0.0, 0.0))
    assert (together.time, together.height) == (0.0, None)
    assert together.nearest == pytest.approx(1000.0)
    assert approach(seen(1000.0, 0.0, 0.0, (10.0, 0.0, 0.0)), PLACE, None).time == 0.0


@pytest.mark.parametrize(
    ("other", "before", "word"),
    [
        (seen(400.0, 0.0, 0.0, (50.0, 0.0, 0.0)), False, "close"),
        (seen(600.0, 0.0, 0.0, (50.0, 0.0, 0.0)), False, ""),
        (seen(600.0, 0.0, 0.0, (50.0, 0.0, 0.0)), True, "close"),
        (seen(800.0, 0.0, 0.0, (50.0, 0.0, 0.0)), True, ""),
        (seen(2000.0, 0.0, 0.0, (-50.0, 0.0, 0.0)), False, "coming"),
        (seen(4000.0, 0.0, 0.0, (-50.0, 0.0, 0.0)), False, ""),
        (seen(4000.0, 0.0, 0.0, (-50.0, 0.0, 0.0)), True, "coming"),
        (seen(400.0, 0.0, 175.0, None), False, ""),
        (seen(400.0, 0.0, 165.0, None), False, "close"),
        (seen(400.0, 0.0, None, None), False, "close"),
    ],
)
def test_who_is_warned_of(other: Seen, before: bool, word: str) -> None:
    assert Alarm().of(other, approach(other, PLACE, None), before) == word
