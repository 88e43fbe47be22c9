"""Orders and streams of setpoints over HTTP: the real agent beside the embedded simulator does what they say."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest
import zenoh

from zmav import keys, wire
from zmav.onboard import Onboard, OnboardSettings
from zmav.sim import SimVehicle, VehicleSpec, World
from zmav.verbs import VERBS

if TYPE_CHECKING:
    from tests.ground.http.conftest import Serve, Served

SPEED = 8.0
PATIENCE_S = 30.0
ORIGIN = wire.Origin(lat_deg=-35.363261, lon_deg=149.165230, alt_amsl=584.09)


class Scene(NamedTuple):
    served: Served
    sim: SimVehicle

    def state(self) -> wire.VehicleState:
        return self.served.gateway.client.vehicle("quad1").state

    def drain(self, **query: Any) -> None:
        """End a stream, if one runs."""
        self.served.get("/release/quad1", **query)


@pytest.fixture(scope="module")
def scene(serve: Serve) -> Iterator[Scene]:
    """quad1, simulated, with its agent, and a gateway that has heard that it is ready."""
    served = serve()
    spec = VehicleSpec(name="quad1", params={"DISARM_DELAY": 0.0, "LAND_SPEED": 150.0})
    with World([spec], endpoint="tcp:0", speed=SPEED, ready_s=0.5) as world:

        async def start() -> Onboard:
            settings = OnboardSettings(link=world.urls[0], name="quad1", origin=ORIGIN)
            return await Onboard(served.session, settings).__aenter__()

        async def stop(vehicle: Onboard) -> None:
            await vehicle.__aexit__(None, None, None)

        vehicle = served.call(start())
        known = served.gateway.client
        served.until(lambda: bool((s := known.vehicle("quad1").last_state) and s.ready and s.position), "ready quad1")
        yield Scene(served, world.vehicles[0])
        served.call(stop(vehicle))


@pytest.fixture(scope="module")
def airborne(scene: Scene) -> Scene:
    """Up, by what MATLAB's urlread can do."""
    armed = scene.served.get("/do/quad1/arm", ready_timeout=30)
    assert armed.status == 200, armed.text
    assert armed.json["verb"] == "arm"
    assert armed.json["status"] == "done"
    up = scene.served.get("/do/quad1/takeoff", alt_rel=6)
    assert up.status == 200, up.text
    assert scene.sim.status().ned_m[2] == pytest.approx(-6.0, abs=1.0)
    return scene


def test_orders_by_get_by_form_and_by_json(airborne: Scene) -> None:
    served = airborne.served
    target = {"pos": [6.0, 4.0, -7.0], "timeout": 60}
    reply = served.post("/do/quad1/goto", target)
    assert (reply.status, reply.json["status"]) == (200, "done"), reply.text
    assert airborne.sim.status().ned_m == pytest.approx((6.0, 4.0, -7.0), abs=1.5)
    kind = "application/x-www-form-urlencoded"
    form = served.post("/do/quad1/goto", "pos=[0,0,-6]&arrive=false", content_type=kind)
    assert form.status == 200, form.text
    assert served.get("/do/quad1/goto", pos="[1,1,-6]", arrive="false").status == 200
    held = served.post("/do/quad1/hold")
    assert (held.status, held.json["verb"], held.json["status"]) == (200, "hold", "done"), held.text


def test_an_order_with_an_id_is_asked_after(airborne: Scene) -> None:
    order = {"id": "7", "wait": 0.2, "pos": [12.0, 0.0, -6.0]}
    first = airborne.served.get("/do/quad1/goto", **order)  # urlread knows no quotes: an id of digits is text, too
    assert (first.status, first.json["status"]) == (200, "running"), first.text
    while (said := airborne.served.post("/do/quad1/goto", order).json)["status"] == "running":
        pass
    assert said["status"] == "done"
    assert airborne.sim.status().ned_m[0] == pytest.approx(12.0, abs=1.5)


