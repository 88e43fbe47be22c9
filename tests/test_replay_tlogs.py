"""Recordings of real autopilots through link, adapter, router and ground: every frame, and what is made of them.

The judge is pymavlink: its decoding of the last frame of each kind, its names of modes.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from zmav import keys, wire

if TYPE_CHECKING:
    from tests.conftest import Ground, Net, Samples, StartOnboard

# Recording, how many times real time (about ten thousand frames a second), and the system that is the vehicle: of
# px4_three, where system 3 is heard first, the one that flies.
RECORDINGS = [
    ("copter", 100, None),
    ("copter_params", 50, None),
    ("plane", 90, None),
    ("rover", 110, None),
    ("px4", 25, None),
    ("px4_three", 10, 1),
]
PATIENT = "transport/link/tx/queue/congestion_control/drop/wait_before_drop:5000000"
"""5 s instead of 1 ms until the router drops frames for a ground that does not read: at this pace it reads in time,
unless this machine is busy with something else, which is not what is tested"""
PX4_NAMES = {"LOITER": "HOLD"}
"""pymavlink's name for PX4's AUTO LOITER is that of ArduPilot; QGroundControl and zmav call it HOLD"""


PX4S_OWN = {
    8: "LINK_NODE_STATUS",
    380: "TIME_ESTIMATE_TO_TARGET",
    410: "EVENT",
    411: "CURRENT_EVENT_SEQUENCE",
    436: "CURRENT_MODE",
}
"""messages that pymavlink lacks"""


class Record(NamedTuple):
    """A recorded frame, its header read here by hand."""

    raw: bytes
    source: tuple[int, int]
    msgid: int

    @property
    def name(self) -> str:
        known = mavlink.mavlink_map.get(self.msgid)
        return known.msgname if known else PX4S_OWN[self.msgid]


def read(path: Path) -> list[Record]:
    data, at, found = path.read_bytes(), 0, []
    while at < len(data):
        at += 8
        if data[at] == 0xFD:
            size = 12 + data[at + 1] + (13 if data[at + 2] & 1 else 0)
            source, msgid = (data[at + 5], data[at + 6]), int.from_bytes(data[at + 7 : at + 10], "little")
        else:
            size, source, msgid = 8 + data[at + 1], (data[at + 3], data[at + 4]), data[at + 5]
        found.append(Record(data[at : at + size], source, msgid))
        at += size
    return found


def parse(record: Record) -> Any:
    """What pymavlink makes of the frame; None for a message it does not know."""
    if record.msgid not in mavlink.mavlink_map:
        return None
    (message,) = mavlink.MAVLink(None).parse_buffer(bytearray(record.raw))
    return message


def is_autopilot(record: Record) -> bool:
    return record.name == "HEARTBEAT" and parse(record).autopilot != mavlink.MAV_AUTOPILOT_INVALID


def mode_of(heartbeat: Any) -> str:
    name: str = mavutil.mode_string_v10(heartbeat)
    return PX4_NAMES.get(name, name) if heartbeat.autopilot == mavlink.MAV_AUTOPILOT_PX4 else name


def assert_same(sent: Sequence[tuple[str, bytes]], came: Sequence[tuple[str, bytes]]) -> None:
    """Equal, item by item; says where not, without printing twenty thousand frames."""
    assert len(came) == len(sent), f"{len(came)} frames of {len(sent)}"
    for n, (expected, got) in enumerate(zip(sent, came, strict=True)):
        assert got == expected, f"frame {n}"


def number(theirs: Any, ours: Any) -> Any:
    """Our value as pymavlink writes it: enum names back to the number, None back to what JSON cannot say."""
    if isinstance(ours, str) and not isinstance(theirs, str):
        return sum(int(part) if part.isdigit() else getattr(mavlink, part) for part in ours.split(" | ") if part)
    if ours is None and not math.isfinite(theirs):
        return theirs
    return ours


def assert_decoded_alike(theirs: Any, ours: wire.LastMessage) -> None:
    assert list(ours.fields) == theirs.get_fieldnames()
    for field, value in ours.fields.items():
        expected = getattr(theirs, field)
        both = zip(expected, value, strict=True) if isinstance(value, list) else [(expected, value)]
        for want, got in both:
            assert number(want, got) == want or (want != want and got is None), f"{ours.name}.{field}"


@pytest.mark.parametrize(("name", "speed", "sysid"), RECORDINGS, ids=[r[0] for r in RECORDINGS])
async def test_every_frame_arrives_and_is_understood(
    name: str, speed: int, sysid: int | None, shared_data: Path, net: Net, onboard: StartOnboard
) -> None:
    path = shared_data / f"{name}.tlog"
    if not path.is_file():
        pytest.skip(f"the recording {path.name} is not there")
    records = read(path)
    session, endpoint = net.router(cfg=[PATIENT])
    ground = net.ground(endpoint, fleet="demo-replay")
    frames = ground.samples("zmav/*/*/mav/rx/**")
    events = ground.samples(keys.EVENT)
    await net.linked(session, keys.RX.key("demo-replay", "quad1", sys=1, comp=1, msg="HEARTBEAT"))

    vehicle = await onboard(session, f"replay:{path}?speed={speed}", sysid=sysid, fleet="demo-replay")
    await frames.until(lambda: len(frames.items) >= len(records), f"whole {path.name}")

    # Each frame on the key of its true source and id, untouched, in the order of the recording.
    assert_same([(key_of(r), r.raw) for r in records], frames.items)
    counters = vehicle.adapter.splitter.counters
    assert counters.frames == len(records)
    assert counters.unknown == 0
    assert counters.bad_crc == counters.bad_length == counters.bad_flags == counters.garbage == 0

    source = next(r.source for r in records if is_autopilot(r) and sysid in (None, r.source[0]))
    last = {r.name: r for r in records}
    last.update({r.name: r for r in records if r.source == source})  # the vehicle's own goes before another's
    await check_messages(ground, last)
    await check_state(ground, source, {name: parse(r) for name, r in last.items() if r.source == source})
    await check_modes(events, [parse(r) for r in records if is_autopilot(r) and r.source == source])
    others = {r.source for r in records if is_autopilot(r)} - {source}
    said = [e for e in events.objects() if e["text"].startswith("another autopilot")]
    assert sorted(e["detail"]["sysid"] for e in said) == sorted(system for system, _ in others)


def key_of(record: Record) -> str:
    system, component = record.source
    return f"zmav/demo-replay/quad1/mav/rx/{system}/{component}/{record.name}"


async def check_messages(ground: Ground, last: dict[str, Record]) -> None:
    """``msg/*`` has the last frame of each message, and decodes it as pymavlink does."""
    answers = await ground.ask("zmav/demo-replay/quad1/msg/*")
    found = {}
    for reply in answers:
        assert reply.ok is not None
        message = wire.decode(reply.ok.payload.to_bytes(), wire.LastMessage, "msg")
        assert str(reply.ok.key_expr).rpartition("/")[2] == message.name
        found[message.name] = message
    assert sorted(found) == sorted(last)
    for name, record in last.items():
        ours, theirs = found[name], parse(record)
        assert (ours.id, (ours.sysid, ours.compid)) == (record.msgid, record.source)
        assert ours.verified
        if theirs is not None:
            assert ours.seq == theirs.get_seq()
            assert_decoded_alike(theirs, ours)


async def check_state(ground: Ground, source: tuple[int, int], last: dict[str, Any]) -> None:
    """``state`` at the end of the recording is what pymavlink's last messages say."""
    (reply,) = await ground.ask("zmav/demo-replay/quad1/state")
    assert reply.ok is not None
    state = wire.decode(reply.ok.payload.to_bytes(), wire.VehicleState, "state")
    heartbeat = last["HEARTBEAT"]
    assert (state.sysid, state.compid) == source
    assert state.mode == mode_of(heartbeat)
    assert state.armed == bool(heartbeat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
    stacks = {mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: "ardupilot", mavlink.MAV_AUTOPILOT_PX4: "px4"}
    assert state.autopilot == stacks[heartbeat.autopilot]
    kinds = {
        mavlink.MAV_TYPE_QUADROTOR: "copter",
        mavlink.MAV_TYPE_FIXED_WING: "plane",
        mavlink.MAV_TYPE_GROUND_ROVER: "rover",
    }
    assert state.kind == kinds[heartbeat.type]
    assert mavlink.enums["MAV_STATE"][heartbeat.system_status].name == f"MAV_STATE_{state.status}"
    if position := last.get("GLOBAL_POSITION_INT"):
        assert state.position is not None
        assert state.velocity is not None
        p = state.position
        assert (p.lat_deg, p.lon_deg) == pytest.approx((position.lat / 1e7, position.lon / 1e7), abs=1e-9)
        assert (p.alt_amsl, p.alt_rel) == pytest.approx((position.alt / 1e3, position.relative_alt / 1e3))
        assert state.velocity == pytest.approx((position.vx / 100, position.vy / 100, position.vz / 100))
    assert (state.position is None) == ("GLOBAL_POSITION_INT" not in last)
    if attitude := last.get("ATTITUDE"):
        assert state.attitude == wire.Attitude(roll=attitude.roll, pitch=attitude.pitch, yaw=attitude.yaw)
    assert (state.attitude is None) == ("ATTITUDE" not in last)
    if battery := last.get("SYS_STATUS"):
        assert state.battery is not None
        assert state.battery.voltage == pytest.approx(battery.voltage_battery / 1000)
        if battery.battery_remaining >= 0:
            assert state.battery.remaining == pytest.approx(battery.battery_remaining / 100)
    assert (state.battery is None) == ("SYS_STATUS" not in last)
    if gps := last.get("GPS_RAW_INT"):
        assert state.gps is not None
        assert mavlink.enums["GPS_FIX_TYPE"][gps.fix_type].name == f"GPS_FIX_TYPE_{state.gps.fix}"
        assert state.gps.satellites == gps.satellites_visible


async def check_modes(events: Samples, heartbeats: list[Any]) -> None:
    """``event`` told every change of mode and of arming, in order."""
    modes = [mode_of(h) for h in heartbeats]
    arming = [bool(h.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED) for h in heartbeats]
    changed = [m for n, m in enumerate(modes) if n == 0 or modes[n - 1] != m]
    switched = [a for n, a in enumerate(arming) if n > 0 and arming[n - 1] != a]

    def said(kind: str, what: str) -> list[Any]:
        return [json.loads(body)["detail"][what] for _, body in events.items if json.loads(body)["kind"] == kind]

    await events.until(
        lambda: len(said("mode", "mode")) >= len(changed) and len(said("armed", "armed")) >= len(switched),
        "last change of mode and arming",
    )
    assert said("mode", "mode") == changed
    assert said("armed", "armed") == switched
