"""Setpoints: what is flown and how, what is dropped and counted by its reason, and the hold when the stream stops."""

from __future__ import annotations

import json
import time
from typing import TYPE_CHECKING, Any

import pytest

from zmav import keys, wire
from zmav.config import Failsafe, Geofence, Limits, PilotSwitch
from zmav.services.authority import watchdog
from zmav.services.authority.steps import Step

if TYPE_CHECKING:
    from tests.conftest import Net, StartOnboard
    from tests.services.conftest import Bench, StartBench, StartPeer, Told

LOCAL, GLOBAL = "SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT"
RC = "RC_CHANNELS_OVERRIDE"
GUIDED, LOITER = 4, 5
HOLD, OFFBOARD = 4 << 16 | 3 << 24, 6 << 16
SET_MODE, FAILED = 176, 4
STOP = (0.0, 0.0, 0.0)
ORIGIN = wire.Origin(lat_deg=-35.0, lon_deg=149.0, alt_amsl=600.0)
FORWARD = (1.5, -0.5, 0.25)


class Pilot:
    """An agent with the lease that sends setpoints."""

    def __init__(self, b: Bench, token: str) -> None:
        self.b, self.token, self.seq = b, token, 0

    def put(self, **fields: Any) -> None:
        """The next setpoint: a velocity, with what is given changed."""
        self.seq += 1
        given = {"lease": self.token, "seq": self.seq, "deadline": time.time() + 2.0, **fields}
        point = wire.Setpoint(**({"vel": FORWARD} if not {"pos", "lat_deg", "vel"} & set(fields) else {}) | given)
        self.raw(wire.encode(point))

    def raw(self, data: bytes) -> None:
        self.b.ground.put(keys.SETPOINT, data, agent="alice")

    async def counted(self, **counts: int) -> None:
        """Wait until the vehicle's state counts so many, and nothing else."""
        await self.b.state(lambda s: s["setpoints"] == counts, f"counts {counts}")


async def pilot(b: Bench, mode: int = GUIDED, armed: bool = True) -> Pilot:
    await b.connected()
    b.peer.mode, b.peer.armed = mode, armed
    identity = b.vehicle.identity
    await b.state(lambda s: bool(identity.heartbeat and identity.heartbeat["custom_mode"] == mode), "its mode")
    await b.state(lambda s: s["armed"] is armed, "its arming")
    return Pilot(b, (await b.ground.do("lease", holder="alice", ttl=30)).result["lease"])


NO_HOLD = {"failsafe": Failsafe(hold_after=60.0, land_after="never")}
"""the stream may pause for as long as a test needs"""


def vel(told: Told) -> wire.Vector:
    return (told.fields["vx"], told.fields["vy"], told.fields["vz"])


async def test_what_the_autopilot_is_told(bench: StartBench) -> None:
    b = await bench(sysid=9, settings={"origin": ORIGIN, **NO_HOLD})
    alice = await pilot(b)
    alice.put(yaw=1.25)
    await b.peer.count(LOCAL, 1)
    told = b.peer.heard(LOCAL)[0]
    f = told.fields
    assert told.source == (9, 191)
    assert (f["target_system"], f["target_component"], f["coordinate_frame"]) == (9, 1, 1)
    assert (vel(told), f["yaw"], f["type_mask"]) == (FORWARD, 1.25, 0b1001_1100_0111)
    alice.put(pos=(100.0, 0.0, -20.0), vel=(1.0, 0.0, 0.0))
    await b.peer.until(lambda: bool(b.peer.heard(GLOBAL, coordinate_frame=5)), "a trajectory's point")
    f = b.peer.heard(GLOBAL)[0].fields
    assert (f["alt"], f["type_mask"]) == (pytest.approx(620.0, abs=0.01), 0b1101_1100_0000)
    assert f["lon_int"] == 1490000000
    assert (f["lat_int"] + 350000000) / 1e7 * 111_000 == pytest.approx(100.0, rel=0.01)
    alice.put(frame="global", lat_deg=-35.005, lon_deg=149.005, alt_rel=30.0, yaw_rate=0.1)
    await b.peer.until(lambda: bool(b.peer.heard(GLOBAL, coordinate_frame=6)), "a global position")
    f = b.peer.heard(GLOBAL, coordinate_frame=6)[0].fields
    assert (f["lat_int"], f["lon_int"], f["alt"]) == (-350050000, 1490050000, 30.0)
    assert (f["yaw_rate"], f["type_mask"]) == (pytest.approx(0.1), 0b0101_1111_1000)
    await alice.counted(flown=3)


