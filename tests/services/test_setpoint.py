"""Setpoints: what is flown and how, what is dropped and counted by its reason, and the hold when the stream stops."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import pytest

from zmav import keys, wire
from zmav.services import setpoint

if TYPE_CHECKING:
    from tests.conftest import StartOnboard
    from tests.services.conftest import Bench, StartBench

LOCAL, GLOBAL = "SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT"
GUIDED, LOITER = 4, 5
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
        point = wire.Setpoint(**({"vel": FORWARD} if not {"pos", "lat_deg"} & set(fields) else {}) | given)
        self.raw(wire.encode(point))

    def raw(self, data: bytes) -> None:
        self.b.ground.put(keys.SETPOINT, data, agent="alice")

    async def counted(self, **counts: int) -> None:
        """Wait until the vehicle's state counts so many, and nothing else."""
        await self.b.state(lambda s: s["setpoints"] == counts, f"counts {counts}")


async def pilot(b: Bench) -> Pilot:
    await (await b.connected()).flying()
    return Pilot(b, (await b.ground.do("lease", holder="alice", ttl=30)).result["lease"])


@pytest.fixture
def no_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    """The stream may pause for as long as a test needs."""
    monkeypatch.setattr(setpoint, "HOLD_AFTER", 60.0)


@pytest.mark.usefixtures("no_hold")
async def test_what_the_autopilot_is_told(bench: StartBench) -> None:
    b = await bench(sysid=9, settings={"origin": ORIGIN})
    alice = await pilot(b)
    alice.put(yaw=1.25)
    await b.peer.count(LOCAL, 1)
    told = b.peer.heard(LOCAL)[0]
    f = told.fields
    assert told.source == (9, 191)
    assert (f["target_system"], f["target_component"], f["coordinate_frame"]) == (9, 1, 1)
    assert ((f["vx"], f["vy"], f["vz"]), f["yaw"], f["type_mask"]) == (FORWARD, 1.25, 0b1001_1100_0111)
    alice.put(pos=(100.0, 0.0, -20.0), vel=(1.0, 0.0, 0.0))
    await b.peer.count(GLOBAL, 1)
    f = b.peer.heard(GLOBAL)[0].fields
    assert (f["coordinate_frame"], f["alt"], f["type_mask"]) == (5, pytest.approx(620.0, abs=0.01), 0b1101_1100_0000)
    assert f["lon_int"] == 1490000000
    assert (f["lat_int"] + 350000000) / 1e7 * 111_000 == pytest.approx(100.0, rel=0.01)
    alice.put(frame="global", lat_deg=-35.5, lon_deg=149.5, alt_rel=30.0, yaw_rate=0.1)
    await b.peer.count(GLOBAL, 2)
    f = b.peer.heard(GLOBAL)[1].fields
    assert (f["coordinate_frame"], f["lat_int"], f["lon_int"], f["alt"]) == (6, -355000000, 1495000000, 30.0)
    assert (f["yaw_rate"], f["type_mask"]) == (pytest.approx(0.1), 0b0101_1111_1000)
    await alice.counted(flown=3)


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


@pytest.mark.usefixtures("no_hold")
async def test_each_reason_is_counted_apart(bench: StartBench) -> None:
    b = await bench()
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
    b.peer.armed = False
    await b.state(lambda s: s["armed"] is False, "disarming")
    alice.put()
    await alice.counted(flown=2, lease=1, order=2, late=1, early=1, mode=1)
    b.peer.beating = False
    await b.state(lambda s: not s["connected"], "silence")
    alice.put()
    await alice.counted(flown=2, lease=1, order=2, late=1, early=1, mode=1, silent=1)
    for why in ("lease", "order", "late", "early", "mode", "silent"):
        await b.events.object(lambda e, why=why: e["detail"].get("why") == why, f"event of {why}")  # type: ignore[misc]
    assert len(b.peer.heard(LOCAL)) == 2


