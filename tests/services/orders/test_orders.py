"""``do/*``: wrong orders are answered with what is wrong, right ones are done once, and looking around does nothing."""

from __future__ import annotations

import asyncio
import json
from typing import TYPE_CHECKING, Any

import pytest

from zmav import keys
from zmav.errors import BadInput, Refused, Stale
from zmav.onboard import Onboard, OnboardSettings
from zmav.services.orders import orders

if TYPE_CHECKING:
    from tests.conftest import Net
    from tests.services.conftest import StartBench, StartPeer

ARM, SET_MODE, REQUEST_MESSAGE = 400, 176, 512
IN_PROGRESS, ACCEPTED = 5, 0

# verb, payload, the field that must be named, words of the message
WRONG = [
    ("arm", b"nonsense", "do/arm", "not JSON"),
    ("arm", b"\xff\xfe\x00", "do/arm", "not JSON"),
    ("arm", b'{"id": "\xff"}', "do/arm", "not JSON"),
    ("arm", b'{"ready_timeout": 1', "do/arm", "not JSON"),
    ("arm", b"[]", "Arm", "Expected `object`, got `array`"),
    ("arm", b"null", "Arm", "Expected `object`, got `null`"),
    ("arm", b'{"ready": 1}', "ready", "unknown field"),
    ("arm", b'{"ready_timeout": "soon"}', "ready_timeout", "Expected `float`, got `str`"),
    ("arm", b'{"id": 7}', "id", "Expected `str`, got `int`"),
    ("arm", b'{"ready_timeout": 1e999}', "ready_timeout", "out of range"),
    ("takeoff", b"", "alt_rel", "missing required field"),
    ("takeoff", b'{"alt_rel": {"m": 5}}', "alt_rel", "Expected `float`, got `object`"),
    ("takeoff", b'{"alt_rel": ' + b"[" * 5000, "alt_rel", "Expected `float`, got `array`"),
    ("takeoff", b'{"alt_rel": 5, "alt_rel": 500}', "alt_rel", "given twice"),
    ("takeoff", b'{"alt_rel": 5, "\\u0061lt_rel": 500}', "alt_rel", "given twice"),
    ("command", b'{"command": "DO_SET_ROI", "params": {"param1": 1, "param1": 2}}', "param1", "given twice"),
    ("hold", b'{"id": "%b"}' % (b"x" * orders.MOST_BYTES), "payload", "too much for an order"),
    ("takeoff", b'{"alt_rel": 0.1}', "alt_rel", "from 0.5 to 1000"),
    ("goto", b"{}", "pos", "needs a position"),
    ("goto", b'{"pos": [1, 2]}', "pos", "length 3"),
    ("goto", b'{"pos": [1, 2, "up"]}', "pos[2]", "Expected `float`, got `str`"),
    ("goto", b'{"pos": [0, 0, -5]}', "frame", "origin"),
    ("goto", b'{"frame": "enu", "pos": [0, 0, -5]}', "frame", "Invalid enum value 'enu'"),
    ("goto", b'{"frame": "global", "lat_deg": 91, "lon_deg": 0, "alt_rel": 5}', "lat_deg", "within"),
    ("goto", b'{"frame": "global", "lat_deg": 1, "lon_deg": 0}', "alt_rel", "one of alt_amsl and alt_rel"),
    ("goto", b'{"lat_deg": 1, "lon_deg": 0, "alt_rel": 5}', "lat_deg", "belongs to frame 'global'"),
    ("set_mode", b"{}", "mode", "missing required field"),
    ("set_mode", b'{"mode": "WARP"}', "mode", "no mode 'WARP'"),
    ("lease", b'{"ttl": 3}', "holder", "missing required field"),
    ("lease", b'{"holder": "a", "ttl": 0}', "ttl", "ttl from 0.1"),
    ("hold", b'{"alt_rel": 5}', "alt_rel", "unknown field"),
    ("explode", b"{}", "verb", "no order 'explode'; there are arm, camera_trigger, command, disarm"),
    ("ARM", b"{}", "verb", "no order 'ARM'"),
]


async def test_wrong_orders_name_the_field(bench: StartBench) -> None:
    b = await (await bench()).connected()
    for verb, payload, field, words in WRONG:
        with pytest.raises(BadInput) as e:
            await b.ground.do(verb, payload)
        assert e.value.detail["field"] == field, (verb, payload)
        assert words in e.value.message, (verb, payload, e.value.message)
        assert "expected" in e.value.detail or "value" in e.value.detail
    assert b.peer.commands(ARM) == b.peer.commands(SET_MODE) == []
    assert (await b.ground.do("ping")).status == "done"