async def test_the_last_one_is_kept_alive_while_it_is_fresh(bench: StartBench) -> None:
    b = await bench(settings=NO_HOLD)
    alice = await pilot(b)
    alice.put()
    await b.peer.count(LOCAL, 4)
    told = b.peer.heard(LOCAL)
    assert {vel(t) for t in told} == {FORWARD}
    assert told[3].at - told[0].at > 0.5  # 4 Hz
    await alice.counted(flown=1)


WRONG = [
    b"nonsense",
    b"[]",
    b"\xff",
    b'{"lease": "\xff\xff"}',
    b'{"lease": "x", "seq": 1}',
    b'{"lease": "x", "seq": 1.5, "deadline": 1}',
    b'{"lease": "x", "seq": 1, "deadline": 1, "speed": 3}',
    b'{"lease": "x", "seq": 1, "deadline": 1, "vel": [1, 2]}',
]


async def test_wrong_json(bench: StartBench) -> None:
    b = await bench()
    alice = await pilot(b)
    for data in WRONG:
        alice.raw(data)
    b.ground.session.delete(keys.SETPOINT.key("demo", "quad1", agent="alice"))
    await alice.counted(bad_input=len(WRONG) + 1)
    said = await b.event("setpoint of alice dropped", kind="setpoint")
    assert said["detail"]["why"] == "bad_input"
    assert b.peer.heard(LOCAL) == []


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"pos": (1.0, 2.0, 3.0)}, "none is declared"),
        ({"vel": None}, "neither a position nor a velocity"),
        ({"lat_deg": 1.0}, "belongs to frame 'global'"),
        ({"frame": "global", "lat_deg": 1.0, "lon_deg": 200.0, "alt_rel": 1.0}, "lon_deg must be within"),
        ({"frame": "global", "pos": (0.0, 0.0, 0.0)}, "belongs to frame 'ned'"),
    ],
)
async def test_points_that_make_no_sense(bench: StartBench, fields: dict[str, Any], words: str) -> None:
    b = await bench()
    alice = await pilot(b)
    alice.put(**fields)
    await alice.counted(bad_input=1)
    await b.event(words, kind="setpoint")
    assert b.peer.heard(LOCAL) == b.peer.heard(GLOBAL) == []


async def test_each_reason_is_counted_apart(bench: StartBench) -> None:
    b = await bench(settings=NO_HOLD)
    alice = await pilot(b)
    alice.put()
    await alice.counted(flown=1)
    alice.put(lease="bob's guess")
    await alice.counted(flown=1, lease=1)
    alice.put(seq=1)
    alice.put(seq=0)
    await alice.counted(flown=1, lease=1, order=2)
    alice.put(deadline=time.time() - 0.1)
    await alice.counted(flown=1, lease=1, order=2, late=1)
    alice.put(deadline=time.time() + 60)
    await alice.counted(flown=1, lease=1, order=2, late=1, early=1)
    alice.put()
    await alice.counted(flown=2, lease=1, order=2, late=1, early=1)
    b.peer.beating = False
    await b.state(lambda s: not s["connected"], "silence")
    alice.put()
    await alice.counted(flown=2, lease=1, order=2, late=1, early=1, silent=1)
    for why in ("lease", "order", "late", "early", "silent"):
        await b.events.object(lambda e, why=why: e["detail"].get("why") == why, f"event of {why}")  # type: ignore[misc]