@pytest.mark.parametrize(
    ("path", "body", "status", "words"),
    [
        ("/do/quad1/takeof", {}, 400, "takeoff"),
        ("/do/quad1/takeoff", {}, 400, "alt_rel"),
        ("/do/quad1/takeoff", {"alt_rel": "high"}, 400, "alt_rel"),
        ("/do/quad1/takeoff", {"alt_rel": 10, "speed": 3}, 400, "speed"),
        ("/do/quad1/hold?timeout=5", {}, 400, "timeout"),
        ("/do/quad1/takeoff", "[1]", 400, "JSON object"),
        ("/do/quad1/takeoff", "{", 400, "JSON object"),
        ("/do/quad1/takeoff?alt_rel=5&alt_rel=6", {}, 400, "twice"),
        ("/do/quad1/takeoff", '{"alt_rel": 5, "alt_rel": 500}', 400, "twice"),
        ("/do/quad1/command?command=DO_SET_ROI&params={%22param1%22:1,%22param1%22:2}", {}, 400, "twice"),
        ("/fleet/takeoff", '{"vehicles": "quad1", "alt_rel": 5, "alt_rel": 500}', 400, "twice"),
        ("/do/Quad1/hold", {}, 400, "lower-case"),
        ("/do/quad*/hold", {}, 400, "lower-case"),
        ("/do/quad1/set_mode", {"mode": "WARP"}, 400, "WARP"),
        ("/do/quad1/reboot", {}, 409, "armed"),
        ("/setpoint/quad1", {}, 400, "where to go"),
        ("/setpoint/quad1", {"n": 1, "e": 2}, 400, "all three"),
        ("/setpoint/quad1", {"pos": [1, 2]}, 400, "pos"),
        ("/setpoint/quad1", {"pos": [1, 2, -3], "valid": 60}, 400, "valid"),
        ("/setpoint/quad1", {"thrust": 0.5}, 400, "thrust"),
        ("/setpoint/quad1?as=Me", {"pos": [1, 2, -3]}, 400, "as"),
        ("/release/quad1?as=stranger", {}, 409, "stranger"),
    ],
)
def test_what_cannot_be_done_is_named(airborne: Scene, path: str, body: Any, status: int, words: str) -> None:
    reply = airborne.served.post(path, body)
    assert reply.status == status, reply.text
    assert words in reply.json["error"]["text"]
    assert reply.json["error"]["kind"]


def test_a_vehicle_that_is_not_there(scene: Scene) -> None:
    reply = scene.served.get("/do/quad9/hold")
    assert (reply.status, reply.json["error"]["kind"]) == (404, "no_such_vehicle")


def test_a_stream_flies_and_its_end_gives_the_lease_back(airborne: Scene) -> None:
    served = airborne.served
    served.get("/do/quad1/hold")
    reply = served.get("/setpoint/quad1", n=12, e=8, d=-6, yaw=1)
    assert reply.status == 200, reply.text
    assert reply.json["holder"] == "http"
    served.until(lambda: (lease := airborne.state().lease) is not None and lease.holder == "http", "lease")
    end = time.monotonic() + PATIENCE_S
    while airborne.sim.status().ned_m[1] < 7.0 and time.monotonic() < end:  # a caller of twice a second
        assert served.post("/setpoint/quad1", {"pos": [12, 8, -6], "yaw": 1}).status == 200
        threading.Event().wait(0.5)
    assert airborne.sim.status().ned_m == pytest.approx((12.0, 8.0, -6.0), abs=1.5)
    flown = airborne.state().setpoints
    assert flown.get("flown", 0) > 2 or sum(flown.values()) > 2, flown
    assert served.get("/release/quad1").json == {"vehicle": "quad1", "released": True}
    served.until(lambda: airborne.state().lease is None, "end of the lease")
    assert served.get("/release/quad1").status == 409


