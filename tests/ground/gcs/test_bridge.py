"""The bridge between a fleet and its stations: who gets what, who may say what, and what nobody must notice."""

from __future__ import annotations

import asyncio
import os
import socket
import time
from typing import TYPE_CHECKING

import pytest

from ground.gcs.bridge import Bridge, BridgeSettings
from ground.gcs.options import Options, parse_endpoint
from tests.ground.gcs.conftest import FLEET, PATIENCE_S, Craft, Scene, Station, command, unknown_frame
from tests.waiting import until
from zmav import keys
from zmav.errors import PortInUse
from zmav.mavlink import Packer, decode, parse_frame
from zmav.mavlink.signing import SETUP_SIGNING

if TYPE_CHECKING:
    from tests.conftest import Net

ARM, SET_INTERVAL, LAND = 400, 511, 21
ATTITUDE = 30


def acks(station: Station) -> list[tuple[int, int, int]]:
    """Who answered what how."""
    found = [(frame.sysid, decode(frame, station.dialect)) for frame in station.named("COMMAND_ACK")]
    return [(sysid, fields["command"], fields["result"]) for sysid, fields in found]


async def test_frames_pass_both_ways_untouched_and_by_target(scene: Scene) -> None:
    one, two = scene.craft("quad1", 1), scene.craft("quad2", 2)
    bridge = await scene.bridge()
    tcp, udp = await scene.tcp(bridge), await scene.udp(bridge, 254)
    for craft in (one, two):  # every vehicle hears of every station, by its own words
        beat = await craft.hears(lambda key, data: key.endswith("/0/0/HEARTBEAT") and data[5] == 255, "a heartbeat")
        assert beat == tcp.packer.pack("HEARTBEAT", type=6, autopilot=8, system_status=4)[:4] + beat[4:]
        await craft.hears(lambda key, data: key.endswith("/0/0/HEARTBEAT") and data[5] == 254, "the other's")
    sent = tcp.send("COMMAND_LONG", **command(two, ARM, param1=1.0))
    told = await two.hears(lambda key, data: "/mav/tx/2/1/COMMAND_LONG" in key, "its command")
    assert told == sent and not any("COMMAND_LONG" in key for key, _ in one.told)
    for craft in (one, two):
        for station in (tcp, udp):
            await station.gets(craft.says("ATTITUDE", roll=0.5))
    # What nobody knows passes as well, and so does what is said to nobody in particular.
    strange = unknown_frame(1, 1, one.packer.pack("HEARTBEAT")[4])
    one.puts(strange)
    await tcp.gets(strange)
    strange = unknown_frame(255, 190)
    tcp.sock.sendall(strange)
    assert await two.hears(lambda key, data: "UNKNOWN_" in key, "an unknown message") == strange
    tcp.send("SET_MAG_OFFSETS", target_component=7)
    await two.hears(lambda key, data: key.endswith("/tx/0/7/SET_MAG_OFFSETS"), "what is for one component of all")
    assert not tcp.lost() and not udp.lost()
    await scene.heard("255/190 (GCS)")
    tcp.send("COMMAND_LONG", **{**command(two, ARM), "target_system": 77})
    await scene.heard("no vehicle has system id 77; there are: 1 quad1, 2 quad2")


async def test_an_answer_goes_to_whom_it_is_for(scene: Scene) -> None:
    """... of two with one id to the one who asked; nobody hears others' frames, or counts them as lost."""
    one = scene.craft("quad1", 1)
    bridge = await scene.bridge()
    asking, namesake, other = await scene.tcp(bridge), await scene.tcp(bridge), await scene.udp(bridge, 254)
    stations = (asking, namesake, other)
    for station in stations:
        await station.gets(one.says("ATTITUDE"))
    one.puts(asking.packer.pack("HEARTBEAT"), sysid=255, compid=190)  # a vehicle's radio repeats what it hears
    asking.send("COMMAND_LONG", **command(one, ARM))
    await one.hears(lambda key, data: key.endswith("COMMAND_LONG"), "a command")
    answer = one.says("COMMAND_ACK", command=ARM, target_system=255, target_component=190)
    one.says("COMMAND_ACK", command=ARM, target_system=1, target_component=191)  # to its own companion
    to_all = one.says("COMMAND_ACK", command=ARM)
    for station in stations:
        await station.until(lambda station=station: bool(station.named("COMMAND_ACK")), "an acknowledgement")  # type: ignore[misc]
        one.says("VFR_HUD")
        await station.until(lambda station=station: bool(station.named("VFR_HUD")), "telemetry")  # type: ignore[misc]
    assert [len(station.named("COMMAND_ACK")) for station in stations] == [2, 1, 1]
    assert asking.named("COMMAND_ACK")[0].data == answer
    assert other.named("COMMAND_ACK")[0].payload == decode_payload(to_all)
    assert [station.lost() for station in stations] == [0, 0, 0]
    assert [sum(frame.sysid == 255 for frame in station.frames) for station in stations] == [0, 0, 1]