async def test_a_selectors_parameters_are_refused_but_keep_nobody_from_making_it_safe(bench: StartBench) -> None:
    b = await (await bench()).connected()
    told = {}
    for verb in ("takeoff", "ping", "hold"):
        (reply,) = await b.ground.ask(f"{keys.DO.key('demo', 'quad1', verb=verb)}?alt_rel=5", b"{}")
        told[verb] = "" if reply.err is None else reply.err.payload.to_string()
    assert "parameter 'alt_rel' is not read" in told["takeoff"]
    assert "parameter 'alt_rel' is not read" in told["ping"]
    assert "parameter" not in told["hold"]


async def test_an_order_is_done_once_however_often_it_is_sent(bench: StartBench) -> None:
    b = await (await bench()).connected()
    b.peer.results[ARM] = [IN_PROGRESS]
    order = json.dumps({"id": "one", "ready_timeout": 0, "wait": 0.05}).encode()
    first = await asyncio.gather(*(b.ground.do("arm", order) for _ in range(5)))
    assert {(o.verb, o.status) for o in first} == {("arm", "running")}
    while not b.peer.commands(ARM):  # first it hears which mode the autopilot is in
        await asyncio.sleep(0.01)
    b.peer.obey(ARM, {"param1": 1})
    b.peer.acknowledge(ARM, ACCEPTED)
    await b.state(lambda s: s["armed"], "arming")
    patient = json.dumps({"id": "one", "ready_timeout": 0, "wait": 0.05}).encode()
    outcome = first[0]
    while outcome.status == "running":
        outcome = await b.ground.do("arm", patient)
    assert outcome.result == {"armed": True}
    # Somebody who asks late is told how it ended; nothing is done again.
    b.peer.armed = False
    await b.state(lambda s: s["armed"] is False, "disarming")
    late = await b.ground.do("arm", order)
    assert (late.status, late.result, late.took) == ("done", {"armed": True}, outcome.took)
    assert len(b.peer.commands(ARM)) == 1


async def test_a_failure_is_kept_too(bench: StartBench) -> None:
    b = await (await bench()).connected()
    b.peer.results[ARM] = [4]
    order = json.dumps({"id": "bad", "ready_timeout": 0, "wait": 5}).encode()
    for _ in range(3):
        with pytest.raises(Refused, match="FAILED"):
            await b.ground.do("arm", order)
    assert len(b.peer.commands(ARM)) == 1


@pytest.mark.parametrize(
    ("verb", "again"),
    [("disarm", {"id": "x"}), ("arm", {"id": "x", "ready_timeout": 1.0})],
    ids=["another verb", "other arguments"],
)
async def test_an_id_is_for_one_order(bench: StartBench, verb: str, again: dict[str, Any]) -> None:
    b = await (await bench()).connected()
    assert (await b.ground.do("arm", id="x", ready_timeout=0, wait=5)).status == "done"
    with pytest.raises(BadInput, match="id 'x' was used for another order") as e:
        await b.ground.do(verb, **again)
    assert e.value.detail["field"] == "id"
    assert len(b.peer.commands(ARM)) == 1


async def test_orders_without_an_id_are_each_done(bench: StartBench) -> None:
    b = await (await bench()).connected()
    for _ in range(3):
        assert (await b.ground.do("disarm")).result == {"armed": False}
    assert len(b.peer.commands(ARM)) == 3


async def test_progress_is_told_while_it_runs(bench: StartBench) -> None:
    b = await (await bench()).connected()
    outcome = await b.ground.do("arm", id="w", wait=0.3)
    assert outcome.status == "running"
    assert outcome.result["waiting_for"] == ["EKF has no position estimate", "SYS_STATUS not heard"]
    with pytest.raises(Refused, match="not ready to arm: EKF has no position estimate, SYS_STATUS not heard"):
        await b.ground.do("arm", id="v", ready_timeout=0.3, wait=5)
    assert b.peer.commands(ARM) == []


async def test_looking_around_with_wildcards_triggers_nothing(bench: StartBench) -> None:
    b = await (await bench()).connected()
    before = len(b.peer.told)
    for wild in (
        "zmav/**",
        "zmav/demo/quad1/do/*",
        "zmav/*/*/do/disarm",
        "zmav/demo/quad1/do/dis*m".replace("*", "$*"),
    ):
        replies = await b.ground.ask(wild)
        assert [r for r in replies if r.ok is None] == []
        assert not [str(r.ok.key_expr) for r in replies if r.ok is not None and "/do/" in str(r.ok.key_expr)]
    assert (await b.ground.do("ping")).status == "done"
    named = {t.name for t in b.peer.told[before:]}
    assert not b.peer.commands(ARM)
    by_itself = {"HEARTBEAT", "TIMESYNC", "PARAM_REQUEST_LIST"}  # the last again and again: this peer has no parameters
    assert named <= {*by_itself, "COMMAND_LONG"}
    assert {t.fields["command"] for t in b.peer.told[before:] if t.name == "COMMAND_LONG"} <= {511, 512}


