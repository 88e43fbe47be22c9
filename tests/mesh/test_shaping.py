"""What is thinned at the door of a radio with a budget, and that nothing else is."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

import pytest
import zenoh

from mesh.plan import plan_router
from mesh.router import Router
from mesh.shaping import MARGIN, RAW_HZ, downsampling, thinned
from tests.conftest import Ground, Net
from tests.ports import free_udp_ports
from zmav import keys
from zmav.config import FleetConfig, Radio, load_fleet
from zmav.errors import BadConfig
from zmav.session import SessionSettings, open_session

LTE = Radio(address="10.8.0.11", kind="lte", budget="60 kB/s")
WIFI = Radio(interface="wlan0", address="10.77.0.1")


def fleet(tmp_path: Path, text: str) -> FleetConfig:
    file = tmp_path / "fleet.toml"
    file.write_text(text)
    return load_fleet(file)


def test_without_a_budget_nothing_is_thinned() -> None:
    assert thinned(FleetConfig(), [WIFI]) == ()
    assert thinned(FleetConfig(), []) == ()


def test_where_every_radio_has_a_budget_all_that_streams_is_thinned_and_nothing_else() -> None:
    rates = {each.name: each for each in thinned(FleetConfig(), [LTE])}
    assert {"ATTITUDE", "GLOBAL_POSITION_INT", "RAW_IMU", "state"} <= rates.keys()
    assert not {"HEARTBEAT", "STATUSTEXT", "COMMAND_ACK", "PARAM_VALUE", "MISSION_ITEM_INT", "event"} & rates.keys()
    assert all("60 kB/s" in each.source for each in rates.values())


def test_the_more_vehicles_share_a_budget_the_rarer_each_speaks(tmp_path: Path) -> None:
    many = fleet(tmp_path, "".join(f'[vehicles.q{n}]\nlink = "tcp:x:{n + 1}"\n' for n in range(30)))
    one, all_of_them = thinned(FleetConfig(), [LTE]), thinned(many, [LTE])
    (few,), (much,) = ([each.hz for each in found if each.name == "ATTITUDE"] for found in (one, all_of_them))
    assert RAW_HZ[1] == few > much == RAW_HZ[0]


def test_beside_a_radio_without_budget_only_what_the_file_says_is_thinned(tmp_path: Path) -> None:
    file = fleet(tmp_path, "[mesh.thin]\nATTITUDE = 4\n")
    (only,) = thinned(file, [WIFI, LTE])
    assert (only.name, only.hz, only.source) == ("ATTITUDE", 4.0, "fleet file: mesh.thin.ATTITUDE")


def test_a_radio_s_own_rate_goes_before_the_fleet_s_and_the_lower_of_two_radios(tmp_path: Path) -> None:
    file = fleet(tmp_path, "[mesh.thin]\nATTITUDE = 4\nVFR_HUD = 3\n")
    slow = Radio(address="10.9.0.1", budget="5 kB/s", thin={"ATTITUDE": 1.0})
    fast = Radio(address="10.8.0.1", budget="60 kB/s", thin={"ATTITUDE": 9.0})
    rates = {each.name: each.hz for each in thinned(file, [fast, slow])}
    assert (rates["ATTITUDE"], rates["VFR_HUD"]) == (1.0, 3.0)


def test_a_rule_matches_one_message_of_one_vehicle() -> None:
    """One rule has one timer: a rule that matched two streams would starve the slower."""
    thin = thinned(FleetConfig(), [LTE])
    (item,) = downsampling(FleetConfig(), "demo", "quad1", thin)
    expressions = [rule["key_expr"] for rule in item["rules"]]
    assert len(set(expressions)) == len(thin)
    assert {e.rpartition("/")[0] for e in expressions} == {"zmav/demo/quad1", "zmav/demo/quad1/mav/rx/*/*"}


def test_what_must_arrive_and_what_is_real_time_is_no_rule_s(tmp_path: Path) -> None:
    (item,) = downsampling(FleetConfig(), "demo", "quad1", thinned(FleetConfig(), [LTE]))
    rules = [zenoh.KeyExpr(rule["key_expr"]) for rule in item["rules"]]
    parts = {
        "agent": "a",
        "verb": "arm",
        "msg": "ATTITUDE",
        "hz": "5",
        "instance": "1",
        "sys": "1",
        "comp": "1",
        "param": "P",
        "kind": "mission",
        "file": "f",
        "offset": "0",
        "link": "l",
        "holder": "h",
        "role": "vehicle",
        "autopilot": "x",
        "uid": "1",
        "topic": "origin",
    }
    for channel in keys.CHANNELS.values():
        if channel.name in ("rx", "state"):
            continue
        try:
            key = zenoh.KeyExpr(channel.key("demo", "quad1", **parts))
        except KeyError:
            continue  # other parts than a vehicle's keys have
        assert not any(rule.intersects(key) for rule in rules), channel.name


@pytest.mark.parametrize("budget", ["60", "fast", "1 B/s"])
def test_a_budget_that_is_none_is_refused(tmp_path: Path, budget: str) -> None:
    with pytest.raises(BadConfig, match="60 kB/s"):
        thinned(FleetConfig(), [Radio(address="10.8.0.1", budget=budget)])


FILE = """
[mesh]
insecure = true
[mesh.thin]
ATTITUDE = 5
[vehicles.quad1]
link = "tcp:127.0.0.1:1"
listen = ["tcp/127.0.0.1:{near}"]
[vehicles.quad1.mesh]
neighbours = ["ground"]
[[vehicles.quad1.mesh.radios]]
address = "127.0.0.1/8"
port = {one}
budget = "200 kB/s"
[stations.ground]
listen = ["tcp/127.0.0.1:{far}"]
[stations.ground.mesh]
neighbours = ["quad1"]
[[stations.ground.mesh.radios]]
address = "127.0.0.2/8"
port = {two}
"""


async def test_a_far_reader_gets_the_thin_stream_a_near_one_the_whole_and_the_unread_does_not_cross(
    tmp_path: Path, net: Net
) -> None:
    ports = near_port, far_port, *_ = [free_udp_ports(1) for _ in range(4)]
    file = fleet(tmp_path, FILE.format(near=near_port, far=far_port, one=ports[2], two=ports[3]))
    # Endpoints that a person gives, too, are beside the bearers' and not in their place.
    calls = 'connect/endpoints:{router:["udp/127.0.0.1:9?rel=1"]}'
    one = SessionSettings(cfg=["scouting/delay:0", f'listen/endpoints:["tcp/127.0.0.1:{near_port}"]'])
    other = SessionSettings(cfg=["scouting/delay:0", calls])
    async with (
        Router(plan_router(file, "quad1", one), one, ()) as here,
        Router(plan_router(file, "ground", other), other, ()) as there,
    ):
        near, far = (
            Ground(open_session(SessionSettings(connect=[f"tcp/127.0.0.1:{port}"]))) for port in (near_port, far_port)
        )
        net.sessions += [near.session, far.session]
        fast = {"sys": 1, "comp": 1, "msg": "ATTITUDE"}
        whole, thin = near.samples(keys.RX, **fast), far.samples(keys.RX, **fast)
        setpoints = far.samples(keys.SETPOINT, agent="*")
        attitude, setpoint = keys.RX.key("demo", "quad1", **fast), keys.SETPOINT.key("demo", "quad1", agent="a")
        unread = keys.RX.key("demo", "quad1", sys=1, comp=1, msg="RAW_IMU")
        await net.linked(here.session, setpoint)
        await net.linked(here.session, attitude)
        bearer = here.bearers.bearer
        assert bearer is not None and there.bearers.bearer is not None
        sent, count = bearer.ports[0].counters, 0

        def all_there() -> bool:
            return len(setpoints.items) == count

        # Where this computer is busy, what may be dropped is, before it has left.
        kept = zenoh.CongestionControl.BLOCK
        start = time.monotonic()
        while time.monotonic() < start + 1.5:
            here.session.put(attitude, bytes(40), congestion_control=kept)
            here.session.put(setpoint, bytes(40), congestion_control=kept)
            count += 1
            await asyncio.sleep(0.02)
            await setpoints.until(all_there, "setpoint")
        span = time.monotonic() - start
        await whole.until(lambda: len(whole.items) == count, "frame")
        assert count > 2 * (5 * MARGIN * span + 1)
        assert 2 <= len(thin.items) <= 5 * MARGIN * span + 1
        before = sent.sent_bytes
        for _ in range(400):
            here.session.put(unread, bytes(1000))
        here.session.put(setpoint, b"after", congestion_control=kept)
        await setpoints.until(lambda: len(setpoints.items) == count + 1, "setpoint")
        assert sent.sent_bytes - before < 400 * 1000 / 10
