"""The cache of parameters: how it is filled, renewed, doubted, dropped and served."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from functools import partial
from typing import TYPE_CHECKING, Any

import pytest

from tests.services.params.param_peer import HOME, INT8, INT32, NO_INDEX, REAL32, ParamPeer, many, scenes
from zmav import wire
from zmav.errors import BadInput, Stale, TimedOut

if TYPE_CHECKING:
    from tests.conftest import StartOnboard
    from tests.services.conftest import StartBench, Told
    from tests.services.params.param_peer import StartScene

BYTEWISE, C_CAST, FLOAT = 16, 1 << 17, 2


@pytest.fixture
async def scene(bench: StartBench) -> AsyncIterator[StartScene]:
    async with scenes(bench) as start:
        yield start


# Serving.


async def test_the_set_is_read_at_connect_and_served(scene: StartScene) -> None:
    s = await (await scene()).read()
    table = await s.table()
    assert [p.name for p in table.params] == list(s.peer.params)  # each at its index
    assert sorted((p.name, p.value, p.type) for p in table.params) == [
        ("FRAME", 1, "INT8"),
        ("RTL_ALT", 1500, "INT32"),
        ("WPNAV_ACCEL", 250.0, "REAL32"),
        ("WPNAV_SPEED", 1000.0, "REAL32"),
    ]
    assert table.encoding == "c_cast"
    assert (table.complete, table.count, table.autopilot, table.unchanged) == (True, 4, "ardupilot", False)
    assert table.firmware == "4.7.0"
    assert (s.peer.lists(), s.peer.asked()) == (1, [])
    assert "4 parameters read" in (await s.b.event("parameters read"))["text"]


async def test_readers_cost_the_radio_nothing(scene: StartScene) -> None:
    s = await (await scene()).read()
    before = len(s.peer.told)
    table = await s.table()
    await s.get("RTL_ALT")
    with pytest.raises(BadInput):
        await s.get("NOPE")
    assert {told.name for told in s.peer.told[before:]} <= {"HEARTBEAT", "COMMAND_LONG", "TIMESYNC"}
    short = await s.table(hash=table.hash)
    assert (short.unchanged, short.params, short.count, short.complete) == (True, [], 4, True)
    s.peer.params["RTL_ALT"] = (1600.0, INT32)
    s.peer.value("RTL_ALT")  # somebody else has set it
    await s.until(lambda: s.known.entries["RTL_ALT"].raw != b"\0\x80\xbbD", "news")
    again = await s.table(hash=table.hash)
    assert (again.unchanged, again.hash != table.hash, len(again.params)) == (False, True, 4)
    assert (await s.get("RTL_ALT")).value == 1600


async def test_one_parameter_and_wildcards(scene: StartScene) -> None:
    s = await (await scene()).read()
    for name in ("WPNAV_SPEED", "wpnav_speed"):
        assert await s.get(name) == wire.Param(name="WPNAV_SPEED", value=1000.0, type="REAL32")
    found = await s.b.ground.ask("zmav/demo/*/param/WPNAV_$*")
    keys = sorted(str(reply.ok.key_expr) for reply in found if reply.ok)
    assert keys == ["zmav/demo/quad1/param/WPNAV_ACCEL", "zmav/demo/quad1/param/WPNAV_SPEED"]
    assert len(await s.b.ground.ask("zmav/demo/quad1/param/*")) == 4
    assert len(await s.b.ground.ask("zmav/demo/*/param/RTL_ALT")) == 1
    assert await s.b.ground.ask("zmav/demo/*/param/NOPE") == []
    found = await s.b.ground.ask("zmav/demo/quad1/param/**")
    assert [str(reply.ok.key_expr) for reply in found if reply.ok] == ["zmav/demo/quad1/param"]
    (reply,) = await s.b.ground.ask("zmav/*/*/param")
    assert str(reply.ok and reply.ok.key_expr) == "zmav/demo/quad1/param"


async def test_unknown_names_and_fields_are_refused(scene: StartScene) -> None:
    s = await (await scene()).read()
    with pytest.raises(BadInput, match="no parameter 'WPNAV_SPED'; did you mean WPNAV_SPEED"):
        await s.get("WPNAV_SPED")
    with pytest.raises(BadInput, match="colour"):
        await s.table(colour=3)


# Filling.


@pytest.mark.parametrize("lost", [{0}, {3, 4, 5}, {19}, {17, 18, 19}, {0, 7, 19}], ids=str)
async def test_gaps_are_asked_for_one_by_one(scene: StartScene, lost: set[int]) -> None:
    params = many(20)
    s = await (await scene(params, lambda peer: peer.lost.update(lost))).read()
    assert await s.values() == {name: value for name, (value, _) in params.items()}
    assert sorted(s.peer.asked()) == sorted(lost)
    assert s.peer.lists() == 1


async def test_a_stream_that_breaks_off(scene: StartScene) -> None:
    s = await (await scene(many(30), lambda peer: setattr(peer, "stop_at", 12))).read()
    assert s.known.count == len(await s.values()) == 30


async def test_duplicates_and_hash_check(scene: StartScene) -> None:
    def prepare(peer: ParamPeer) -> None:
        peer.repeat = 3
        peer.hidden["_HASH_CHECK"] = (1234.0, 5)

    s = await (await scene(many(20), prepare)).read()
    s.peer.value("_HASH_CHECK")
    s.peer.value("P_0003", 3)
    await s.until(lambda: s.known.junk >= 1, "taken for no parameter")
    assert len(await s.values()) == 20
    assert (s.known.complete, s.peer.asked()) == (True, [])


async def test_the_count_changes_in_the_middle(scene: StartScene) -> None:
    s = await scene(many(40), lambda peer: setattr(peer, "stop_at", 20))
    await s.peer.until(lambda: bool(s.peer.asked()), "question")
    s.peer.stop_at = None
    s.peer.params = {"A_FIRST": (7.0, REAL32), **many(40)}  # every index is another parameter's now
    await s.read()
    assert await s.values() == {name: value for name, (value, _) in s.peer.params.items()}


async def test_a_group_is_enabled_later(scene: StartScene) -> None:
    s = await (await scene()).read()
    s.b.vehicle.params.settle = 0.1
    s.peer.params = {"FENCE_ALT": (100.0, REAL32), **s.peer.params}
    s.peer.value("FRAME")
    await s.until(lambda: s.known.count == 5, "new count")
    await s.read()
    assert (await s.get("FENCE_ALT")).value == 100.0
    s.peer.params.pop("FENCE_ALT")
    s.peer.value("FRAME")
    await s.until(lambda: s.known.count == 4 and s.known.complete, "old count")
    with pytest.raises(BadInput):
        await s.get("FENCE_ALT")


async def test_an_autopilot_that_answers_nothing(scene: StartScene) -> None:
    s = await scene(prepare=lambda peer: peer.deaf.update({"PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "PARAM_SET"}))
    talk = s.b.vehicle.params.talk
    talk.list_timeout, talk.list_tries, talk.longest_wait = 0.05, 3, 0.05
    event = await s.b.event("parameters not read")
    assert (event["kind"], event["severity"]) == ("param", "warning")
    assert s.peer.lists() == 3
    with pytest.raises(TimedOut, match="no PARAM_VALUE after 3 times PARAM_REQUEST_LIST"):
        await s.b.ground.do("param_refresh")
    table = await s.table()
    assert (table.complete, table.count, table.params) == (False, 0, [])
    with pytest.raises(TimedOut, match="not all parameters are read"):
        await s.get("RTL_ALT")
    with pytest.raises(TimedOut):
        await s.b.ground.do("param_set", name="RTL_ALT", value=1)


async def test_one_index_never_comes(scene: StartScene) -> None:
    s = await scene(many(20), lambda peer: peer.deaf.update({"PARAM_REQUEST_READ"}) or peer.lost.add(9))
    s.b.vehicle.params.talk.index_tries = 2
    await s.b.event("1 of 20 parameters do not come")
    table = await s.table()
    assert (table.complete, table.count, len(table.params)) == (False, 20, 19)


async def test_param_error_says_that_there_is_no_such_index(scene: StartScene) -> None:
    s = await scene(many(20), lambda peer: peer.deaf.add("PARAM_REQUEST_READ") or peer.lost.add(9))
    await s.peer.count("PARAM_REQUEST_READ", 1)
    s.peer.send("PARAM_ERROR", param_id="", param_index=9, error=1)
    await s.b.event("1 of 20 parameters do not come")


async def test_the_autopilot_falls_silent_in_the_middle(scene: StartScene) -> None:

    def prepare(peer: ParamPeer) -> None:
        peer.stop_at = 10
        peer.deaf.add("PARAM_REQUEST_READ")

    s = await scene(many(30), prepare)
    s.b.vehicle.identity.heartbeat_timeout = 1.0
    await s.peer.until(lambda: bool(s.peer.asked()), "question")
    s.peer.beating = False
    with pytest.raises(Stale, match="silent"):
        await s.b.ground.do("param_refresh")
    assert len(await s.values()) == 10
    s.peer.stop_at = None
    s.peer.beating = True
    await s.read()
    assert len(await s.values()) == 30


async def test_two_readers_at_once_are_one_download(scene: StartScene) -> None:
    s = await (await scene(many(50), lambda peer: setattr(peer, "stop_at", 45))).read()
    before = s.peer.lists()
    both = await asyncio.gather(*(s.b.ground.do("param_refresh") for _ in range(2)))
    assert [outcome.result["count"] for outcome in both] == [50, 50]
    assert s.peer.lists() == before + 1


async def test_a_reader_who_leaves_does_not_end_the_other_s_download(scene: StartScene) -> None:
    s = await (await scene(many(50), lambda peer: setattr(peer, "stop_at", 45))).read()
    params = s.b.vehicle.params
    one = asyncio.create_task(params.refresh(wire.ParamRefresh(), lambda news: None))
    other = asyncio.create_task(params.refresh(wire.ParamRefresh(), lambda news: None))
    await asyncio.sleep(0)
    one.cancel()
    assert (await other)["count"] == 50


async def test_refresh_reports_how_far_it_is(scene: StartScene) -> None:
    s = await (await scene(many(30))).read()
    s.peer.stop_at = 20
    news: list[dict[str, Any]] = []
    await s.b.vehicle.params.refresh(wire.ParamRefresh(), lambda each: news.append(dict(each)))
    assert news[-1]["count"] == 30
    assert any(each["received"] >= 20 for each in news)


async def test_lost_heartbeats_do_not_end_a_reading_that_goes_on(
    scene: StartScene,
) -> None:
    """At a fifth of the frames lost, three heartbeats of one a second soon are, and nobody is gone."""
    s = await (await scene(many(60))).read()
    s.b.vehicle.identity.heartbeat_timeout = 0.5
    s.peer.on_told = lambda told: None
    refresh = asyncio.create_task(s.b.ground.do("param_refresh"))
    await s.peer.until(lambda: s.peer.lists() == 2, "second list")
    s.peer.beating = False
    for index in range(60):
        s.peer.value(f"P_{index:04d}", index)
        await asyncio.sleep(0.03)
    assert (await refresh).result["count"] == 60
    assert not s.b.vehicle.identity.connected


# Who the autopilot is.


async def test_another_autopilot_has_another_set(scene: StartScene) -> None:
    s = await (await scene()).read()
    s.b.vehicle.identity.heartbeat_timeout = 1.0
    s.peer.beating = False
    await s.b.state(lambda state: not state["connected"], "silence")
    s.peer.uid, s.peer.params = 77, {"OTHER": (3.0, REAL32)}
    s.peer.beating = True
    await s.until(lambda: list(s.known.entries) == ["OTHER"] and s.known.complete, "other set")
    assert await s.values() == {"OTHER": 3.0}


async def test_silence_alone_is_no_reason_to_read_again(scene: StartScene) -> None:
    s = await (await scene()).read()
    s.b.vehicle.identity.heartbeat_timeout = 1.0
    s.peer.send("ATTITUDE", time_boot_ms=50_000)
    s.peer.beating = False
    await s.b.state(lambda state: not state["connected"], "silence")
    s.peer.beating = True
    await s.b.state(lambda state: state["connected"] and state["uid"], "the same again")
    s.peer.send("ATTITUDE", time_boot_ms=55_000)
    await s.b.state(lambda state: state["attitude"], "telemetry")
    assert (s.known.complete, s.peer.lists()) == (True, 1)


async def test_after_a_restart_it_is_read_again(scene: StartScene) -> None:
    s = await (await scene()).read()
    answer, begun = s.peer.on_told, time.monotonic_ns() - 50_000_000_000

    def with_time(told: Told) -> None:
        if told.name == "TIMESYNC" and told.fields["tc1"] == 0:
            s.peer.send("TIMESYNC", tc1=time.monotonic_ns() - begun, ts1=told.fields["ts1"])
        answer(told)

    s.peer.on_told = with_time
    await s.b.state(lambda state: state["clock"], "its clock")
    s.peer.params["RTL_ALT"] = (1700.0, INT32)
    begun = time.monotonic_ns() - 900_000_000
    await s.until(lambda: s.peer.lists() == 2 and s.known.complete, "second reading")
    assert (await s.get("RTL_ALT")).value == 1700


async def test_other_components_parameters_are_their_own(scene: StartScene) -> None:
    s = await (await scene()).read()
    s.peer.hidden["GMB_RATE"] = (5.0, REAL32)
    for index in (0, NO_INDEX):
        s.peer.value("GMB_RATE", index, count=9, compid=154)
        s.peer.value("RTL_ALT", index, count=9, compid=154)
    s.peer.params["WPNAV_SPEED"] = (900.0, REAL32)
    s.peer.value("WPNAV_SPEED")
    await s.until(lambda: b"\0\0aD" in {e.raw for e in s.known.entries.values()}, "what came after")
    assert set(await s.values()) == set(HOME)
    assert (s.known.count, s.known.complete) == (4, True)


# Encodings.

NUMBERS = {"BIG": (2**24 + 1, INT32), "NEGATIVE": (-5, INT32), "SMALL": (-3, INT8), "REAL": (0.1, REAL32)}


async def test_px4_sends_integers_as_their_bytes(scene: StartScene) -> None:
    s = await (await scene(NUMBERS, autopilot=12)).read()
    assert await s.values() == {"BIG": 16777217, "NEGATIVE": -5, "SMALL": -3, "REAL": 0.1}
    outcome = await s.b.ground.do("param_set", name="BIG", value=2**24 + 3)
    assert outcome.result == {"name": "BIG", "value": 16777219, "before": 16777217}
    assert s.peer.params["BIG"] == (16777219, INT32)


@pytest.mark.parametrize(
    ("flags", "autopilot", "bytewise"), [(BYTEWISE, 3, True), (C_CAST, 12, False), (FLOAT, 12, False)]
)
async def test_what_the_autopilot_says_of_its_encoding_counts(
    scene: StartScene, flags: int, autopilot: int, bytewise: bool
) -> None:
    s = await scene(NUMBERS, lambda peer: setattr(peer, "bytewise", bytewise), autopilot=autopilot)
    await s.read()
    s.peer.send("AUTOPILOT_VERSION", uid=1, capabilities=flags)
    await s.until(lambda: (s.b.vehicle.params.talk.encoding.value == "bytewise") is bytewise, "encoding")
    big = 2**24 + 1 if bytewise else 2**24
    assert await s.values() == {"BIG": big, "NEGATIVE": -5, "SMALL": -3, "REAL": 0.1}


# What nobody should send.

HOSTILE: list[dict[str, Any]] = [
    {"param_index": 7, "param_count": 4},
    {"param_index": 4, "param_count": 4},
    {"param_index": 0, "param_count": 65535},
    {"param_index": 0, "param_count": 0},
    {"param_id": ""},
    {"param_id": "with blank", "param_count": 4},
    {"param_id": b"\xff\xfe\x01", "param_count": 4},
    {"param_id": "a/b*c$d#e?", "param_count": 4},
    {"param_type": 0, "param_count": 4},
    {"param_type": 77, "param_count": 4},
]


async def test_junk_is_counted_and_changes_nothing(scene: StartScene) -> None:
    s = await (await scene()).read()

    def counted(count: int) -> bool:
        return bool(s.known.junk == count)

    for count, fields in enumerate(HOSTILE, 1):
        s.peer.junk(**fields)
        await s.until(partial(counted, count), f"{count} of junk, with {fields}")
        assert set(await s.values()) == set(HOME), fields
        assert (s.known.complete, s.known.count) == (True, 4), fields


async def test_a_name_of_its_own_for_every_frame_does_not_fill_the_memory(scene: StartScene) -> None:
    s = await (await scene()).read()
    for i in range(300):
        s.peer.junk(param_id=f"J{i}", param_index=i % 4, param_count=4 + i % 3)
        if i % 20 == 0:
            await asyncio.sleep(0.01)
    s.peer.junk(param_type=0)
    await s.until(lambda: s.known.junk > 0, "end of it")
    assert len(s.known.entries) < 30
    await s.b.ground.do("param_refresh")
    assert set(await s.values()) == set(HOME)


async def test_not_a_number_has_no_value(scene: StartScene) -> None:
    s = await (await scene({"NAN": (float("nan"), REAL32), "ODD": (float("inf"), INT32)})).read()
    assert await s.values() == {"NAN": None, "ODD": None}


async def test_closing_in_the_middle_of_a_download(scene: StartScene, onboard: StartOnboard) -> None:
    s = await scene(many(30), lambda peer: setattr(peer, "stop_at", 3))
    await s.peer.until(lambda: s.peer.lists() > 0, "download")
    reading = s.b.vehicle.params._reading
    assert reading is not None
    await onboard.close(s.b.vehicle)
    await asyncio.wait({reading})
    assert reading.cancelled()
