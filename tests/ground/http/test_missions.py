"""Files of missions over HTTP: read as QGroundControl and Mission Planner write them, uploaded to whom is meant."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import pytest

from ground.http.guard import Rules
from zmav import wire
from zmav.onboard import Onboard, OnboardSettings
from zmav.sim import VehicleSpec, World

if TYPE_CHECKING:
    from tests.ground.http.conftest import Serve, Served

ORIGIN = wire.Origin(lat_deg=-35.363261, lon_deg=149.165230, alt_amsl=584.09)
LAT, LON = ORIGIN.lat_deg, ORIGIN.lon_deg
ROW = "{seq}\t0\t{frame}\t16\t0\t0\t0\t0\t{lat:.7f}\t{lon:.7f}\t{alt}\t1\n"
WAYPOINTS = "QGC WPL 110\n" + ROW.format(seq=0, frame=0, lat=LAT, lon=LON, alt=584)
WAYPOINTS += "".join(ROW.format(seq=n, frame=3, lat=LAT + n * 2e-4, lon=LON, alt=10) for n in (1, 2, 3))
PLAN = json.dumps(
    {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "QGroundControl",
        "mission": {
            "version": 2,
            "firmwareType": 3,
            "vehicleType": 2,
            "cruiseSpeed": 5,
            "hoverSpeed": 5,
            "plannedHomePosition": [LAT, LON, 584.0],
            "items": [
                {
                    "type": "SimpleItem",
                    "autoContinue": True,
                    "command": 16,
                    "doJumpId": 1,
                    "frame": 3,
                    "params": [0, 0, 0, None, LAT, LON + 2e-4, 12],
                }
            ],
        },
        "geoFence": {
            "version": 2,
            "circles": [],
            "polygons": [
                {
                    "version": 1,
                    "inclusion": True,
                    "polygon": [[LAT - 1e-2, LON - 1e-2], [LAT + 1e-2, LON - 1e-2], [LAT + 1e-2, LON + 1e-2]],
                }
            ],
        },
        "rallyPoints": {"version": 2, "points": []},
    }
)


@pytest.fixture(scope="module")
def two(serve: Serve) -> Iterator[Served]:
    """quad1 and quad2, simulated, behind a gateway."""
    served = serve()
    specs = [VehicleSpec(name=f"quad{n}", sysid=n) for n in (1, 2)]
    with World(specs, endpoint="tcp:0", ready_s=0.5) as world:

        async def start(url: str, name: str) -> Onboard:
            return await Onboard(served.session, OnboardSettings(link=url, name=name, origin=ORIGIN)).__aenter__()

        async def stop(vehicle: Onboard) -> None:
            await vehicle.__aexit__(None, None, None)

        agents = [served.call(start(url, f"quad{n}")) for n, url in enumerate(world.urls, start=1)]
        client = served.gateway.client
        for name in ("quad1", "quad2"):
            served.until(lambda name=name: bool((s := client.vehicle(name).last_state) and s.connected), name)  # type: ignore[misc]
        yield served
        for agent in agents:
            served.call(stop(agent))


def on(served: Served, name: str, kind: str = "mission") -> list[dict[str, Any]]:
    (found,) = served.get(f"/keys/{name}/mission/{kind}").json
    items: list[dict[str, Any]] = found["value"]["items"]
    return items


def test_both_kinds_of_file_are_read(two: Served) -> None:
    read = two.post("/mission/read", WAYPOINTS)
    assert read.status == 200 and list(read.json) == ["mission"]
    assert [item["z"] for item in read.json["mission"]] == [10.0] * 3
    read = two.post("/mission/read", PLAN)
    assert list(read.json) == ["mission", "fence"] and len(read.json["fence"]) == 3
    assert list(two.post("/mission/read?kind=fence", PLAN).json) == ["fence"]


@pytest.mark.parametrize(
    ("path", "body", "text"),
    [
        ("/mission/read", "QGC WPL 110\nnonsense", "the file"),
        ("/mission/read", "", "the file"),
        ("/mission/read", '{"fileType": "Other"}', "the file"),
        ("/mission/read?kind=rally", PLAN, "holds no rally"),
        ("/mission/read?kind=parameters", PLAN, "mission, fence, rally"),
        ("/mission/upload", PLAN, "to whom?"),
    ],
)
def test_what_is_wrong_is_said(two: Served, path: str, body: str, text: str) -> None:
    reply = two.post(path, body)
    assert reply.status == 400 and text in reply.json["error"]["text"]


def test_a_file_is_uploaded_to_those_that_are_named_and_to_no_other(two: Served) -> None:
    reply = two.post("/mission/upload?vehicles=quad1", WAYPOINTS)
    assert reply.status == 200, reply.text
    (told,) = reply.json["vehicles"]
    assert (told["vehicle"], told["status"], told["text"]) == ("quad1", "done", "3 items of mission")
    assert len(on(two, "quad1")) == 3 and on(two, "quad2") == []


def test_all_kinds_of_a_file_go_to_all_that_are_meant(two: Served) -> None:
    reply = two.post("/mission/upload?vehicles=quad*&as=anna", PLAN)
    assert [each["status"] for each in reply.json["vehicles"]] == ["done", "done"], reply.text
    for name in ("quad1", "quad2"):
        assert len(on(two, name)) == 1 and len(on(two, name, "fence")) == 3
    line = two.get("/orders").json[-1]
    assert (line["verb"], line["who"], line["vehicles"]) == ("mission/upload", "anna", ["quad*"])
    assert line["outcome"] == "quad1 done, quad2 done"


def test_who_refuses_says_so_and_keeps_what_it_had(two: Served) -> None:
    had = on(two, "quad1")
    assert two.post("/do/quad1/lease", {"holder": "another", "ttl": 20}).status == 200
    reply = two.post("/mission/upload?vehicles=quad*", WAYPOINTS)
    told = {each["vehicle"]: each for each in reply.json["vehicles"]}
    assert told["quad1"]["status"] == "failed" and "another" in told["quad1"]["text"]
    assert told["quad2"]["status"] == "done"
    assert on(two, "quad1") == had and len(on(two, "quad2")) == 3
    assert two.post("/mission/upload?vehicles=quad9", WAYPOINTS).status == 404


def test_a_gateway_that_reads_uploads_nothing(serve: Serve) -> None:
    served = serve(Rules(read_only=True))
    assert served.post("/mission/upload?vehicles=quad1", WAYPOINTS).status == 403