def decode_payload(data: bytes) -> bytes:
    return data[10 : 10 + data[1]]


async def test_two_autopilots_with_one_id_are_commanded_by_nobody(scene: Scene) -> None:
    one, two = scene.craft("quad1", 1, uid="aa"), scene.craft("quad2", 1, uid="bb")
    bridge = await scene.bridge()
    station = await scene.tcp(bridge)
    station.send("COMMAND_LONG", **command(one, ARM, param1=1.0))
    await station.until(lambda: "quad1 and quad2 both have system id 1" in station.texts(), "who they are")
    await scene.heard("quad1 and quad2 both have system id 1")
    two.leave()  # from now on it is one vehicle's
    await until(lambda: len(bridge.routes.systems[1]) == 1, "one of them left")
    sent = station.send("COMMAND_LONG", **command(one, ARM, param1=1.0))
    assert await one.hears(lambda key, data: "COMMAND_LONG" in key, "the command") == sent
    assert bridge.uplink.refused["clash"] == 1


async def test_of_two_that_claim_one_system_id_both_are_landed(scene: Scene) -> None:
    """Nobody can tell which of the two a station means: what makes safe reaches both, all else nobody."""
    one, two = scene.craft("one", 1, uid="aa"), scene.craft("two", 1, uid="bb")
    bridge = await scene.bridge()
    station = await scene.tcp(bridge)
    await until(lambda: len(bridge.routes.systems.get(1, ())) == 2, "both of them")
    station.send("COMMAND_LONG", **command(one, ARM, param1=1.0))
    sent = station.send("COMMAND_LONG", **command(one, LAND))
    for craft in (one, two):
        assert await craft.hears(lambda key, data: "COMMAND_LONG" in key, "the landing") == sent
        assert len([key for key, _ in craft.told if "COMMAND_LONG" in key]) == 1


async def test_two_ways_to_one_autopilot_are_one_vehicle(scene: Scene) -> None:
    """What it says comes once, by one way, and what is said to it goes by that, until the way falls silent."""
    near, far = scene.craft("near", 1, uid="aa"), scene.craft("far", 1, uid="aa")
    bridge = await scene.bridge()
    station = await scene.tcp(bridge)
    await until(lambda: len(bridge.routes.systems.get(1, ())) == 2, "both of them")

    async def speaks(craft: Craft) -> None:
        beyond = time.monotonic() + PATIENCE_S
        while bridge.routes.ways.get(1) != (FLEET, craft.name) and time.monotonic() < beyond:
            craft.says("HEARTBEAT")
            await asyncio.sleep(0.1)

    await speaks(near)
    for roll in range(5):  # by both ways, as two companions hear one autopilot
        said = near.says("ATTITUDE", roll=roll)
        far.puts(said)
        sent = station.send("COMMAND_LONG", **command(near, ARM))
        assert await near.hears(lambda key, data: data == sent, "the command") == sent  # noqa: B023
    await station.gets(said)
    assert len(station.named("ATTITUDE")) == 5
    assert not any("COMMAND_LONG" in key for key, _ in far.told)
    await speaks(far)
    sent = station.send("COMMAND_LONG", **command(far, ARM))
    assert await far.hears(lambda key, data: data == sent, "the command") == sent


