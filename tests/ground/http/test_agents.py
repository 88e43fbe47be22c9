"""Orders to agents over HTTP: any :class:`zmav.Agent` beside the gateway, tuned, asked, and refused what it refuses."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import pytest

import zmav
from ground.http.guard import Rules
from mesh.credentials.ca import Authority
from zmav import wire
from zmav.agent import Tunable
from zmav.errors import Refused
from zmav.session import SessionSettings
from zmav.trust.certificate import Role
from zmav.verbs import Access, Verb

if TYPE_CHECKING:
    from tests.ground.http.conftest import Serve, Served


class Count(wire.Order, kw_only=True):
    agent: str = ""
    """a name that the way there uses, too"""
    to: int = 0


class Counter(zmav.Agent):
    """Counts, as long as it is let."""

    name = "counter"
    tunables: ClassVar = {"gain": Tunable(1.0, 0.0, 5.0, "1/s", "how fast"), "roll.kp": Tunable(6.5, 0.0, 20.0)}
    verbs: ClassVar = {"count": Verb("count", Count, Access.CHANGE, "count up to a number")}
    go: asyncio.Event
    askers: list[str]

    async def on_count(self, args: Count, report: Any, origin: Any) -> dict[str, Any]:
        self.askers.append(origin.name if origin else "")
        if args.to < 0:
            raise Refused("it counts upwards only", field="to")
        report({"at": 1})
        await self.go.wait()
        return {"counted": args.to, "by": args.agent}


def started(served: Served, settings: SessionSettings) -> tuple[Counter, Any]:
    """The agent for quad1, in a client of its own on the gateway's loop, and what ends both."""

    async def start() -> tuple[Counter, zmav.Client]:
        z = await zmav.open(settings=settings).__aenter__()
        counter = Counter(z, "quad1")
        counter.go, counter.askers = asyncio.Event(), []
        counter.go.set()
        await counter.__aenter__()
        return counter, z

    counter, z = served.call(start())

    async def end() -> None:
        await counter.__aexit__(None, None, None)
        await z.__aexit__(None, None, None)

    return counter, end


@pytest.fixture(scope="module")
def counter(served: Served) -> Iterator[Counter]:
    found, end = started(served, SessionSettings(connect=[served.endpoint]))
    yield found
    served.call(end())


def test_an_agent_is_asked(served: Served, counter: Counter) -> None:
    reply = served.post("/agent/quad1/counter/count", {"to": 7, "agent": "ann"})
    assert (reply.status, reply.json["verb"], reply.json["status"]) == (200, "count", "done"), reply.text
    assert reply.json["result"] == {"counted": 7, "by": "ann"}
    form = served.post(
        "/agent/quad1/counter/set", "name=gain&value=2.5", content_type="application/x-www-form-urlencoded"
    )
    assert (form.status, counter["gain"]) == (200, 2.5), form.text
    assert served.post("/agent/quad1/counter/set?name=gain&value=1").json["result"] == {
        "name": "gain",
        "value": 1.0,
        "before": 2.5,
    }
    assert served.post("/agent/quad1/counter/params").json["result"]["gain"]["high"] == 5.0


def test_parameters_are_keys(served: Served, counter: Counter) -> None:
    served.post("/agent/quad1/counter/set", {"name": "roll.kp", "value": 7.25})
    (one,) = served.get("/keys/quad1/agent/counter/param/roll.kp").json
    assert one["value"] == {"value": 7.25, "default": 6.5, "low": 0.0, "high": 20.0, "unit": "", "doc": ""}
    every = served.get("/keys/quad1/agent/counter/param/*").json
    assert [each["key"].rpartition("/")[2] for each in every] == ["gain", "roll.kp"]
    assert served.get("/keys/quad1/agent/counter/param/mass", timeout=0.5).status == 404


def test_an_order_with_an_id_is_asked_after(served: Served, counter: Counter) -> None:
    counter.go.clear()
    order = {"id": "8", "wait": 0.05, "to": 3}
    first = served.post("/agent/quad1/counter/count", order)
    assert (first.status, first.json["status"], first.json["result"]) == (200, "running", {"at": 1}), first.text
    asked = len(counter.askers)
    served.loop.call_soon_threadsafe(counter.go.set)
    while (said := served.post("/agent/quad1/counter/count", order).json)["status"] == "running":
        pass
    assert said["result"]["counted"] == 3
    assert len(counter.askers) == asked, "it is done once"