def test_the_second_caller_is_told_who_holds(airborne: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ground.http.setpoints.SILENCE", PATIENCE_S)  # a busy machine is no silent caller
    served = airborne.served
    first = served.request("GET", "/setpoint/quad1?as=mapper&n=12&e=8&d=-6")
    assert first.status == 200, first.text
    second = served.request("GET", "/setpoint/quad1?as=intruder&n=0&e=0&d=-6")
    assert (second.status, second.json["error"]["kind"]) == (409, "not_holder")
    assert "mapper" in second.json["error"]["text"]
    higher = served.post("/setpoint/quad1?as=boss", {"pos": [12, 8, -6], "priority": 50})
    assert (higher.status, higher.json["holder"]) == (200, "boss")
    served.until(lambda: (lease := airborne.state().lease) is not None and lease.holder == "boss", "boss")
    lost = served.request("GET", "/setpoint/quad1?as=mapper&n=12&e=8&d=-6")
    assert lost.status == 409, lost.text
    within_the_lease = served.get("/do/quad1/servo", output=9, pwm=1500, lease=higher.json["lease"])
    assert within_the_lease.status == 200, within_the_lease.text
    airborne.drain(**{"as": "boss"})


def test_silence_ends_the_stream(airborne: Scene) -> None:
    served = airborne.served
    assert served.get("/setpoint/quad1", n=12, e=8, d=-6).status == 200
    served.until(lambda: served.gateway.figures["streams"]() >= 1 and airborne.state().lease is not None, "lease")
    served.until(lambda: airborne.state().lease is None, "end of the lease")
    ended = airborne.state().lease_end
    assert ended is not None
    assert ended.reason == "released"
    again = served.get("/setpoint/quad1", n=12, e=8, d=-6)
    assert again.status == 200, again.text
    airborne.drain()


def test_every_verb_is_offered(scene: Scene) -> None:
    """Asked with a field that none of them has, each says so, and none is done."""
    for verb in VERBS:
        reply = scene.served.post(f"/do/quad1/{verb}", {"no_such_field": 1})
        assert (reply.status, reply.json["error"]["kind"]) == (400, "bad_input"), f"{verb}: {reply.text}"


def test_an_order_to_all_says_of_each_how_it_stands(airborne: Scene) -> None:
    """The page's way: asked again with its id. Nothing is done while anybody flies; who is disarmed is left out."""
    served = airborne.served
    airborne.drain(**{"as": "mapper"})
    served.vehicle("quad7", 7)
    landed = threading.Event()

    def speak() -> None:
        while not landed.wait(0.1):  # what it said last must not grow old, however busy the machine is
            state = wire.VehicleState(
                t=time.time(), fleet="demo", name="quad7", instance="quad71", connected=True, sysid=7, armed=False
            )
            served.session.put("zmav/demo/quad7/state", wire.encode(state))

    speaker = threading.Thread(target=speak)
    speaker.start()
    order = {"vehicles": ["*"], "id": "all-1", "wait": 0.3}
    while (said := served.post("/fleet/rtl", order).json)["status"] == "running":
        (flying,) = [each for each in said["vehicles"] if each["vehicle"] == "quad1"]
        assert flying["status"] in ("running", "returning") or not airborne.sim.status().armed
    landed.set()
    speaker.join()
    told = {each["vehicle"]: each for each in said["vehicles"]}
    assert not airborne.sim.status().armed
    assert (told["quad1"]["status"], told["quad1"]["text"]) == ("done", "done: landed and disarmed")
    assert (told["quad7"]["status"], told["quad7"]["text"]) == ("left_out", "left out: it is disarmed")
    for path, body, words in (
        ("/fleet/rtll", {}, "no order"),
        ("/fleet/hold", {"vehicles": ["x*"]}, "no vehicle matches x*"),
        ("/fleet/hold", {"vehicles": 7}, "a list of names"),
        ("/fleet/hold", {}, "a list of names"),
        ("/fleet/takeoff", {"vehicles": ["*"]}, "alt_rel"),
    ):
        refused = served.post(path, body)
        assert refused.status in (400, 404) and words in refused.text


def test_an_order_to_several_is_given_once(served: Served) -> None:
    """However often it comes with its id, and in whatever order its fields; not again for another one under that id."""
    key, given = keys.DO.key("demo", "quad8", verb="*"), list[str]()
    served.vehicle("quad8", 8)

    def outcome(query: zenoh.Query) -> None:
        given.append(str(query.key_expr).rpartition("/")[2])
        query.reply(str(query.key_expr), wire.encode(wire.Outcome(verb=given[-1], status="done", took=0.0)))

    queryable = served.session.declare_queryable(key, outcome)
    order = {"vehicles": ["quad8"], "id": "once", "wait": 0}
    while (said := served.post("/fleet/hold", order).json)["status"] == "running":
        pass
    again = served.post("/fleet/hold", dict(reversed(order.items()))).json
    assert again["vehicles"] == said["vehicles"]
    assert [each["status"] for each in again["vehicles"]] == ["done"]
    for path, body in (
        ("/fleet/hold", {**order, "vehicles": ["q*"]}),
        ("/fleet/land", order),
        ("/fleet/hold", {**order, "wait": 1}),
    ):
        refused = served.post(path, body)
        assert (refused.status, refused.json["error"]["kind"]) == (400, "bad_input"), refused.text
        assert "'once' was used for another order (hold)" in refused.text
    long = served.post("/fleet/hold", {**order, "id": "x" * 65})
    assert long.status == 400 and "at most 64 characters" in long.text
    unknown = {**order, "id": "nobody", "vehicles": ["x*"]}
    assert [served.post("/fleet/hold", unknown).status for _ in range(2)] == [404, 404], "nothing was given"
    queryable.undeclare()
    assert given == ["hold"]


def test_a_state_comes_with_what_is_alarming(served: Served) -> None:
    """The rules of top and doctor, by the gateway: the page has none of its own."""
    served.vehicle("low1", 9, battery=wire.Battery(remaining=0.0))
    key = "zmav/demo/low1/state"
    state = wire.VehicleState(
        t=1.0,
        fleet="demo",
        name="low1",
        instance="x",
        connected=True,
        sysid=9,
        armed=True,
        battery=wire.Battery(remaining=0.0),
    )
    queryable = served.session.declare_queryable(key, lambda query: query.reply(key, wire.encode(state)))
    (document,) = served.get("/keys/low1").json
    queryable.undeclare()
    assert [(alarm["level"], alarm["text"]) for alarm in document["alarms"]] == [("bad", "battery 0%")]
    assert "charge or change it" in document["alarms"][0]["advice"]