async def test_what_one_way_alone_brings_and_who_sees_one_way_alone(scene: Scene) -> None:
    """A gimbal that one of two companions hears is not left out, nor is a station that is shown the other's name."""
    near, far = scene.craft("near", 1, uid="aa"), scene.craft("far", 1, uid="aa")
    bridge = await scene.bridge(udpin="vehicles=far")
    station, theirs = await scene.tcp(bridge), await scene.udp(bridge)
    await until(lambda: len(bridge.routes.systems.get(1, ())) == 2, "both of them")

    async def beat() -> None:
        while True:
            near.says("HEARTBEAT")
            await asyncio.sleep(0.1)

    beating = asyncio.create_task(beat())
    try:
        await until(lambda: bridge.routes.ways.get(1) == (FLEET, "near"), "the near way")
        gimbal = Packer(far.dialect, 1, 154).pack("HEARTBEAT")
        far.puts(gimbal, compid=154)
        await station.gets(gimbal)
        said = near.says("ATTITUDE", roll=1.0)
        far.puts(said)
        await theirs.gets(said)
        sent = theirs.send("COMMAND_LONG", **command(far, ARM))
        assert await far.hears(lambda key, data: data == sent, "the command") == sent
        assert not any("COMMAND_LONG" in key for key, _ in near.told)
        await station.gets(said)
        assert len(station.named("ATTITUDE")) == len(theirs.named("ATTITUDE")) == 1
        client = next(each for each in bridge.clients if each.options.vehicles == ("far",))
        frame = parse_frame(sent, far.dialect)
        assert [vehicle.name for _, vehicle in bridge.ground.vehicles(client, frame)] == ["far"]
    finally:
        beating.cancel()


async def test_read_only_lets_nothing_through_and_says_so_once(scene: Scene) -> None:
    one = scene.craft("quad1", 1)
    bridge = await scene.bridge(tcp="read_only=1")
    station = await scene.tcp(bridge)
    for _ in range(3):
        station.send("COMMAND_LONG", **command(one, ARM))
    station.send("COMMAND_LONG", **command(one, SET_INTERVAL, param1=30, param2=1e5))
    await station.until(lambda: len(acks(station)) == 4, "answers")
    assert acks(station) == [(1, ARM, 2)] * 3 + [(1, SET_INTERVAL, 2)]
    assert station.texts().count("read-only") == 1
    # Nor may another component be asked for its parameters, which are not answered here.
    gimbal = Packer(one.dialect, 1, 154).pack("HEARTBEAT")
    one.puts(gimbal, compid=154)
    await station.gets(gimbal)
    station.send("PARAM_REQUEST_LIST", target_system=1, target_component=154)
    station.send("COMMAND_LONG", **command(one, ARM))
    await station.until(lambda: len(acks(station)) == 5, "what comes after the list")
    # An answer to its id is for a namesake at another bridge.
    one.says("COMMAND_ACK", command=ARM, target_system=255)
    one.says("ATTITUDE")
    await station.until(lambda: bool(station.named("ATTITUDE")), "what comes after the answer")
    assert len(acks(station)) == 5 and station.lost() == 0
    assert not one.told


async def test_namesakes_that_see_different_vehicles_each_beat_for_their_own(scene: Scene) -> None:
    quad, rover = scene.craft("quad1", 1), scene.craft("rover1", 2)
    bridge = await scene.bridge(tcp="vehicles=quad*", udpin="vehicles=rover*")
    one, other = await scene.tcp(bridge), await scene.udp(bridge)
    for _ in range(3):  # at the same moment
        one.beat()
        other.beat()
    for craft in (quad, rover):
        await craft.hears(lambda key, data: key.endswith("/HEARTBEAT"), "its station's heartbeat")