async def test_what_is_beyond_the_fence_and_the_limits(bench: StartBench) -> None:
    settings = {"origin": ORIGIN, "geofence": Geofence(radius=100.0), "limits": Limits(speed=5.0, climb=1.0), **NO_HOLD}
    b = await bench(settings=settings)
    alice = await pilot(b)
    alice.put(pos=(101.0, 0.0, -5.0))
    await alice.counted(fence=1)
    await b.event("beyond the geofence's radius of 100 m", kind="setpoint")
    alice.put(vel=(4.0, 4.0, 0.0))
    await alice.counted(fence=1, speed=1)
    alice.put(vel=(0.0, 0.0, -1.5))
    await alice.counted(fence=1, speed=1, climb=1)
    alice.put(pos=(99.0, 0.0, -5.0))
    await b.peer.count(GLOBAL, 1)
    assert b.peer.heard(LOCAL) == []
    far = time.time() + 1.0
    points = [
        wire.SegmentPoint(t=far - 1.0, pos=(0.0, 0.0, -5.0)),
        wire.SegmentPoint(t=far + 9.0, pos=(120.0, 0.0, -5.0)),
    ]
    alice.put(vel=None, segment=points)
    await b.state(lambda s: s["setpoints"].get("speed") == 2 or s["setpoints"].get("fence") == 2, "refused segment")


async def test_a_newer_grounds_field_is_refused_in_words_and_not_flown_without_it(bench: StartBench) -> None:
    b = await bench(settings=NO_HOLD)
    alice = await pilot(b)
    alice.put()
    await alice.counted(flown=1)
    at = time.time()
    point = {"lease": alice.token, "seq": 2, "deadline": at + 2.0, "vel": FORWARD}
    alice.raw(json.dumps({**point, "wind_limit": 8}).encode())
    await alice.counted(flown=1, bad_input=1)
    await b.event("setpoint of alice dropped: ", kind="setpoint")
    segment = [{"t": at + 1.0, "pos": [0, 0, -5], "jerk": 1}, {"t": at + 2.0, "pos": [1, 0, -5]}]
    alice.raw(json.dumps({**point, "vel": None, "segment": segment}).encode())
    await alice.counted(flown=1, bad_input=2)
    alice.raw(json.dumps(point).encode())
    await alice.counted(flown=2, bad_input=2)
    said = await b.events.object(lambda e: e["detail"].get("why") == "bad_input", "the refusal")
    assert "unknown field" in said["text"] and "wind_limit" in said["text"]


async def test_a_disarmed_vehicle_follows_nothing(bench: StartBench) -> None:
    b = await bench()
    alice = await pilot(b, armed=False)
    alice.put()
    await alice.counted(disarmed=1)
    await b.event("it is disarmed", kind="setpoint")
    assert b.peer.heard(LOCAL) == []
    assert b.peer.commands(SET_MODE) == []


async def test_a_clash_stops_the_stream(bench: StartBench, net: Net, onboard: StartOnboard, peer: StartPeer) -> None:
    b = await bench()
    alice = await pilot(b)
    session, _ = net.router(b.endpoint)
    await onboard(session, (await peer(2, uid=2)).url, "quad1")
    await b.state(lambda s: s["clash"], "clash")
    alice.put()
    await b.state(lambda s: s["setpoints"].get("clash"), "refusal")


async def test_a_link_that_is_down(bench: StartBench, monkeypatch: pytest.MonkeyPatch) -> None:
    b = await bench()
    alice = await pilot(b)
    monkeypatch.setattr(b.vehicle.adapter.link, "_write", lambda data: 0)
    alice.put()
    await b.state(lambda s: s["setpoints"].get("link"), "drop")
    await b.event("the link to the autopilot is down or full", kind="setpoint")


async def test_an_order_goes_before_the_stream(bench: StartBench) -> None:
    b = await bench()
    alice = await pilot(b)
    b.peer.mute = {22}
    took_off = await b.ground.do("takeoff", alt_rel=5, id="t", wait=0, lease=alice.token)
    assert took_off.status == "running"
    alice.put()
    await alice.counted(busy=1)


async def test_the_first_setpoint_enters_the_mode_that_follows_it(bench: StartBench) -> None:
    b = await bench(settings=NO_HOLD)
    b.peer.mute = {SET_MODE}
    alice = await pilot(b, mode=LOITER)
    alice.put()
    await alice.counted(engaging=1)
    await b.peer.until(lambda: len(b.peer.commands(SET_MODE)) >= 2, "GUIDED asked for twice")
    assert {t.fields["param2"] for t in b.peer.commands(SET_MODE)} == {GUIDED}
    assert b.peer.heard(LOCAL) == []
    b.peer.mode = GUIDED
    await b.peer.count(LOCAL, 1)  # the one that waited for it
    assert vel(b.peer.heard(LOCAL)[0]) == FORWARD
    asked = len(b.peer.commands(SET_MODE))
    alice.put()
    await alice.counted(engaging=1, flown=1)
    assert len(b.peer.commands(SET_MODE)) == asked


