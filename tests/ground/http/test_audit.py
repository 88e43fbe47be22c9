"""Every order through the gateway is told with its outcome, for the recording too, and waits for none of it."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import pytest
import zenoh

from ground.http.audit import Audit, Audited
from tests.ground.http.browser import FakePlanner, Fleet
from zmav import keys, wire
from zmav.errors import Refused

if TYPE_CHECKING:
    from tests.ground.http.conftest import Serve, Served

KEY = keys.FLEET.key("demo", topic=keys.ORDERED)
AREA = [[0, 0], [100, 0], [100, 80]]


class Heard:
    """The lines as they come on the key."""

    def __init__(self, served: Served) -> None:
        self.lines: list[wire.OrderLine] = []
        self._subscriber = served.session.declare_subscriber(KEY, self._on)

    def _on(self, sample: zenoh.Sample) -> None:
        self.lines.append(wire.decode(sample.payload.to_bytes(), wire.OrderLine, KEY))

    def line(self, verb: str, outcome: str = "") -> wire.OrderLine:
        """The last one of that verb, once its outcome holds these words."""
        deadline = time.monotonic() + 10.0
        while time.monotonic() < deadline:
            if found := [line for line in self.lines if line.verb == verb and outcome in line.outcome]:
                return found[-1]
            time.sleep(0.02)
        raise AssertionError(f"no {verb} in {[line.verb for line in self.lines]}")


@pytest.fixture(scope="module")
def served(serve: Serve) -> Iterator[Served]:
    served = serve()
    fleet = Fleet(served)
    served.vehicle("quad1", 1)
    served.vehicle("quad2", 2)
    yield served
    fleet.close()


@pytest.fixture(scope="module")
def listening(served: Served) -> Heard:
    heard = Heard(served)
    served.post("/do/quad1/reboot", {})
    for _ in range(100):
        if heard.lines:
            return heard
        time.sleep(0.1)
        served.post("/do/quad1/reboot", {})
    raise AssertionError("nothing is told")


@pytest.fixture
def heard(listening: Heard) -> Heard:
    """Since the test began."""
    listening.lines.clear()
    return listening


def test_who_from_where_what_to_whom_and_how_it_ended(served: Served, heard: Heard) -> None:
    assert served.post("/do/quad1/takeoff?as=anna", {"alt_rel": 12}).status == 200
    line = heard.line("do/takeoff")
    assert (line.who, line.source, line.vehicles, line.outcome) == ("anna", "127.0.0.1", ["quad1"], "done")
    assert json.loads(line.args) == {"alt_rel": 12}
    assert abs(line.t - time.time()) < 10.0
    (shown,) = [each for each in served.get("/orders").json if each["verb"] == "do/takeoff"]
    assert shown["who"] == "anna"


def test_what_is_refused_is_told_with_the_reason(served: Served, heard: Heard) -> None:
    assert served.post("/do/quad1/dance", {}).status == 400
    assert heard.line("do/dance").outcome.startswith("400: no order 'dance'")
    assert served.post("/do/quad1/takeoff", {"alt_rel": "high"}).status == 400
    assert heard.line("do/takeoff").outcome.startswith("400: ") and "alt_rel" in heard.line("do/takeoff").outcome


def test_an_order_to_several_is_told_vehicle_by_vehicle(served: Served, heard: Heard) -> None:
    assert served.post("/fleet/hold", {"vehicles": ["quad*"]}).status == 200
    line = heard.line("fleet/hold")
    assert line.vehicles == ["quad*"] and line.outcome == "quad1 done, quad2 done"


def test_a_frame_is_told_by_its_name(served: Served, heard: Heard) -> None:
    fields = "chan1_raw=1500&" + "&".join(f"chan{n}_raw=0" for n in range(2, 9))
    assert served.get(f"/send/1/1/RC_CHANNELS_OVERRIDE?{fields}").status == 200
    assert heard.line("frame/RC_CHANNELS_OVERRIDE").vehicles == ["quad1"]


def test_a_survey_is_given_as_a_verb_and_its_preview_is_no_order(served: Served, heard: Heard) -> None:
    planner = FakePlanner(served)
    try:
        goal = {"vehicles": ["quad1"], "polygon": AREA, "height": 40, "camera": [1.5, 1.0]}
        shown = served.post("/swarm/survey", {**goal, "preview": True})
        assert shown.status == 200 and shown.json["result"]["makespan"] == 6.0
        given = served.post("/swarm/survey", goal)
        assert given.status == 200 and given.json["result"]["goal"] == "g1"
        verb, asked = planner.asked[-1]
        assert verb == "submit" and asked["goal"]["kind"] == "survey" and asked["goal"]["front"] == 0.75
        line = heard.line("swarm/survey")
        assert line.vehicles == ["quad1"] and line.outcome == "done"
        assert len([each for each in heard.lines if each.verb == "swarm/survey"]) == 1
        assert served.post("/swarm/survey", {**goal, "camera": [1.5]}).status == 400
        assert served.post("/swarm/survey", {**goal, "hight": 3}).status == 400
        heard.line("swarm/survey", "hight")
    finally:
        planner.close()


def test_what_only_looks_is_no_order(served: Served, heard: Heard) -> None:
    served.get("/vehicles")
    served.get("/orders")
    served.post("/do/quad1/ping", {})
    heard.line("do/ping")
    assert not [line for line in heard.lines if line.verb not in ("do/ping",)]


def test_the_same_again_is_counted(served: Served, heard: Heard) -> None:
    for _ in range(20):
        served.post("/do/quad2/hold", {})
    time.sleep(1.1)
    served.post("/do/quad2/hold", {})
    until = time.monotonic() + 10.0
    while time.monotonic() < until and sum(1 + line.more for line in heard.lines if line.verb == "do/hold") < 21:
        time.sleep(0.05)
    told = [line for line in heard.lines if line.verb == "do/hold"]
    assert len(told) < 21
    assert sum(1 + line.more for line in told) == 21


def test_that_an_order_is_under_way_is_told_once(served: Served, heard: Heard) -> None:
    async def told() -> None:
        for _ in range(5):
            await asyncio.sleep(1.1)
            served.gateway.audit.say("do/arm", ["quad1"], '{"id": "7"}', "running")
        served.gateway.audit.say("do/arm", ["quad1"], '{"id": "7"}', "done")

    served.call(told())
    heard.line("do/arm")
    until = time.monotonic() + 10.0
    while time.monotonic() < until and heard.line("do/arm").outcome != "done":
        time.sleep(0.05)
    assert [line.outcome for line in heard.lines if line.verb == "do/arm"] == ["running", "done"]


def test_a_recorder_s_trouble_is_no_order_s(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise Refused("no room")

    monkeypatch.setattr(served.gateway.audit.client, "put", refuse)
    assert served.post("/do/quad1/land", {}).status == 200


def test_nothing_is_told_before_the_answer_is_on_its_way() -> None:
    """A panic order waits for no line."""
    steps: list[str] = []

    class Slow(Audit):
        def __init__(self) -> None:
            pass

        def say(self, *_: Any, **__: Any) -> None:
            steps.append("told")

    async def app(scope: Any, receive: Any, send: Any) -> None:
        await receive()
        steps.append("ordered")
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body", "body": b'{"status": "done"}'})

    async def receive() -> Any:
        return {"type": "http.request", "body": b"\xff not JSON"}

    async def send(message: Any) -> None:
        steps.append(message["type"])

    scope = {"type": "http", "path": "/do/quad1/hold", "query_string": b"", "client": None}
    asyncio.run(Audited(app, Slow())(scope, receive, send))
    assert steps == ["ordered", "http.response.start", "http.response.body", "told"]


def test_a_body_that_comes_in_pieces_is_told_whole() -> None:
    told: list[list[str]] = []

    class Told(Audit):
        def __init__(self) -> None:
            pass

        def say(self, verb: str, vehicles: list[str], *_: Any, **__: Any) -> None:
            told.append(vehicles)

    pieces = [b'{"vehicles": ["quad', b'2"]}']

    async def app(scope: Any, receive: Any, send: Any) -> None:
        while (await receive())["more_body"]:
            pass

    async def receive() -> Any:
        return {"type": "http.request", "body": pieces.pop(0), "more_body": bool(pieces)}

    async def send(message: Any) -> None:
        pass

    scope = {"type": "http", "path": "/fleet/land", "query_string": b"", "client": None}
    asyncio.run(Audited(app, Told())(scope, receive, send))
    assert told == [["quad2"]]