async def test_a_web_page_cannot_speak_through_a_browser(scene: Scene) -> None:
    one = scene.craft("quad1", 1)
    bridge = await scene.bridge()
    (end,) = (each for each in bridge.endpoints if each.endpoint.kind == "tcp")
    station = await scene.udp(bridge)
    order = station.packer.pack("COMMAND_LONG", **command(one, ARM, param1=1.0))
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as browser:
        await asyncio.to_thread(browser.connect, end.address)  # type: ignore[attr-defined]
        browser.sendall(b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n" + order)
        await scene.heard("is gone: it is a browser")
    sent = station.send("COMMAND_LONG", **command(one, ARM))
    await one.hears(lambda key, data: data == sent, "the station's command")
    assert not any(data == order for _, data in one.told)


async def test_who_comes_after_a_silent_station_is_somebody_else(scene: Scene) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as waiting:
        waiting.bind(("127.0.0.1", 0))
        waiting.settimeout(30.0)
        one = scene.craft("quad1", 1)
        bridge = await scene.bridge(udp=waiting.getsockname()[1])
        (there,) = bridge.clients
        there.silence = 0.5
        one.says("HEARTBEAT")
        _, address = await asyncio.to_thread(waiting.recvfrom, 2048)
        for sysid in (9, 255):
            waiting.sendto(Packer(one.dialect, sysid, 190).pack("HEARTBEAT", type=6), address)
            await until(lambda sysid=sysid: there.systems == {sysid}, "it is known")  # type: ignore[misc]
            await until(lambda: not there.systems, "it is forgotten")
        nine = scene.craft("nine", 9)  # had it been remembered, no frame of a vehicle with that id would go there
        await scene.known(bridge.z)
        beat = nine.says("HEARTBEAT")
        while (await asyncio.to_thread(waiting.recvfrom, 2048))[0] != beat:
            pass


async def test_who_may_not_speak_is_told(scene: Scene) -> None:
    """A station with a vehicle's own id, a frame that holds a key."""
    one = scene.craft("quad1", 1)
    bridge = await scene.bridge()
    masked, station = await scene.tcp(bridge, 1), await scene.tcp(bridge)
    masked.send("COMMAND_LONG", **command(one, ARM))
    await masked.until(lambda: "you speak as system 1, which is quad1" in masked.texts(), "why")
    station.send("SETUP_SIGNING", target_system=1, target_component=1)
    await station.until(lambda: "SETUP_SIGNING holds a key" in station.texts(), "why")
    station.send("COMMAND_LONG", **command(one, ARM))
    await one.hears(lambda key, data: "COMMAND_LONG" in key and data[5] == 255, "a good one")
    assert not any(data[5] == 1 or int.from_bytes(data[7:10], "little") == SETUP_SIGNING for _, data in one.told)
    assert bridge.uplink.refused["id"] == 2 and bridge.uplink.refused["signing"] == 1


async def wanted(scene: Scene, message: str, vehicle: str = "quad1") -> list[str]:
    """The rates at which a message is wanted of a vehicle."""
    key = keys.WANT.key("demo", vehicle, msg=message, hz="*", instance="*")
    replies = await asyncio.to_thread(lambda: list(scene.router.liveliness().get(key)))
    return sorted(str(reply.ok.key_expr).split("/")[5] for reply in replies if reply.ok)


async def test_messages_are_wanted_while_a_station_is_there(scene: Scene) -> None:
    """... at the rate of the one that wants them fastest."""
    one = scene.craft("quad1", 1)
    scene.craft("quad2", 2)
    bridge = await scene.bridge(streams=True)

    async def until(message: str, rates: list[str], vehicle: str = "quad1") -> None:
        for _ in range(1000):
            if (found := await wanted(scene, message, vehicle)) == rates:
                return
            await asyncio.sleep(0.02)
        raise AssertionError(f"{message} of {vehicle} is wanted at {found}")

    assert not await wanted(scene, "VFR_HUD")
    slow, fast = await scene.tcp(bridge), await scene.tcp(bridge, 254)
    await until("VFR_HUD", ["4"])
    slow.send("COMMAND_LONG", **command(one, SET_INTERVAL, param1=ATTITUDE, param2=1e5))
    await until("ATTITUDE", ["10", "4"])
    fast.send("COMMAND_LONG", **command(one, SET_INTERVAL, param1=ATTITUDE, param2=2e4))
    await until("ATTITUDE", ["4", "50"])
    slow.send("COMMAND_LONG", **command(one, SET_INTERVAL, param1=ATTITUDE, param2=-1.0))  # no more
    slow.send("COMMAND_LONG", **command(one, SET_INTERVAL, param1=ATTITUDE, param2=1e5))
    await slow.until(lambda: len(acks(slow)) == 3, "acknowledgements")
    await until("ATTITUDE", ["4", "50"])
    for station in (slow, fast):
        await station.until(lambda station=station: bool(acks(station)), "an acknowledgement")  # type: ignore[misc]
        assert set(acks(station)) == {(1, SET_INTERVAL, 0)}
    assert await wanted(scene, "ATTITUDE", "quad2") == ["4"]
    fast.send("COMMAND_LONG", **command(one, SET_INTERVAL, param1=ATTITUDE, param2=1.0))  # a million a second
    await fast.until(lambda: acks(fast)[-1] == (1, SET_INTERVAL, 2), "a refusal")
    fast.send("REQUEST_DATA_STREAM", target_system=0, req_stream_id=11, req_message_rate=9, start_stop=1)
    await until("VFR_HUD", ["4", "9"], "quad2")
    fast.close()
    await until("ATTITUDE", ["10", "4"])
    await until("VFR_HUD", ["4"], "quad2")
    slow.close()
    await until("ATTITUDE", [])
    await until("VFR_HUD", [])
    assert not any("COMMAND_LONG" in key or "REQUEST" in key for key, _ in one.told)


async def test_a_vehicles_refusal_reaches_the_station_as_its_words(scene: Scene) -> None:
    one = scene.craft("quad1", 1)
    bridge = await scene.bridge()
    station = await scene.tcp(bridge)
    await scene.net.linked(scene.router, keys.EVENT.key("demo", "*"))
    text = "frame on zmav/demo/quad1/mav/tx/1/1/SET_MODE refused: its checksum is wrong, which is a long story to tell"
    for _ in range(3):
        one.event("refused", "warning", text)
    one.event("link", "info", "not for people")
    one.event("lease", "notice", "planner took the lease")
    await station.until(lambda: "planner took the lease" in station.texts(), "the events")
    assert station.texts() == text + "planner took the lease"
    first = station.named("STATUSTEXT")[0]
    assert (first.sysid, first.compid, decode(first, station.dialect)["severity"]) == (1, 191, 4)
    await scene.heard("quad1: frame on")


async def test_a_vehicle_whose_system_id_is_none_spoils_nobody_elses_words(scene: Scene) -> None:
    odd, one = scene.craft("odd", 3), scene.craft("quad1", 1)
    bridge = await scene.bridge()
    station = await scene.tcp(bridge)
    await scene.net.linked(scene.router, keys.EVENT.key("demo", "*"))
    odd.sysid = 300
    odd.publish_state()
    await until(lambda: 3 not in bridge.routes.systems, "its new state")
    await scene.heard("odd: 300 is no system id (1 to 255): no station is told of it")
    odd.event("refused", "warning", "odd words")
    one.event("refused", "warning", "good words")
    await station.until(lambda: "good words" in station.texts(), "the words of the other")
    assert set(bridge.routes.systems) == {1}
    assert sum("no system id" in line for line in scene.said) == 1


async def test_garbage_is_counted_and_harmless(scene: Scene) -> None:
    one = scene.craft("quad1", 1)
    bridge = await scene.bridge()
    station = await scene.udp(bridge)
    (end,) = (each for each in bridge.endpoints if each.endpoint.kind == "udpin")
    frame = station.packer.pack("COMMAND_LONG", **command(one, ARM))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.connect(end.address)  # type: ignore[attr-defined]
        for number in range(500):
            noise = os.urandom(number % 300)
            station.sock.send(noise or b"\xfd")
            stranger.send(b"\xfd" + noise)
    for cut in range(1, len(frame)):
        station.sock.send(frame[:cut])
    for data in (b"", b"\xfd", os.urandom(40), frame[:-1], frame + b"\0"):  # on the fleet's side
        one.puts(data)
        scene.router.put(keys.RX.key("demo", "quad1", sys=1, comp=1, msg="COMMAND_LONG"), data)
    for _ in range(3):  # the first ones may look like the end of what was cut
        station.send("COMMAND_LONG", **command(one, ARM, param1=1.0))
    await one.hears(lambda key, data: "COMMAND_LONG" in key, "a good command")
    await station.gets(one.says("ATTITUDE"))
    assert end.turned_away > 400 and len(bridge.clients) == 1
    assert bridge.clients[0].splitter.counters.garbage > 10_000 and bridge.downlink.counters.torn > 5


async def test_a_station_that_stops_reading_holds_up_nobody(scene: Scene) -> None:
    one = scene.craft("quad1", 1)
    bridge = await scene.bridge()
    station = await scene.udp(bridge, 254)
    stuck = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    stuck.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    (end,) = (each for each in bridge.endpoints if each.endpoint.kind == "tcp")
    with stuck:
        await asyncio.to_thread(stuck.connect, end.address)  # type: ignore[attr-defined]
        await until(lambda: len(bridge.clients) == 2, "it is connected")
        client = bridge.clients[-1]
        for _ in range(100):
            for _ in range(50):
                one.says("ATTITUDE", roll=1.0)
                one.says("STATUSTEXT", text="words that must arrive, and a lot of them, 50 long")
            await station.gets(one.says("VFR_HUD"))
            if client.counters.dropped and client.replaced:
                break
        assert client.counters.dropped and client.replaced
        assert client.waiting <= 512 + 3
        answer = one.says("HEARTBEAT")
        await station.gets(answer)
    await until(lambda: len(bridge.clients) == 1, "it is gone")


async def test_a_slow_station_gets_answers_first_and_fresh_telemetry(scene: Scene) -> None:
    """... and what was left out for it does not look lost."""
    one = scene.craft("quad1", 1)
    bridge = await scene.bridge(udpin="rate=3kB/s")
    slow, quick = await scene.udp(bridge), await scene.tcp(bridge, 254)
    for number in range(200):
        one.says("ATTITUDE", time_boot_ms=number)
    one.says("STATUSTEXT", text="now")
    one.says("COMMAND_ACK", command=7)
    await slow.until(lambda: bool(slow.named("COMMAND_ACK")), "the answer")
    await quick.until(lambda: len(quick.named("ATTITUDE")) == 200, "all of it")
    await slow.until(lambda: numbers(slow)[-1:] == [199], "the newest")
    got = [slow.dialect.name_of(frame.msgid) for frame in slow.frames]
    assert got[-3:] == ["STATUSTEXT", "COMMAND_ACK", "ATTITUDE"]
    assert len(numbers(slow)) < 150 and numbers(slow) == sorted(numbers(slow))
    assert slow.lost() == 0 and quick.lost() == 0


def numbers(station: Station) -> list[int]:
    return [int(decode(frame, station.dialect)["time_boot_ms"]) for frame in station.named("ATTITUDE")]


async def test_vehicles_are_chosen_by_name_for_all_and_for_one_endpoint(scene: Scene) -> None:
    quad, rover, plane = scene.craft("quad1", 1), scene.craft("rover1", 2), scene.craft("plane1", 3)
    bridge = await scene.bridge(vehicles="quad*,rover*", udpin="vehicles=quad*", streams=True)
    every, quads = await scene.tcp(bridge), await scene.udp(bridge, 254)
    for craft in (plane, rover, quad):
        craft.says("ATTITUDE")
    await every.until(lambda: len(every.named("ATTITUDE")) == 2, "two of three")
    await quads.until(lambda: len(quads.named("ATTITUDE")) == 1, "one of three")
    assert {frame.sysid for frame in every.frames} == {1, 2} and {frame.sysid for frame in quads.frames} == {1}
    quads.send("COMMAND_LONG", **command(rover, ARM))
    sent = quads.send("COMMAND_LONG", **command(quad, ARM))
    assert await quad.hears(lambda key, data: "COMMAND_LONG" in key, "the command") == sent
    assert not plane.told and not any(data[5] == 254 for _, data in rover.told)
    # What it asks of all is asked of those that it sees.
    quads.send("REQUEST_DATA_STREAM", target_system=0, req_stream_id=11, req_message_rate=9, start_stop=1)
    quads.send("COMMAND_LONG", **command(quad, SET_INTERVAL, param1=ATTITUDE, param2=1e5))
    for _ in range(1000):
        if await wanted(scene, "ATTITUDE") == ["10", "4"]:  # what came after it
            break
        await asyncio.sleep(0.02)
    assert await wanted(scene, "VFR_HUD") == ["4", "9"]
    assert await wanted(scene, "VFR_HUD", "rover1") == ["4"]


async def test_a_station_is_sent_to_where_it_waits_and_answers_from(scene: Scene) -> None:
    """As QGroundControl does: it listens on a port, and vehicles come to it."""
    one = scene.craft("quad1", 1)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as waiting:
        waiting.bind(("127.0.0.1", 0))
        bridge = await scene.bridge(udp=waiting.getsockname()[1], streams=True)
        (client,) = bridge.clients
        assert not client.present
        waiting.settimeout(30.0)
        beat = one.says("HEARTBEAT")
        data, bridge_address = await asyncio.to_thread(waiting.recvfrom, 2048)
        assert data == beat
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as answering:  # from another port of its own
            answering.connect(bridge_address)
            station = Station(answering)
            station.beat()
            await one.hears(lambda key, data: key.endswith("HEARTBEAT"), "the station's heartbeat")
            assert client.present
            await station.gets(one.says("ATTITUDE"))
            station.close()


async def test_a_port_in_use_is_said_at_once(scene: Scene, net: Net) -> None:
    scene.craft("quad1", 1)
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        bridge = await scene.bridge()
        end = parse_endpoint("tcp", str(taken.getsockname()[1]), Options())
        with pytest.raises(PortInUse):
            async with Bridge(bridge.z, BridgeSettings(endpoints=(end,))):
                pass


async def test_vehicles_come_and_go(scene: Scene) -> None:
    scene.craft("quad1", 1)
    bridge = await scene.bridge()
    late = scene.craft("quad2", 2)
    await scene.known(bridge.z)
    await scene.heard("quad2 is there: system 2, copter, ardupilot")
    late.leave()
    await scene.heard("quad2 is gone")
