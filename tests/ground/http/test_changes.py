"""Messages that say only what changed, from the gateway to a page that puts them together again."""

from __future__ import annotations

import json
import time
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from websockets.sync.client import connect

from ground.http import changes
from ground.http.changes import Changes, changed, rounded
from tests.ground.http.browser import Fleet, Tab, card, pieces, show
from zmav import keys, wire

if TYPE_CHECKING:
    from tests.ground.http.conftest import Served

PATIENCE_S = 30.0
KEY = "zmav/demo/quad1/state"


def said(value: Any, t: float = 1.0) -> dict[str, Any]:
    return {"key": KEY, "t": t, "value": value, "alarms": []}


@pytest.mark.parametrize(
    ("before", "after", "wanted"),
    [
        ({"a": 1, "b": 2}, {"a": 1, "b": 3}, {"b": 3}),
        ({"a": 1}, {"a": 1, "b": None}, {"b": None}),
        ({"a": None}, {"a": {"b": 1}}, {"a": {"b": 1}}),
        ({"a": {"b": 1, "c": 2}}, {"a": {"b": 1, "c": 3}}, {"a": {"c": 3}}),
        ({"a": {"b": 1}}, {"a": None}, {"a": None}),
        ({"a": [1, 2]}, {"a": [1, 3]}, {"a": [1, 3]}),
        ({"a": [1, 2]}, {"a": [1, 2]}, {}),
        ({"a": 1, "b": 2}, {"a": 1}, None),
        ({"a": {"b": 1, "c": 2}}, {"a": {"b": 1}}, None),
    ],
)
def test_what_changed(before: dict[str, Any], after: dict[str, Any], wanted: dict[str, Any] | None) -> None:
    assert changed(before, after) == wanted


def test_figures_are_rounded_to_what_an_instrument_shows() -> None:
    raw = msgspec.Raw(b'{"lat_deg": -35.123456789, "alt": 1.23456, "local": [1.00049, 2], "t": 1790000000.123456}')
    assert rounded({"value": raw}) == {
        "value": {"lat_deg": -35.1234568, "alt": 1.235, "local": [1.0, 2], "t": 1790000000.123}
    }


def test_a_whole_one_comes_first_and_where_the_last_is_old() -> None:
    sent = Changes()
    assert sent.message(said({"a": 1, "b": {"c": 2}})) == {**said({"a": 1, "b": {"c": 2}}), "n": 0}
    second = sent.message(said({"a": 1, "b": {"c": 3}}, 2.0))
    assert second == {"key": KEY, "t": 2.0, "n": 1, "changes": {"value": {"b": {"c": 3}}}}
    assert sent.message(said({"a": 1}))["n"] == 0, "a field has gone"
    sent.forget(KEY)
    assert sent.message(said({"a": 1}))["n"] == 0
    sent.late = -1.0
    assert sent.message(said({"a": 1}))["n"] == 0
    sent.late = Changes.late
    assert sent.message(said({"a": 1}))["n"] == 1
    for number in range(changes.MOST):
        sent.message({**said({}), "key": f"zmav/demo/q{number}/state"})
    assert sent.message(said({"a": 1}))["n"] == 0, "invented keys do not fill the memory"


def test_a_client_gets_changes_and_asks_for_the_whole(served: Served) -> None:
    with connect(f"ws://127.0.0.1:{served.port}/ws", open_timeout=PATIENCE_S, proxy=None) as client:

        def told(wanted: str) -> dict[str, Any]:
            while wanted not in (found := json.loads(client.recv(PATIENCE_S))):
                pass
            return dict(found)

        client.send('{"subscribe": "quad1", "changes": true}')
        assert "subscribed" in told("subscribed")
        n = -1
        for charge in (0.99, 0.98, 0.97, 0.96, 0.95, 0.94):
            served.vehicle("quad1", 1, battery=wire.Battery(remaining=charge))
            found = told("key")
            assert (found["key"], found["n"]) in ((KEY, n + 1), (KEY, 0))
            n = found["n"]
            if n == 0:  # the first, or what a busy machine sent over two seconds after the one before
                assert found["value"]["battery"]["remaining"] == charge
            else:
                assert found["changes"]["value"].keys() == {"t", "battery"}
                assert found["changes"]["value"]["battery"] == {"remaining": charge}
            if n == 2:
                break
        assert n == 2
        client.send(json.dumps({"whole": KEY}))
        client.send('{"ping": 7}')
        assert told("pong") == {"pong": 7}
        served.vehicle("quad1", 1, battery=wire.Battery(remaining=charge))
        found = told("key")
        assert (found["n"], found["value"]["battery"]["remaining"]) == (0, charge)
        assert isinstance(found["alarms"], list)


def test_a_garbled_state_goes_as_it_came(served: Served) -> None:
    with connect(f"ws://127.0.0.1:{served.port}/ws", open_timeout=PATIENCE_S, proxy=None) as client:
        client.send('{"subscribe": "wreck", "changes": true}')
        json.loads(client.recv(PATIENCE_S))
        key = keys.STATE.key("demo", "wreck")
        served.linked(key)
        deep = b"[" * 700 + b"]" * 700
        wanted: list[Any] = [[1], 7, None, {"a": 1}, {"hex": "7b"}, {"hex": deep.hex()}, 8]
        for payload, value in zip((b"[1]", b"7", b"null", b'{"a": 1}', b"{", deep, b"8"), wanted, strict=True):
            served.session.put(key, payload)
            found = json.loads(client.recv(PATIENCE_S))
            assert found.get("changes", found).get("value") == value


@pytest.mark.asyncio(loop_scope="module")
async def test_a_page_that_missed_a_message_asks_again(tab: Tab, served: Served, fleet: Fleet) -> None:
    await show(tab, served)
    await pieces(tab)
    fleet.more["quad1"] = {"firmware": "4.7.0"}
    await tab.until("store.vehicles.get('demo/quad1').state.firmware === '4.7.0'")
    last = "link.wholes.last.get('zmav/demo/quad1/state')"
    await tab.until(f"{last}.n > 3")
    fleet.more["quad1"] = {"firmware": "4.8.0"}
    await tab.run(f"{last}.n -= 2")  # as if two had not come
    begun = time.monotonic()
    await tab.until("store.vehicles.get('demo/quad1').state.firmware === '4.8.0'")
    await tab.until(f"{last}.n < 10")
    assert time.monotonic() - begun < 10.0
    fleet.height = 33.3
    await tab.until(f"{card('quad1')}.innerText.includes('33.3 m')")
    assert await tab.run("store.vehicles.get('demo/quad1').state.kind") == "copter", "what did not change stays"
    assert not tab.said