async def test_an_order_goes_before_the_stream(bench: StartBench) -> None:
    b = await bench()
    alice = await pilot(b)
    b.peer.mute = {22}
    took_off = await b.ground.do("takeoff", alt_rel=5, id="t", wait=0, lease=alice.token)
    assert took_off.status == "running"
    alice.put()
    await alice.counted(busy=1)


async def test_the_pilot_wins_at_once_and_until_somebody_asks_again(bench: StartBench) -> None:
    b = await bench()
    alice = await pilot(b)
    alice.put()
    await b.peer.count(LOCAL, 1)
    b.peer.mode = LOITER
    await b.state(lambda s: s["mode"] == "LOITER", "the pilot's mode")
    for _ in range(5):
        alice.put()
    await b.state(lambda s: s["setpoints"].get("mode") == 5, "dropped setpoints")
    told = len(b.peer.heard(LOCAL))
    assert b.peer.commands(176) == []
    assert not [e for e in b.events.objects() if "holding position" in e["text"]]
    await b.ground.do("set_mode", mode="GUIDED", lease=alice.token)
    alice.put()
    await b.peer.count(LOCAL, told + 1)


async def test_a_stream_that_stops_ends_in_a_hold_that_is_repeated(bench: StartBench) -> None:
    b = await bench()
    alice = await pilot(b)
    for _ in range(3):
        alice.put()
    await b.peer.count(LOCAL, 3 + 1 + setpoint.HOLD_REPEATS)
    told = b.peer.heard(LOCAL)
    flown, held = told[:3], told[3:]
    assert {(t.fields["vx"], t.fields["vy"], t.fields["vz"]) for t in flown} == {FORWARD}
    assert {(t.fields["vx"], t.fields["vy"], t.fields["vz"]) for t in held} == {(0.0, 0.0, 0.0)}
    assert {t.fields["type_mask"] for t in held} == {0b1101_1100_0111}
    assert held[0].at - flown[-1].at > setpoint.HOLD_AFTER - 0.1
    await alice.counted(flown=3, held=1)
    said = await b.event("no setpoint for 0.5 s: holding position", kind="setpoint")
    assert said["severity"] == "warning"
    assert b.peer.mode == GUIDED


async def test_a_stream_that_goes_on_during_the_hold_is_watched_too(bench: StartBench) -> None:
    b = await bench()
    alice = await pilot(b)
    alice.put()
    await b.peer.count(LOCAL, 2)
    alice.put()  # one only, and silence again
    await b.state(lambda s: s["setpoints"].get("held") == 2, "second hold")
    stops = [t.fields["vx"] for t in b.peer.heard(LOCAL)]
    assert stops[0] == stops[-1] + FORWARD[0] == FORWARD[0]


@pytest.mark.parametrize("ends", ["lease", "drop"])
async def test_a_lease_that_ends_ends_the_stream(bench: StartBench, ends: str) -> None:
    b = await bench()
    alice = await pilot(b)
    alice.put()
    await b.peer.count(LOCAL, 1)
    if ends == "drop":
        await b.ground.do("release", lease=alice.token)
    else:
        await b.ground.do("lease", holder="alice", ttl=0.1, lease=alice.token)
        await b.event("lease of alice ran out")
    alice.put()
    await b.state(lambda s: s["setpoints"] == {"flown": 1, "lease": 1, "held": 1}, "drop and hold")
    assert b.peer.heard(LOCAL)[1].fields["vx"] == 0.0


async def test_closing_holds(bench: StartBench, onboard: StartOnboard) -> None:
    b = await bench()
    alice = await pilot(b)
    alice.put()
    await b.peer.count(LOCAL, 1)
    await onboard.close(b.vehicle)
    await b.peer.count(LOCAL, 2)
    assert b.peer.heard(LOCAL)[1].fields["vx"] == 0.0


async def test_a_new_lease_begins_with_any_sequence_number(bench: StartBench) -> None:
    b = await bench()
    alice = await pilot(b)
    alice.put(seq=1000)
    await alice.counted(flown=1)
    await b.ground.do("release", lease=alice.token)
    again = await pilot(b)
    again.put(seq=0)
    await b.state(lambda s: s["setpoints"]["flown"] == 2, "the new stream")