async def test_orders_to_nobody(bench: StartBench, peer: StartPeer) -> None:
    one = await peer()
    one.beating = False
    b = await bench(one)
    await b.state(lambda s: s["link"] == "up", "link")
    for verb in ("arm", "hold", "land", "disarm"):
        with pytest.raises(Stale, match="no autopilot has been heard on udpout:"):
            await b.ground.do(verb)
    with pytest.raises(Stale, match="no autopilot has been heard on udpout:"):
        await b.ground.do("takeoff", alt_rel=5)
    one.beating = True
    await b.connected()
    one.beating = False
    await b.state(lambda s: not s["connected"], "silence")
    with pytest.raises(Stale, match="the autopilot is silent"):
        await b.ground.do("disarm")


async def test_a_running_order_is_answered_when_the_vehicle_closes(net: Net, peer: StartPeer) -> None:
    one, (session, endpoint) = await peer(), net.router()
    ground = net.ground(endpoint)
    one.results[ARM] = [IN_PROGRESS]
    async with Onboard(session, OnboardSettings(link=one.url, name="quad1")):
        await one.until(lambda: any(t.source == (1, 191) for t in one.heard("COMMAND_LONG")), "companion")
        asked = asyncio.create_task(ground.do("arm", ready_timeout=0))
        await one.until(lambda: bool(one.commands(ARM)), "order under way")
    with pytest.raises(Refused, match="superseded"):
        await asked


async def test_an_order_that_comes_as_the_vehicle_closes_is_not_begun(net: Net, peer: StartPeer) -> None:
    one, (session, endpoint) = await peer(), net.router()
    ground = net.ground(endpoint)
    async with Onboard(session, OnboardSettings(link=one.url, name="quad1")) as vehicle:
        await one.until(lambda: bool(one.commands(REQUEST_MESSAGE)), "companion")
        asked = [asyncio.create_task(ground.ask("zmav/demo/quad1/do/arm")) for _ in range(20)]
        await asyncio.sleep(0)
    done = await asyncio.gather(*asked)
    assert [reply for replies in done for reply in replies if reply.ok is not None] == []
    assert vehicle.orders.under_way == 0


async def test_an_order_whose_outcome_is_forgotten_is_not_done_again(
    bench: StartBench,
) -> None:
    """Its caller asks again after a long hole in the network: the vehicle must not take off once more."""
    b = await (await (await bench()).connected()).flying()
    b.vehicle.orders.operations.memory = 0.0
    await b.ground.do("set_mode", mode="LOITER", id="once", wait=5)
    told = len(b.peer.commands(SET_MODE))
    with pytest.raises(Refused, match=r"ended .* s ago"):
        await b.ground.do("set_mode", mode="LOITER", id="once", wait=5)
    assert len(b.peer.commands(SET_MODE)) == told


async def test_orders_without_end_take_no_memory_without_end(
    bench: StartBench,
) -> None:
    b = await (await bench()).connected()
    kept = b.vehicle.orders.operations
    kept.most_kept, kept.most_ids = 5, 10
    for number in range(30):
        await b.ground.do("ping", id=f"{number}", wait=5)
        await b.ground.do("ping")
    assert len([*kept]) <= 6
    with pytest.raises(Refused, match="ended"):
        await b.ground.do("ping", id="22", wait=5)
    assert (await b.ground.do("ping", id="14", wait=5)).status == "done", "its id is forgotten, too"
    with pytest.raises(BadInput, match="id"):
        await b.ground.do("ping", id="x" * 65)


async def test_what_became_of_an_order_is_asked_by_its_id_alone(bench: StartBench) -> None:
    b = await (await bench()).connected()
    with pytest.raises(Refused, match="no order arm has come with that id") as e:
        await b.ground.do("arm", json.dumps({"again": "x"}).encode())
    assert e.value.detail["reason"] == "unknown"
    assert (await b.ground.do("arm", id="x", ready_timeout=0, wait=5)).status == "done"
    assert (await b.ground.do("arm", json.dumps({"again": "x"}).encode())).result == {"armed": True}
    with pytest.raises(Refused, match="no order disarm has come"):
        await b.ground.do("disarm", json.dumps({"again": "x"}).encode())
    assert len(b.peer.commands(ARM)) == 1
