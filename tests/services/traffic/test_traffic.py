"""Aircraft that are not of the fleet, at one vehicle: told of, warned of, and mates for its autopilot."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING, Any

import pytest

from zmav import geo, keys, wire
from zmav.config import Traffic
from zmav.traffic import MATES

if TYPE_CHECKING:
    from tests.services.conftest import Bench, StartBench

HOME = (47.3977, 8.5456)
ORIGIN = wire.Origin(lat_deg=HOME[0], lon_deg=HOME[1], alt_amsl=600.0)
ALL = 1 | 2 | 4 | 8 | 16 | 32


def report(*aircraft: wire.Aircraft, t: float | None = None, **more: Any) -> wire.Traffic:
    return wire.Traffic(
        **{"t": time.time() if t is None else t, "source": "gs", "instance": 7, "serves": "sbs:gs:1", **more},
        aircraft=list(aircraft),
    )


def craft(
    north: float, east: float = 0.0, up: float = 10.0, v: wire.Vector | None = None, **more: Any
) -> wire.Aircraft:
    """So many metres from the vehicle, which is 10 m above a home at 600 m."""
    lat, lon, alt = geo.to_global(ORIGIN, (north, east, -up))
    known = {"icao": "3c4b12", "age": 0.0, "alt": alt, "alt_from": "geometric", "callsign": "DEABC", "velocity": v}
    return wire.Aircraft(lat_deg=lat, lon_deg=lon, **{**known, **more})


def put(b: Bench, *reports: wire.Traffic | bytes) -> None:
    for each in reports:
        b.ground.put(keys.TRAFFIC, each if isinstance(each, bytes) else wire.encode(each))


async def placed(bench: StartBench, **more: Any) -> Bench:
    b = await (await bench(**more)).connected()
    b.peer.send("GPS_RAW_INT", fix_type=3)
    b.peer.place = HOME
    await b.state(lambda s: bool(s.get("position")), "its position")
    return b


def heard(**more: Any) -> dict[str, Any]:
    """An ADSB_VEHICLE a kilometre north of the vehicle, 50 m above it."""
    lat, lon, _ = geo.to_global(ORIGIN, (1000.0, 0.0, 0.0))
    return {
        "ICAO_address": 0x3C4B12,
        "lat": round(lat * 1e7),
        "lon": round(lon * 1e7),
        "altitude_type": 0,
        "altitude": 660_000,
        "heading": 18000,
        "hor_velocity": 5000,
        "ver_velocity": -100,
        "callsign": b"DEABC",
        "emitter_type": 1,
        "tslc": 1,
        "flags": ALL,
        "squawk": 7700,
        **more,
    }


async def test_who_comes_near_is_warned_of_once_and_until_well_clear(bench: StartBench) -> None:
    b = await placed(bench)
    put(b, report(craft(3000.0, v=(-60.0, 0.0, 0.0))))
    event = await b.event("traffic: DEABC", kind="traffic")
    assert event["severity"] == "notice"
    assert "0 m in 50 s" in event["text"] or "0 m in 49 s" in event["text"]
    state = await b.state(lambda s: bool(s.get("traffic")), "a warning")
    assert (state["traffic"]["icao"], state["traffic"]["close"]) == ("3c4b12", False)
    put(b, report(craft(400.0, v=(-60.0, 0.0, 0.0))))
    event = await b.event("traffic: DEABC", kind="traffic", severity="warning")
    assert "m away, " in event["text"]
    # Half as far again is not clear yet; beyond that it is.
    put(b, report(craft(-600.0, v=(-0.1, 0.0, 0.0))))
    await asyncio.sleep(1.5)
    state = await b.state(lambda s: bool(s.get("traffic")), "still a warning")
    put(b, report(craft(-2000.0, v=(-60.0, 0.0, 0.0))))
    await b.event("3c4b12 is clear", kind="traffic")
    await b.state(lambda s: s.get("traffic") is None, "no warning")


@pytest.mark.parametrize(
    "far",
    [
        craft(3000.0, v=(60.0, 0.0, 0.0)),
        craft(3000.0, 2000.0, v=(-60.0, 0.0, 0.0)),
        craft(300.0, up=400.0),
        craft(300.0, ground=True),
    ],
    ids=["goes away", "passes", "above", "stands"],
)
async def test_who_does_not_come_near_is_not_warned_of(bench: StartBench, far: wire.Aircraft) -> None:
    b = await placed(bench)
    put(b, report(far))
    await asyncio.sleep(1.5)
    assert (await b.state(lambda s: True, "its state")).get("traffic") is None


async def test_one_whose_height_is_not_known_is_near_at_any(bench: StartBench) -> None:
    b = await placed(bench)
    put(b, report(craft(300.0, alt=None)))
    await b.event("height unknown", kind="traffic")


async def test_what_is_no_report_or_not_of_now_changes_nothing(bench: StartBench) -> None:
    b = await placed(bench)
    near = craft(300.0)
    many = [craft(300.0, icao=f"{i:06x}") for i in range(33)]
    put(b, b"", b"{", b"[" * 5000, bytes(20_000), b'{"t":NaN}')
    put(b, report(near, t=time.time() + 60.0), report(near, t=time.time() - 60.0), report(*many))
    put(b, report(craft(300.0, age=500.0)), report(craft(300.0, v=(1e9, 0.0, 0.0))), report(near, qnh=1.0))
    await asyncio.sleep(1.5)
    assert (await b.state(lambda s: True, "its state")).get("traffic") is None
    put(b, report(near))
    await b.event("traffic: DEABC", kind="traffic")


async def test_what_its_receiver_hears_is_told_to_the_fleet(bench: StartBench) -> None:
    b = await placed(bench)
    told = b.ground.samples(keys.TRAFFIC)
    for step in range(4):
        b.peer.send("ADSB_VEHICLE", **heard(lat=heard()["lat"] - 100 * step))
        b.peer.send("ADSB_VEHICLE", **heard(ICAO_address=MATES + 5))  # a mate that it was told of comes back
        b.peer.send("ADSB_VEHICLE", **heard(ICAO_address=7, tslc=200))
        await asyncio.sleep(0.1)
    await b.event("traffic: DEABC", kind="traffic")

    def one() -> list[wire.Traffic]:
        found = [wire.decode(payload, wire.Traffic, "traffic") for _, payload in told.items]
        return [each for each in found if each.aircraft]

    await b.peer.until(lambda: bool(one()), "a report")
    (aircraft,) = one()[0].aircraft
    assert one()[0].source == b.vehicle.settings.name
    assert (aircraft.icao, aircraft.callsign, aircraft.emergency) == ("3c4b12", "DEABC", "7700")
    assert (aircraft.alt, aircraft.alt_from) == (660.0, "pressure")
    assert aircraft.velocity == pytest.approx((-50.0, 0.0, 1.0))
    assert 1.0 <= aircraft.age < 4.0


async def mates(b: Bench) -> None:
    """Beacons of one that is near, of one that is far, and of the vehicle itself."""
    for name, north in (("quad2", 100.0), ("far", 5000.0), (b.vehicle.settings.name, 0.0)):
        beacon = wire.swarm.Beacon(t=time.time(), pos=(north, 0.0, -20.0), vel=(3.0, 4.0, 0.0), radius=0.5, ahead=[])
        b.ground.session.put(keys.BEACON.key("demo", name), wire.encode(beacon))


async def test_its_autopilot_is_told_of_mates_where_the_file_says_so(bench: StartBench) -> None:
    b = await placed(bench, settings={"origin": ORIGIN, "traffic": Traffic(mates=True)})
    await mates(b)
    await b.peer.until(lambda: bool(b.peer.heard("ADSB_VEHICLE")), "a mate")
    await asyncio.sleep(1.2)
    told = [each.fields for each in b.peer.heard("ADSB_VEHICLE")]
    assert len({each["ICAO_address"] for each in told}) == 1
    mate = told[0]
    assert MATES <= mate["ICAO_address"] < MATES + 0x10000
    assert (mate["emitter_type"], mate["hor_velocity"], mate["altitude"]) == (14, 500, 620_000)
    assert mate["heading"] == pytest.approx(5313, abs=1)
    assert mate["lat"] / 1e7 - HOME[0] == pytest.approx(100.0 / 111_190, rel=0.2)
    assert told[-1]["tslc"] >= mate["tslc"]


async def test_a_mate_that_is_silent_is_told_of_for_a_while(bench: StartBench) -> None:
    b = await placed(bench, settings={"origin": ORIGIN, "traffic": Traffic(mates=True, last=2.5)})
    await mates(b)
    await b.peer.until(lambda: any(t.fields["tslc"] >= 2 for t in b.peer.heard("ADSB_VEHICLE")), "an aged mate")
    count = 0
    while count != (count := len(b.peer.heard("ADSB_VEHICLE"))):
        await asyncio.sleep(1.5)


async def test_by_default_no_autopilot_is_told_of_mates(bench: StartBench) -> None:
    b = await placed(bench, settings={"origin": ORIGIN})
    await mates(b)
    await asyncio.sleep(1.5)
    assert not b.peer.heard("ADSB_VEHICLE")


async def test_of_several_that_are_close_the_nearest_is_told_of(bench: StartBench) -> None:
    b = await placed(bench)
    goes, comes = craft(450.0, v=(60.0, 0.0, 0.0), icao="3c0001"), craft(-200.0, v=(10.0, 0.0, 0.0), icao="3c0002")
    put(b, report(goes, comes))
    state = await b.state(lambda s: bool(s.get("traffic")), "a warning")
    assert state["traffic"]["icao"] == "3c0002"


async def test_who_is_not_heard_any_more_is_not_called_clear(bench: StartBench) -> None:
    b = await placed(bench)
    put(b, report(craft(300.0)))
    await b.event("traffic: DEABC", kind="traffic")
    put(b, report())
    await b.event("3c4b12 is not heard any more", kind="traffic")


async def test_a_mate_that_says_what_cannot_be_disturbs_nothing(bench: StartBench) -> None:
    b = await placed(bench, settings={"origin": ORIGIN, "traffic": Traffic(mates=True)})
    for name, north, speed in (("odd1", 1e308, 1e308), ("odd2", 100.0, 1e200), ("ümlaut", 50.0, 0.0)):
        beacon = wire.swarm.Beacon(t=time.time(), pos=(north, 0.0, -20.0), vel=(speed, 0.0, 0.0), radius=0.5, ahead=[])
        b.ground.session.put(f"zmav/demo/{name}/beacon", wire.encode(beacon))
    await mates(b)
    await b.peer.until(lambda: len(b.peer.heard("ADSB_VEHICLE")) > 3, "a mate")
    assert [e for e in b.events.objects() if e["kind"] == "fault"] == []
