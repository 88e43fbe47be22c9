"""The key space over HTTP: queries answered, and the last frames."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest
import zenoh

from zmav import keys, wire
from zmav.mavlink import encode, load_dialect

if TYPE_CHECKING:
    from tests.ground.http.conftest import Serve, Served

PARAM = {"name": "RTL_ALT", "value": 1500.0}


@pytest.fixture(scope="module")
def answering(served: Served) -> Iterator[Served]:
    """quad1 answers for a parameter, refuses another, and would take any order it is asked."""
    orders: list[str] = []
    session, param = served.session, keys.PARAM.key("demo", "quad1", param="*")

    def on_param(query: zenoh.Query) -> None:
        with query:
            if str(query.key_expr).endswith("/NOPE"):
                error = wire.ErrorBody(code="bad_input", message="no parameter NOPE", detail={"field": "name"})
                query.reply_err(wire.encode(error))
            else:
                query.reply(keys.PARAM.key("demo", "quad1", param="RTL_ALT"), json.dumps(PARAM))

    def on_order(query: zenoh.Query) -> None:
        with query:
            orders.append(str(query.key_expr))

    declared = [
        session.declare_queryable(param, on_param),
        session.declare_queryable(keys.DO.key("demo", "quad1", verb="*"), on_order),
    ]
    yield served
    assert not orders, f"asking must never be ordering: {orders}"
    for queryable in declared:
        queryable.undeclare()


def test_a_query_is_answered_with_its_key_and_its_value(answering: Served) -> None:
    for path in ("/keys/quad1/param/RTL_ALT", "/keys/zmav/demo/quad1/param/RTL_ALT", "/keys/*/param/*"):
        reply = answering.get(path)
        assert reply.status == 200
        (found,) = reply.json
        assert found["key"] == "zmav/demo/quad1/param/RTL_ALT"
        assert found["value"] == PARAM
        assert abs(found["t"] - time.time()) < 60.0
        assert reply.headers["cache-control"] == "no-store"


def test_an_error_reply_is_in_the_list_and_decides_the_status(answering: Served) -> None:
    reply = answering.get("/keys/quad1/param/NOPE")
    assert reply.status == 400
    (found,) = reply.json
    assert found["key"] == "zmav/demo/quad1/param/NOPE"
    assert found["error"] == {"field": "name", "kind": "bad_input", "text": "no parameter NOPE"}


def test_what_nobody_answers_for_is_404_and_says_who_is_there(answering: Served) -> None:
    reply = answering.get("/keys/quad7/param/RTL_ALT", timeout=0.2)
    assert reply.status == 404
    assert "quad1, quad2" in reply.json["error"]["text"]
    nothing = answering.get("/keys/quad7*/param/*", timeout=0.2)
    assert (nothing.status, nothing.json) == (200, [])


def test_the_last_frames_are_given_decoded(served: Served) -> None:
    served.hear("ATTITUDE", roll=0.5, time_boot_ms=1, pitch=0, yaw=0, rollspeed=0, pitchspeed=0, yawspeed=0)
    served.hear("SYSTEM_TIME", time_unix_usec=5, time_boot_ms=6)
    (found,) = served.get("/keys/quad*/ATTITUDE").json
    assert found["key"] == "zmav/demo/quad1/mav/rx/1/1/ATTITUDE"
    assert (found["value"]["name"], found["value"]["fields"]["roll"]) == ("ATTITUDE", 0.5)
    every = [each["key"].rpartition("/")[2] for each in served.get("/keys/zmav/demo/quad1/mav/rx/**").json]
    assert every == sorted(every) and {"ATTITUDE", "SYSTEM_TIME"} <= set(every)
    served.hear_raw("zmav/demo/quad1/mav/rx/1/1/SYSTEM_TIME", b"no frame")
    (broken,) = served.get("/keys/quad1/SYSTEM_TIME").json
    assert broken["value"]["hex"] == b"no frame".hex()
    assert "frame" in broken["value"]["error"]


def test_a_message_that_nobody_read_is_asked_for_and_waited_for(served: Served) -> None:
    """The vehicle sends VFR_HUD as soon as it sees that somebody wants it."""
    fields = {"airspeed": 9.0, "groundspeed": 8.0, "heading": 7, "throttle": 6, "alt": 5.0, "climb": 4.0}
    frame = encode(load_dialect(), "VFR_HUD", fields, sysid=1, compid=1, seq=1)
    key = keys.RX.key("demo", "quad1", sys=1, comp=1, msg="VFR_HUD")
    served.linked(key)
    pattern = keys.WANT.key("demo", "quad1", msg="VFR_HUD", hz="*", instance="*")
    watch = served.session.liveliness().declare_subscriber(pattern, lambda token: served.session.put(key, frame))
    (found,) = served.get("/keys/quad1/VFR_HUD", timeout=30).json
    assert found["value"]["fields"]["airspeed"] == 9.0
    watch.undeclare()


@pytest.mark.parametrize("key", ["@/**", "@/*/*", "@/*/router/linkstate/north", "@/abc/router/**"])
def test_routers_are_asked_for_their_links_and_for_nothing_else(answering: Served, key: str) -> None:
    """Zenoh pull request 2619: another question can stop a router for good."""
    assert answering.get(f"/keys/{key}").status == 403
    assert answering.get("/keys/@/*/router").json[0]["value"]["zid"]


@pytest.mark.parametrize("key", ["quad1/do/land", "zmav/demo/quad1/do/hold", "quad1/do/*", "*/do/arm"])
def test_asking_for_an_order_is_refused(answering: Served, key: str) -> None:
    reply = answering.get(f"/keys/{key}")
    assert reply.status == 403
    assert "POST" in reply.json["error"]["text"]


@pytest.mark.parametrize(
    ("path", "field"),
    [
        ("/keys/quad1//state", "key"),
        ("/keys/quad1/%23", "key"),
        ("/keys/quad1?timeout=soon", "timeout"),
        ("/keys/quad1?timeout=0", "timeout"),
        ("/keys/quad1?timeout=nan", "timeout"),
    ],
)
def test_bad_questions_name_what_is_wrong(served: Served, path: str, field: str) -> None:
    reply = served.request("GET", path)
    assert reply.status == 400
    assert reply.json["error"]["field"] == field


def test_a_time_that_is_none_is_told_with_its_unit(served: Served) -> None:
    reply = served.request("GET", "/keys/quad1?timeout=soon")
    assert "expected a number above 0, at most 60 s" in reply.json["error"]["text"]


def test_keys_are_read_alone(served: Served) -> None:
    for method in ("PUT", "POST"):
        assert served.request(method, "/keys/quad1/mav/tx/1/1/SET_MODE", "{}").status == 405
    assert not served.tx


def test_a_gateway_that_only_reads_puts_nothing(serve: Serve, served: Served) -> None:
    served.gateway  # noqa: B018  the module's gateway writes; this one shares nothing with it
    from ground.http.guard import Rules

    reading = serve(Rules(read_only=True))
    assert reading.get("/do/quad1/hold").status == 403
    assert reading.post("/keys/quad1/do/hold").status == 403
    assert reading.get("/setpoint/quad1", n=1, e=2, d=-3).status == 403
