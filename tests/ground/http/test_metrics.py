"""/metrics: read by the grammar of Prometheus' text format, and true of the fleet.

https://prometheus.io/docs/instrumenting/exposition_formats/ (text format 0.0.4)
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, NamedTuple

import msgspec
import pytest
import zenoh

from ground.http.metrics import Exposition
from zmav import keys, wire

if TYPE_CHECKING:
    from tests.ground.http.conftest import Serve, Served

NAME = r"[a-zA-Z_:][a-zA-Z0-9_:]*"
LABEL = r'[a-zA-Z_][a-zA-Z0-9_]*="(?:[^"\\\n]|\\\\|\\"|\\n)*"'
SAMPLE = re.compile(rf"({NAME})(?:\{{({LABEL}(?:,{LABEL})*)\}})? (\S+)\Z")
HELP = re.compile(rf"# HELP ({NAME}) (.+)\Z")
TYPE = re.compile(rf"# TYPE ({NAME}) (counter|gauge)\Z")
PAIR = re.compile(r'(\w+)="((?:[^"\\]|\\.)*)"')
ESCAPED = {"\\\\": "\\", '\\"': '"', "\\n": "\n"}


LINK = wire.LinkQuality(
    t=0.0,
    name="autopilot",
    url="tcp:x",
    state="up",
    age=0.1,
    rx_rate=40.0,
    rx_bytes_rate=900.0,
    loss=0.02,
    rtt=0.004,
    rx_frames=1234,
    lost=5,
)


class Sample(NamedTuple):
    name: str
    labels: dict[str, str]
    value: float


def read(text: str) -> list[Sample]:
    """Every sample; fails where the grammar, or the order of a family's lines, is not kept to."""
    assert text.endswith("\n")
    samples: list[Sample] = []
    helped, typed, family = set[str](), dict[str, str](), ""
    for line in text[:-1].split("\n"):
        if found := HELP.match(line):
            assert found[1] not in helped, f"two HELP lines for {found[1]}"
            helped.add(found[1])
            family = found[1]
        elif found := TYPE.match(line):
            assert found[1] == family, f"{line}: apart from its HELP"
            assert found[1] not in typed
            typed[found[1]] = found[2]
        else:
            found = SAMPLE.match(line)
            assert found, f"not a sample: {line!r}"
            assert found[1] == family, f"{line}: not beside its family"
            assert typed[family] == "counter" if family.endswith("_total") else typed[family] == "gauge"
            labels = {n: re.sub(r"\\.", lambda e: ESCAPED[e[0]], text) for n, text in PAIR.findall(found[2] or "")}
            samples.append(Sample(found[1], labels, float(found[3])))
    keyed = [(each.name, tuple(sorted(each.labels.items()))) for each in samples]
    assert len(set(keyed)) == len(keyed), "a series is there twice"
    return samples


def test_the_format_escapes_and_reads_back() -> None:
    page = Exposition()
    page.add("zmav_a", "gauge", "with a \\ and a\nbreak", 1.5, path='C:\\x "y"\nz', empty=None)
    page.add("zmav_b_total", "counter", "later", 10.0**18)
    page.add("zmav_a", "gauge", "once only", math.nan, path="é")
    page.add("zmav_a", "gauge", "once only", -math.inf, path="i")
    page.add("zmav_none", "gauge", "no sample", None)
    first, second, third, fourth = read(page.text())
    assert first == Sample("zmav_a", {"path": 'C:\\x "y"\nz', "empty": ""}, 1.5)
    assert math.isnan(second.value)
    assert third.value == -math.inf
    assert fourth == Sample("zmav_b_total", {}, 1e18)
    assert "# HELP zmav_a with a \\\\ and a\\nbreak\n" in page.text()


def answer(
    served: Served, key: str, payload: bytes, note: Callable[[str], None] = lambda key: None
) -> zenoh.Queryable[None]:
    def on_query(query: zenoh.Query) -> None:
        note(str(query.key_expr))
        with query:
            query.reply(key, payload)

    return served.session.declare_queryable(key, on_query)