async def test_a_stream_that_never_engaged_ends_without_a_hold(bench: StartBench) -> None:
    b = await bench()
    b.peer.results[SET_MODE] = [FAILED]
    alice = await pilot(b, mode=LOITER)
    alice.put()
    await b.peer.until(lambda: bool(b.peer.commands(SET_MODE)), "GUIDED asked for")
    await b.peer.until(lambda: b.vehicle.authority.watchdog.step is Step.IDLE, "the end of the stream")
    assert b.peer.heard(LOCAL) == []
    assert b.vehicle.setpoints.counts == {"engaging": 1}


async def test_px4_hears_the_stream_for_a_second_before_offboard_is_asked_for(bench: StartBench) -> None:
    b = await bench(autopilot=12, settings=NO_HOLD)
    b.peer.mute = {SET_MODE}
    alice = await pilot(b, mode=HOLD)
    alice.put()
    await b.peer.until(lambda: bool(b.peer.commands(SET_MODE)), "OFFBOARD asked for")
    asked = b.peer.commands(SET_MODE)[0]
    before = [t for t in b.peer.heard(LOCAL) if t.at < asked.at]
    assert (asked.fields["param2"], asked.fields["param3"]) == (6, 0)
    assert asked.at - before[0].at > 0.9
    assert len(before) >= 10  # 20 Hz, on a busy machine
    await b.peer.until(lambda: len(b.peer.commands(SET_MODE)) >= 2, "OFFBOARD asked for again")
    b.peer.mode = OFFBOARD
    await b.state(lambda s: s["mode"] == "OFFBOARD", "OFFBOARD")
    alice.put(vel=(0.5, 0.0, 0.0))
    await b.peer.until(lambda: vel(b.peer.heard(LOCAL)[-1]) == (0.5, 0.0, 0.0), "the next one")
    await alice.counted(engaging=1, flown=1)


async def test_a_stream_that_stops_ends_in_a_hold_that_is_repeated(bench: StartBench) -> None:
    b = await bench()
    alice = await pilot(b)
    for _ in range(3):
        alice.put()
    await b.peer.until(lambda: sum(vel(t) == STOP for t in b.peer.heard(LOCAL)) > watchdog.HOLD_REPEATS, "holds")
    told = b.peer.heard(LOCAL)
    flown, held = [t for t in told if vel(t) == FORWARD], [t for t in told if vel(t) == STOP]
    assert len(flown) + len(held) == len(told)
    assert {t.fields["type_mask"] for t in held} == {0b1101_1100_0111}
    assert held[0].at - flown[2].at > 0.4
    await alice.counted(flown=3, held=1)
    said = await b.event("no setpoint for 0.5 s: holding position", kind="setpoint")
    assert said["severity"] == "warning"
    assert b.peer.mode == GUIDED


async def test_a_hold_is_repeated_until_it_stands_still(bench: StartBench) -> None:
    b = await bench()
    alice = await pilot(b)
    b.peer.send("GLOBAL_POSITION_INT", lat=-350000000, lon=1490000000, vx=300)
    alice.put()
    enough = 3 * watchdog.HOLD_REPEATS
    await b.peer.until(lambda: sum(vel(t) == STOP for t in b.peer.heard(LOCAL)) > enough, "more holds")
    b.peer.send("GLOBAL_POSITION_INT", lat=-350000000, lon=1490000000, vx=10)
    told = len(b.peer.heard(LOCAL))
    alice.put()
    await b.state(lambda s: s["setpoints"].get("held") == 2, "the second hold")
    await b.state(lambda s: True, "a moment")
    assert len(b.peer.heard(LOCAL)) <= told + 1 + 3 + 2 + watchdog.HOLD_REPEATS


