"""Corrections that stations inject: once for the fleet, whichever message they use, and one station at a time."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from tests.rtcm import base_at, message
from zmav import keys
from zmav.corrections import Batch, unpack
from zmav.mavlink.rtcm import cut, fields

if TYPE_CHECKING:
    from tests.conftest import Samples
    from tests.ground.gcs.conftest import Scene, Station

EPOCH = base_at() + message(1077, size=500) + message(1087, size=177)


def rtcm(scene: Scene) -> Samples:
    return scene.net.ground(scene.router_endpoint).samples(keys.RTCM)


def batches(samples: Samples) -> list[Batch]:
    return [unpack(payload) for _, payload in samples.items]


def data(samples: Samples) -> bytes:
    return b"".join(each.data for batch in batches(samples) for each in batch.messages)


def inject(station: Station, what: bytes, sequence: int = 0) -> None:
    for flags, piece in cut(what, sequence):
        station.send("GPS_RTCM_DATA", **fields(flags, piece))


async def takes_charge(station: Station, heard: Samples) -> None:
    """It sends some until they come through: at first it is listened for others. What came so far is forgotten."""
    while not heard.items:
        inject(station, base_at())
        await asyncio.sleep(0.1)
    await asyncio.sleep(0.3)
    heard.items.clear()


async def test_a_station_becomes_a_source_and_no_vehicle_gets_a_frame(scene: Scene) -> None:
    quads = [scene.craft(f"quad{number}", number) for number in (1, 2, 3)]
    bridge = await scene.bridge()
    heard = rtcm(scene)
    station = await scene.tcp(bridge)
    await takes_charge(station, heard)
    for sequence in range(3):
        inject(station, EPOCH, sequence)
        await heard.until(lambda n=sequence: data(heard) == EPOCH * (n + 1), "the station's corrections")  # type: ignore[misc]
    assert {batch.source for batch in batches(heard)} == {"gcs/255"}
    station.send("COMMAND_LONG", target_system=1, target_component=1, command=400)
    await quads[0].hears(lambda key, _: "COMMAND_LONG" in key, "the command behind them")
    assert not [key for quad in quads for key, _ in quad.told if "GPS_" in key]
    await station.until(lambda: "in charge: corrections go to the fleet" in station.texts(), "word of it")


async def test_the_older_message_is_taken_too(scene: Scene) -> None:
    quad = scene.craft("quad1", 1)
    bridge = await scene.bridge()
    heard = rtcm(scene)
    station = await scene.tcp(bridge)
    await takes_charge(station, heard)
    for at in range(0, len(EPOCH), 110):
        piece = EPOCH[at : at + 110]
        to = {"target_system": 1, "target_component": 1}
        station.send("GPS_INJECT_DATA", **to, len=len(piece), data=piece.ljust(110, b"\0"))
    await heard.until(lambda: data(heard) == EPOCH, "the station's corrections")
    assert not [key for key, _ in quad.told if "GPS_" in key]


async def test_of_two_stations_the_second_stands_by(scene: Scene) -> None:
    scene.craft("quad1", 1)
    bridge = await scene.bridge()
    heard = rtcm(scene)
    first, second = await scene.tcp(bridge, 255), await scene.tcp(bridge, 254)
    await takes_charge(first, heard)
    for sequence in range(4):
        inject(second, EPOCH, sequence)
        await asyncio.sleep(0.1)
        inject(first, EPOCH, sequence + 1)
        await asyncio.sleep(0.1)
    await heard.until(lambda: len(heard.items) >= 4, "the rest of the first's")
    assert {batch.source for batch in batches(heard)} == {"gcs/255"}
    await second.until(lambda: "stands by: gcs/255 is in charge" in second.texts(), "word of it")


async def test_who_may_not_command_corrects_nobody(scene: Scene) -> None:
    quad = scene.craft("quad1", 1)
    bridge = await scene.bridge("read_only=1")
    heard = rtcm(scene)
    station = await scene.tcp(bridge)
    inject(station, EPOCH)
    await station.until(lambda: "read-only" in station.texts(), "a refusal")
    assert not heard.items
    assert not quad.told


async def test_a_station_that_floods_costs_the_fleet_little(scene: Scene) -> None:
    scene.craft("quad1", 1)
    bridge = await scene.bridge()
    heard = rtcm(scene)
    station = await scene.tcp(bridge)
    for sequence in range(300):
        inject(station, message(1077, size=700, seed=sequence), sequence % 32)
    station.send("GPS_RTCM_DATA", flags=255, len=255, data=bytes(180))
    await asyncio.sleep(2.0)
    inject(station, EPOCH)
    await heard.until(lambda: bool(heard.items), "some of them")
    assert 0 < len(data(heard)) < 20_000
    station.beat()
    assert bridge.uplink.refused["error"] == 0