@pytest.fixture
def scraped(served: Served) -> list[Sample]:
    """quad3 with everything, its links, and quad4 with nothing known but its name."""
    served.vehicle(
        "quad3",
        3,
        firmware='4.7 "beta"',
        gps=wire.Gps(fix="3D_FIX", satellites=11, hdop=0.8),
        battery=wire.Battery(voltage=15.2, current=3.5, remaining=0.61),
        lease=wire.LeaseInfo(holder="me", expires=1.0),
        position=wire.GlobalPosition(lat_deg=-35.25, lon_deg=149.5, alt_amsl=600.0, alt_rel=16.0),
        link_loss=0.02,
        setpoints={"flown": 7, "late": 2},
    )
    served.vehicle("quad4", 4)
    t = time.time()
    link = msgspec.structs.replace(LINK, t=t)
    near = wire.NeighbourQuality(
        t=t,
        name="quad4",
        router="a",
        peer="b",
        url="udp/x",
        state="up",
        rtt=0.02,
        loss_in=0.1,
        loss_out=0.2,
        signal=-61.0,
    )
    declared = [
        answer(served, keys.LINK.key("demo", "quad3", link="autopilot"), wire.encode(link)),
        answer(served, keys.LINK.key("demo", "quad3", link="quad4"), wire.encode(near)),
        answer(served, keys.LINK.key("demo", "quad4", link="broken"), b"no quality"),
    ]
    try:
        reply = served.get("/metrics")
    finally:
        for queryable in declared:
            queryable.undeclare()
    assert reply.status == 200
    assert reply.headers["content-type"] == "text/plain; version=0.0.4; charset=utf-8"
    return read(reply.text)


def test_a_scrape_says_how_the_fleet_is(scraped: list[Sample]) -> None:
    def value(name: str, **labels: str) -> float | None:
        wanted = labels.items()
        found = [each.value for each in scraped if each.name == name and wanted <= each.labels.items()]
        assert len(found) <= 1, f"{name} is there {len(found)} times"
        return found[0] if found else None

    quad3 = {"fleet": "demo", "vehicle": "quad3"}
    assert value("zmav_vehicle_up", **quad3) == 1.0
    assert value("zmav_vehicle_info", **quad3, firmware='4.7 "beta"', sysid="3", kind="copter") == 1.0
    assert value("zmav_vehicle_mode", **quad3, mode="GUIDED") == 1.0
    assert value("zmav_vehicle_battery_volts", **quad3) == 15.2
    assert value("zmav_vehicle_battery_remaining_ratio", **quad3) == 0.61
    assert value("zmav_vehicle_latitude_degrees", **quad3) == -35.25
    assert value("zmav_vehicle_altitude_relative_meters", **quad3) == 16.0
    assert value("zmav_vehicle_gps_satellites", **quad3) == 11.0
    assert value("zmav_vehicle_lease_held", **quad3) == 1.0
    assert value("zmav_vehicle_armed", **quad3) == 0.0
    assert value("zmav_vehicle_setpoints_total", **quad3, outcome="late") == 2.0
    age = value("zmav_vehicle_state_age_seconds", **quad3)
    assert age is not None
    assert 0.0 <= age < 60.0
    assert value("zmav_link_rx_frames_per_second", **quad3, link="autopilot") == 40.0
    assert value("zmav_link_rtt_seconds", **quad3) == 0.004
    assert value("zmav_link_rx_frames_total", **quad3) == 1234.0
    assert value("zmav_neighbour_rtt_seconds", **quad3, neighbour="quad4") == 0.02
    assert value("zmav_neighbour_loss_out_ratio", **quad3) == 0.2
    assert value("zmav_vehicle_battery_volts", vehicle="quad4") is None
    assert value("zmav_vehicle_up", vehicle="quad4") == 1.0


def test_links_are_asked_for_once_however_many_scrape(serve: Serve, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ground.http.metrics.LINKS_EVERY", 60.0)
    served = serve()
    served.vehicle("quad3", 3)
    asked, link = list[str](), msgspec.structs.replace(LINK, t=time.time())
    queryable = answer(served, keys.LINK.key("demo", "quad3", link="autopilot"), wire.encode(link), asked.append)
    with ThreadPoolExecutor(5) as pool:
        pages = [read(reply.text) for reply in pool.map(served.get, ["/metrics"] * 5)]
    queryable.undeclare()
    assert len(asked) == 1
    assert all(any(each.labels.get("link") == "autopilot" for each in page) for page in pages)


def test_a_scrape_says_how_the_gateway_is(served: Served, scraped: list[Sample]) -> None:
    found = {each.name: each.value for each in scraped if each.name.startswith("zmav_http_")}
    served.hear("SYSTEM_TIME", time_unix_usec=5, time_boot_ms=6)
    later = {each.name: each.value for each in read(served.get("/metrics").text)}
    assert later["zmav_http_frames_total"] == found["zmav_http_frames_total"] + 1
    assert {
        "zmav_http_websockets",
        "zmav_http_subscriptions",
        "zmav_http_dropped_total",
        "zmav_http_cut_total",
        "zmav_http_streams",
        "zmav_http_sent_total",
    } <= set(found)
    assert abs(found["zmav_http_start_time_seconds"] - time.time()) < 600.0