async def test_a_stream_that_goes_on_during_the_hold_is_watched_too(bench: StartBench) -> None:
    b = await bench()
    alice = await pilot(b)
    alice.put()
    await b.peer.until(lambda: STOP in map(vel, b.peer.heard(LOCAL)), "hold")
    alice.put()  # one only, and silence again
    await b.state(lambda s: s["setpoints"].get("held") == 2, "second hold")
    stops = [vel(t) for t in b.peer.heard(LOCAL)]
    assert stops[0] == FORWARD
    assert FORWARD in stops[stops.index(STOP) :]


@pytest.mark.parametrize(
    ("end", "severity"),
    [("release", "info"), ("arm", "info"), ("revoke", "warning")],
)
async def test_what_somebody_means_to_end_is_no_warning(bench: StartBench, end: str, severity: str) -> None:
    b = await bench()
    alice = await pilot(b)
    alice.put()
    await b.state(lambda s: s["setpoints"].get("flown"), "a stream")
    alice.put()
    await b.ground.do(end, **({} if end == "revoke" else {"lease": alice.token}))
    said = await b.event(": holding position", kind="setpoint")
    assert said["severity"] == severity, said
    assert "no setpoint" not in said["text"]


@pytest.mark.parametrize("ends", ["expiry", "release"])
async def test_a_lease_that_ends_ends_the_stream_at_once(bench: StartBench, ends: str) -> None:
    b = await bench(settings=NO_HOLD)
    alice = await pilot(b)
    alice.put()
    await b.peer.count(LOCAL, 1)
    if ends == "release":
        await b.ground.do("release", lease=alice.token)
    else:
        await b.ground.do("lease", holder="alice", ttl=0.1, lease=alice.token)
        await b.event("lease of alice ran out")
    await b.peer.until(lambda: STOP in map(vel, b.peer.heard(LOCAL)), "hold")
    alice.put()
    await b.state(lambda s: s["setpoints"] == {"flown": 1, "lease": 1, "held": 1}, "drop and hold")


async def test_closing_holds(bench: StartBench, onboard: StartOnboard) -> None:
    b = await bench(settings=NO_HOLD)
    alice = await pilot(b)
    alice.put()
    await b.peer.count(LOCAL, 1)
    await onboard.close(b.vehicle)
    await b.peer.until(lambda: STOP in map(vel, b.peer.heard(LOCAL)), "hold")


async def test_a_new_lease_begins_with_any_sequence_number(bench: StartBench) -> None:
    b = await bench()
    alice = await pilot(b)
    alice.put(seq=1000)
    await alice.counted(flown=1)
    await b.ground.do("release", lease=alice.token)
    again = await pilot(b)
    again.put(seq=0)
    await b.state(lambda s: s["setpoints"]["flown"] == 2, "the new stream")


async def test_an_override_is_given_back(bench: StartBench) -> None:
    b = await bench(settings=NO_HOLD)
    alice = await pilot(b, mode=LOITER)
    alice.put(vel=None, rc=[1600, None, 1400])
    await b.peer.count(RC, 1)
    f = b.peer.heard(RC)[0].fields
    assert (f["chan1_raw"], f["chan2_raw"], f["chan3_raw"]) == (1600, 0, 1400)
    assert b.peer.commands(SET_MODE) == []  # sticks act in the mode it is in
    b.peer.armed = False
    await b.state(lambda s: s["armed"] is False, "disarmed")
    await b.peer.until(lambda: b.peer.heard(RC)[-1].fields["chan1_raw"] == 0, "channels given back")


async def test_an_override_gives_way_to_a_velocity(bench: StartBench) -> None:
    b = await bench(settings=NO_HOLD)
    alice = await pilot(b)
    alice.put(vel=None, rc=[1600])
    await b.peer.count(RC, 1)
    alice.put()
    await b.peer.count(LOCAL, 1)
    assert b.peer.heard(RC)[-1].fields["chan1_raw"] == 0


async def test_no_agent_moves_the_pilot_s_switch(bench: StartBench) -> None:
    b = await bench(settings={"pilot_switch": PilotSwitch(channel=2)})
    alice = await pilot(b)
    alice.put(vel=None, rc=[1600, 1500])
    await alice.counted(pilot=1)
    alice.put(vel=None, rc=[1600, None])
    await alice.counted(pilot=1, flown=1)