@pytest.mark.parametrize(
    ("path", "body", "status", "words"),
    [
        ("/agent/quad1/counter/count", {"to": -1}, 409, "upwards"),
        ("/agent/quad1/counter/count", {"to": "many"}, 400, "to"),
        ("/agent/quad1/counter/count", "[1]", 400, "JSON object"),
        ("/agent/quad1/counter/sing", {}, 400, "count, params, set"),
        ("/agent/quad1/counter/set", {"name": "gain", "value": 6}, 400, "0 to 5 1/s"),
        ("/agent/quad1/counter/set", {"name": "mass", "value": 1}, 400, "mass"),
        ("/agent/quad1/counter/*", {}, 400, "lower-case"),
        ("/agent/quad1/*/count", {}, 400, "lower-case"),
        ("/agent/*/counter/count", {}, 400, "lower-case"),
        ("/agent/quad9/counter/count", {}, 404, "quad9"),
    ],
)
def test_what_cannot_be_done_is_named(
    served: Served, counter: Counter, path: str, body: Any, status: int, words: str
) -> None:
    reply = served.post(path, body)
    assert reply.status == status, reply.text
    assert words in reply.json["error"]["text"]
    assert counter["gain"] <= 5.0


def test_an_agent_that_is_not_there(served: Served, counter: Counter, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(zmav.Vehicle, "give_up", 0.3)
    reply = served.post("/agent/quad1/ev9/engage")
    assert (reply.status, reply.json["error"]["kind"]) == (504, "timed_out")
    assert "zmav agent run ev9 --vehicle quad1" in reply.json["error"]["text"]


def test_looking_gives_no_orders(served: Served, counter: Counter) -> None:
    asked = len(counter.askers)
    for key in ("quad1/agent/counter/do/count", "quad1/agent/*/do/count", "quad1/agent/counter/do/*", "*/swarm/goto"):
        assert served.get(f"/keys/{key}").status == 403
    assert served.get("/keys/quad1/agent/**").status == 200
    assert served.get("/agent/quad1/counter/count").status == 405
    put = served.request("PUT", "/keys/quad1/agent/counter/do/count", "{}")
    assert put.status == 405
    assert len(counter.askers) == asked


def test_the_door_is_that_of_every_order(serve: Serve, served: Served, counter: Counter) -> None:
    asked = len(counter.askers)
    crossed = served.post("/agent/quad1/counter/count", {"to": 1}, origin="http://elsewhere.example")
    assert (crossed.status, crossed.json["error"]["kind"]) == (403, "cross_site")
    for rules, status, kind in ((Rules(read_only=True), 403, "read_only"), (Rules(token="secret"), 401, "token")):
        door = serve(rules)
        for path in ("/agent/quad1/counter/count", "/keys/quad1/agent/counter/do/count"):
            reply = door.post(path, {"to": 1})
            assert (reply.status, reply.json["error"]["kind"]) == (status, kind)
    assert len(counter.askers) == asked


def test_orders_are_signed_and_judged_by_the_gateways_role(serve: Serve, tmp_path: Path) -> None:
    authority = Authority.create(tmp_path / "authority", "demo")
    folders = {
        name: authority.issue(name, role, out=tmp_path / name)
        for name, role in (("quad1", Role.VEHICLE), ("ops", Role.OPERATOR), ("view", Role.VIEWER))
    }
    ops = serve(credentials=str(folders["ops"]))
    view = serve(credentials=str(folders["view"]), endpoint=ops.endpoint)
    own = SessionSettings(connect=[ops.endpoint], credentials=str(folders["quad1"]))
    counter, end = started(ops, own)
    try:
        given = ops.post("/agent/quad1/counter/count", {"to": 2})
        assert (given.status, counter.askers) == (200, ["ops"]), given.text
        ops.post("/agent/quad1/counter/set", {"name": "gain", "value": 3})
        assert "gain is 3, was 1, by ops" in counter._events[-1]["text"]
        refused = view.post("/agent/quad1/counter/set", {"name": "gain", "value": 4})
        assert (refused.status, refused.json["error"]["kind"]) == (403, "forbidden"), refused.text
        assert (counter["gain"], counter.askers) == (3.0, ["ops"])
    finally:
        ops.call(end())
