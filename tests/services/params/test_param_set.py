"""Parameters set one by one and many at once: read back, refused, lost, and beside a download."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import TYPE_CHECKING, Any

import pytest

from tests.services.params.param_peer import HOME, INT8, INT32, REAL32, many, scenes
from zmav import wire
from zmav.errors import BadInput, Refused, Stale, TimedOut, Unsupported
from zmav.services.params import requests

if TYPE_CHECKING:
    from tests.services.conftest import StartBench, Told
    from tests.services.params.param_peer import StartScene


@pytest.fixture
async def scene(bench: StartBench) -> AsyncIterator[StartScene]:
    async with scenes(bench) as start:
        yield start


async def test_a_set_is_read_back(scene: StartScene) -> None:
    s = await (await scene()).read()
    outcome = await s.b.ground.do("param_set", name="WPNAV_SPEED", value=750.5)
    assert outcome.result == {"name": "WPNAV_SPEED", "value": 750.5, "before": 1000.0}
    assert s.peer.params["WPNAV_SPEED"][0] == 750.5
    (told,) = s.peer.heard("PARAM_SET")
    assert (told.fields["param_type"], told.fields["target_component"]) == (REAL32, 1)
    assert (await s.get("WPNAV_SPEED")).value == 750.5


@pytest.mark.parametrize(("value", "shown"), [(0.1, 0.1), (1 / 3, 0.33333334), (1e-7, 1e-7), (16777217.0, 16777216.0)])
async def test_floats_are_compared_and_shown_as_they_travel(scene: StartScene, value: float, shown: float) -> None:
    s = await (await scene()).read()
    assert (await s.b.ground.do("param_set", name="WPNAV_SPEED", value=value)).result["value"] == shown
    assert (await s.get("WPNAV_SPEED")).value == shown


async def test_a_whole_number_written_as_a_float_is_an_integer(scene: StartScene) -> None:
    s = await (await scene()).read()
    assert (await s.b.ground.do("param_set", name="RTL_ALT", value=1800.0)).result["value"] == 1800


UNFIT: list[tuple[str, float, str]] = [
    ("RTL_ALT", 1.5, "RTL_ALT is INT32 and takes integers; 1.5 is none"),
    ("RTL_ALT", 2**31, "cannot hold 2147483648"),
    ("RTL_ALT", 2**24 + 1, "cannot hold 16777217; 16777216 is near"),
    ("FRAME", 128, "FRAME is INT8 and cannot hold 128"),
    ("FRAME", -129, "cannot hold -129"),
    ("WPNAV_SPEED", 3.5e38, "beyond a 32-bit float"),
    ("WPNAV_SPEED", 10**400, "beyond a 32-bit float"),
    ("RTL_ALT", -(10**400), "cannot hold -0x"),
    ("", 1, "cannot be a parameter's name"),
    ("A" * 17, 1, "cannot be a parameter's name"),
    ("WPNAV_*", 1, "cannot be a parameter's name"),
    ("WPNAV_SPED", 1, "did you mean WPNAV_SPEED"),
]


async def test_what_does_not_fit_is_refused_before_it_is_sent(scene: StartScene, subtests: pytest.Subtests) -> None:
    s = await (await scene()).read()
    for name, value, words in UNFIT:
        with subtests.test(name=name, value=value), pytest.raises(BadInput, match=words):
            await s.b.ground.do("param_set", name=name, value=value)
    for payload in (b'{"name":"RTL_ALT","value":NaN}', b'{"name":"RTL_ALT","value":"5"}', b'{"value":1}'):
        with subtests.test(payload=payload), pytest.raises(BadInput):
            await s.b.ground.do("param_set", payload)
    assert s.peer.heard("PARAM_SET") == []


async def test_a_signalling_nan_is_not_sent_as_another_integer(scene: StartScene) -> None:
    s = await (await scene({"BITS": (1, INT32)}, autopilot=12)).read()
    assert (await s.b.ground.do("param_set", name="BITS", value=-1)).result["value"] == -1
    with pytest.raises(Unsupported, match="signalling NaN"):
        await s.b.ground.do("param_set", name="BITS", value=-5_000_000)


async def test_a_clipped_value_names_both(scene: StartScene) -> None:
    s = await (await scene(prepare=lambda peer: peer.clip.update(WPNAV_SPEED=2000.0))).read()
    with pytest.raises(Refused, match=r"it is 2000\.0 after it was set to 5000") as caught:
        await s.b.ground.do("param_set", name="WPNAV_SPEED", value=5000)
    assert (caught.value.detail["value"], len(s.peer.heard("PARAM_SET"))) == (2000.0, 1)
    assert (await s.get("WPNAV_SPEED")).value == 2000.0


async def test_a_read_only_one_is_refused_with_the_autopilot_s_words(scene: StartScene) -> None:
    s = await (await scene(prepare=lambda peer: peer.clip.update(RTL_ALT=1500.0))).read()
    answer = s.peer.on_told

    def deny(told: Told) -> None:
        if told.name == "PARAM_SET":
            s.peer.send("STATUSTEXT", severity=4, text="Param write denied (RTL_ALT)")
            s.peer.send("STATUSTEXT", severity=6, text="EKF3 IMU0 is using GPS")
        answer(told)

    s.peer.on_told = deny
    with pytest.raises(Refused, match="it is 1500 after it was set to 1600") as caught:
        await s.b.ground.do("param_set", name="RTL_ALT", value=1600)
    assert set(caught.value.detail["reasons"]) == {"Param write denied (RTL_ALT)"}


@pytest.mark.parametrize(("error", "word"), [(2, "VALUE_OUT_OF_RANGE"), (5, "READ_ONLY"), (99, "99")])
async def test_param_error_is_understood(scene: StartScene, error: int, word: str) -> None:
    s = await (await scene(prepare=lambda peer: peer.deaf.add("PARAM_SET"))).read()

    def refuse(told: Told) -> None:
        if told.name == "PARAM_SET":
            system, component = told.source
            for other in (77, system):
                fields = {"target_system": other, "target_component": component, "param_index": -1}
                s.peer.send("PARAM_ERROR", param_id="RTL_ALT", error=error if other == system else 1, **fields)

    s.peer.on_told = refuse
    with pytest.raises(Refused, match=f"PARAM_ERROR {word}"):
        await s.b.ground.do("param_set", name="RTL_ALT", value=1600)


async def test_lost_answers_cost_a_retry(scene: StartScene) -> None:
    s = await (await scene(prepare=lambda peer: peer.deaf.add("PARAM_SET"))).read()
    order = asyncio.create_task(s.b.ground.do("param_set", name="RTL_ALT", value=1600))
    await s.peer.count("PARAM_SET", 2)
    s.peer.deaf.clear()
    assert (await order).result["value"] == 1600
    assert len(s.peer.heard("PARAM_SET")) == 3


async def test_no_answer_at_all(scene: StartScene) -> None:
    s = await (await scene(prepare=lambda peer: peer.deaf.add("PARAM_SET"))).read()
    s.b.vehicle.params.talk.longest_wait = 0.03
    with pytest.raises(TimedOut, match=f"after {requests.SET_TRIES} PARAM_SETs"):
        await s.b.ground.do("param_set", name="RTL_ALT", value=1600)
    assert len(s.peer.heard("PARAM_SET")) == requests.SET_TRIES


async def test_a_silent_autopilot_is_not_asked(scene: StartScene) -> None:
    s = await (await scene()).read()
    s.b.vehicle.identity.heartbeat_timeout = 1.0
    s.peer.beating = False
    await s.b.state(lambda state: not state["connected"], "silence")
    for verb, args in (("param_set", {"name": "FRAME", "value": 2}), ("param_load", {"values": {"FRAME": 2}})):
        with pytest.raises(Stale, match="silent"):
            await s.b.ground.do(verb, **args)
    with pytest.raises(Stale):
        await s.b.ground.do("param_refresh")


async def test_a_hidden_parameter_can_be_set_by_its_name(scene: StartScene) -> None:
    s = await (await scene(prepare=lambda peer: peer.hidden.update(FENCE_ALT=(100.0, REAL32)))).read()
    assert (await s.b.ground.do("param_set", name="FENCE_ALT", value=120)).result["before"] == 100.0
    assert s.peer.hidden["FENCE_ALT"][0] == 120.0
    assert "FENCE_ALT" not in await s.values()


async def test_set_while_a_download_runs(scene: StartScene) -> None:
    """The old value comes by the stream after the new one was sent: it is no refusal."""
    s = await (await scene(many(10))).read()
    s.peer.deaf.add("PARAM_SET")
    order = asyncio.create_task(s.b.ground.do("param_set", name="P_0003", value=33))
    await s.peer.count("PARAM_SET", 1)
    s.peer.value("P_0003", 3)
    s.peer.deaf.clear()
    assert (await order).result["value"] == 33.0
    s.peer.stop_at = 5
    refresh = asyncio.create_task(s.b.ground.do("param_refresh"))
    await s.peer.until(lambda: s.peer.lists() == 2, "second download")
    assert (await s.b.ground.do("param_set", name="P_0008", value=88)).result["value"] == 88.0
    assert (await refresh).result["count"] == 10
    assert (await s.values())["P_0008"] == 88.0


async def test_two_who_set_the_same_do_so_one_after_the_other(scene: StartScene) -> None:
    s = await (await scene()).read()
    orders = (s.b.ground.do("param_set", name="RTL_ALT", value=value) for value in (1600, 1700))
    both = await asyncio.gather(*orders)
    assert [outcome.result["value"] for outcome in both] == [1600, 1700]


# Many.


async def test_load_sets_what_differs_and_names_what_failed(scene: StartScene) -> None:
    s = await (await scene(prepare=lambda peer: peer.clip.update(FRAME=1))).read()
    values = {"RTL_ALT": 1600, "WPNAV_SPEED": 1000.0, "WPNAV_ACCEL": 250, "FRAME": 2, "NOPE": 1, "bad name": 2}
    result = (await s.b.ground.do("param_load", values=values)).result
    assert result["set"] == ["RTL_ALT"]
    assert sorted(result["unchanged"]) == ["WPNAV_ACCEL", "WPNAV_SPEED"]
    assert sorted(result["failed"]) == ["FRAME", "NOPE", "bad name"]
    assert "it is 1 after it was set to 2" in result["failed"]["FRAME"]
    assert {told.fields["param_id"] for told in s.peer.heard("PARAM_SET")} == {"RTL_ALT", "FRAME"}


async def test_load_enables_a_group_and_sets_what_is_in_it(scene: StartScene) -> None:
    s = await (await scene({**HOME, "FENCE_ENABLE": (0, INT8)})).read()
    s.b.vehicle.params.talk.read_tries = 1  # asked for before it is enabled, it is not there
    answer = s.peer.on_told

    def enable(told: Told) -> None:
        if told.name == "PARAM_SET" and told.fields["param_id"] == "FENCE_ENABLE":
            s.peer.params["FENCE_ALT"] = (100.0, REAL32)
        answer(told)

    s.peer.on_told = enable
    result = (await s.b.ground.do("param_load", values={"FENCE_ALT": 50, "FENCE_ENABLE": 1})).result
    assert (result["set"], result["failed"]) == (["FENCE_ENABLE", "FENCE_ALT"], {})
    assert s.peer.params["FENCE_ALT"][0] == 50.0


async def test_load_of_many_over_a_bad_link_reports_progress(scene: StartScene) -> None:
    s = await (await scene(many(60))).read()
    answer, turn = s.peer.on_told, iter(range(10**6))
    s.peer.on_told = lambda told: answer(told) if told.name != "PARAM_SET" or next(turn) % 3 else None
    values = {name: value + 0.5 for name, (value, _) in s.peer.params.items()}
    news: list[dict[str, Any]] = []
    load = s.b.vehicle.params.load
    result = await load(wire.ParamLoad(values=values), lambda each: news.append(dict(each)))
    assert (len(result["set"]), result["failed"]) == (60, {})
    assert (news[-1], s.peer.params["P_0059"][0]) == ({"done": 60, "of": 60}, 59.5)


async def test_load_stops_where_the_autopilot_falls_silent(scene: StartScene) -> None:
    s = await (await scene(many(30))).read()
    s.b.vehicle.identity.heartbeat_timeout = 1.0
    s.peer.deaf.add("PARAM_SET")
    load = asyncio.create_task(s.b.ground.do("param_load", values=dict.fromkeys(s.peer.params, -1)))
    await s.peer.count("PARAM_SET", 1)
    s.peer.beating = False
    result = (await load).result
    assert (len(result["failed"]), set(result["failed"].values())) == (30, {"the autopilot is silent"})


async def test_nothing_to_load(scene: StartScene) -> None:
    s = await (await scene()).read()
    with pytest.raises(BadInput, match="no values"):
        await s.b.ground.do("param_load", values={})
