"""What any program of a host may say by plain TCP on loopback, and what only those whom the unix socket lets in."""

from __future__ import annotations

import socket
import stat
from typing import TYPE_CHECKING, Any

import pytest
import zenoh

from mesh.credentials.acl import local
from mesh.plan import plan_router
from mesh.router import Router
from tests.mesh.credentials.test_acl import MEMBERS, every_key, put_all, reached
from zmav import keys
from zmav.config import FleetConfig, StationConfig
from zmav.process import free_port
from zmav.rundir import path_of, socket_to_listen, sockets_to_call
from zmav.session import SessionSettings, open_session
from zmav.trust.certificate import Role

if TYPE_CHECKING:
    from tests.mesh.credentials.conftest import Fleet

BLOCK = zenoh.CongestionControl.BLOCK


@pytest.mark.parametrize("host", ["quad1", "ops"])
def test_a_program_speaks_of_the_hosts_own_and_never_as_a_vehicle(fleet: Fleet, host: str) -> None:
    fleet.issue(quad1=Role.VEHICLE, **MEMBERS)
    door = fleet.router(host)
    home, program = fleet.home(door), fleet.open(None, door.local)
    vehicles = ("quad1", "quad2", "ops")
    tried = {key for vehicle in vehicles for kind, key, _ in every_key(vehicle) if kind in ("pub", "put")}
    end = f"zmav/alpha/{host}/agent/x1/status"
    reached(program, end)
    for key in sorted(tried - {end}):
        program.put(key, b"", congestion_control=BLOCK)
    program.put(end, b"", congestion_control=BLOCK)
    came = home.put.until(end)
    for vehicle in vehicles:
        for word in ("state", "event", "beacon", "mav/rx/x1/x1/x1"):
            assert f"zmav/alpha/{vehicle}/{word}" not in came
        for word in ("setpoint/x1", "mav/tx/x1/x1/x1", "agent/x1/out/x1", "camera/x1/detection"):
            own = f"zmav/alpha/{vehicle}/{word}" in came
            assert own == (vehicle == host), word
    assert not {"zmav/alpha/@fleet/goal", "zmav/alpha/@fleet/charge", "zmav/alpha/@obstacle/x1"} & came
    assert "zmav/alpha/@fleet/roster" in came  # the authority's, anyone who brings it
    allowed = [zenoh.KeyExpr(key) for key in local("alpha", host)["put"]]
    assert came | {end} == {key for key in tried if any(each.includes(zenoh.KeyExpr(key)) for each in allowed)}
    by_socket = fleet.open(None, door.unix)
    reached(by_socket, end)
    assert put_all(host, by_socket, home, ["zmav/alpha/quad2/state"]) == {"zmav/alpha/quad2/state"}


def test_a_program_reads_everything_and_answers_for_nobody_else(fleet: Fleet) -> None:
    fleet.issue(quad1=Role.VEHICLE, **MEMBERS)
    door = fleet.router("quad1")
    home, program = fleet.home(door), fleet.open(None, door.local)
    program.declare_queryable("zmav/alpha/quad2/**", lambda query: query.reply(query.key_expr, b"hijacked"))
    program.declare_queryable("zmav/alpha/quad1/agent/x/do/*", lambda query: query.reply(query.key_expr, b"own"))
    heard: list[str] = []
    program.declare_subscriber("zmav/**", lambda sample: heard.append(str(sample.key_expr)))
    token = keys.ALIVE.key("alpha", "quad2", role="vehicle", sys=1, autopilot="px4", uid=1, instance="x")
    program.liveliness().declare_token(token)
    reached(home.session, "zmav/alpha/quad2/state")
    home.session.put("zmav/alpha/quad2/state", b"", congestion_control=BLOCK)
    (reply,) = fleet.open(None, door.local).get("zmav/alpha/quad2/do/ping", timeout=20.0)
    assert reply.ok is not None
    assert reply.ok.payload.to_bytes() == b"home"
    every: dict[str, Any] = {"target": zenoh.QueryTarget.ALL, "consolidation": zenoh.ConsolidationMode.NONE}
    answers = {
        reply.ok.payload.to_bytes()
        for key in ("zmav/alpha/quad2/msg/X", "zmav/alpha/quad1/agent/x/do/y")
        for reply in home.session.get(key, timeout=20.0, **every)
        if reply.ok
    }
    assert answers == {b"home", b"own"}
    assert heard == ["zmav/alpha/quad2/state"]
    assert token not in home.tokens.keys


@pytest.mark.parametrize("host", ["quad1", "ops"])
def test_a_program_orders_no_other_vehicle(fleet: Fleet, host: str) -> None:
    """Whatever proof it has; nor does it with a wildcard. What a viewer may ask of others passes."""
    fleet.issue(quad1=Role.VEHICLE, **MEMBERS)
    door = fleet.router(host)
    home, program = fleet.home(door), fleet.open(None, door.local)
    vehicles = ("quad1", "quad2", "quad9", "ops", "*")  # quad9 is on no roster yet
    orders = ("do/land", "do/arm", "swarm/abort", "agent/x/do/y", "bench/order/start")
    read = ("state", "param/X", "mission/mission", "msg/X", "do/ping", "file/x/*")
    reached(program, end := f"zmav/alpha/{host}/agent/x1/status")
    last = f"zmav/alpha/{host}/msg/END"
    for key in (*(f"zmav/alpha/{vehicle}/{what}" for vehicle in vehicles for what in (*orders, *read)), last):
        program.get(key, lambda reply: None, timeout=5.0)
    program.put(end, b"", congestion_control=BLOCK)
    came = home.asked.until(last) - {last}
    assert came == {
        f"zmav/alpha/{vehicle}/{what}"
        for vehicle in vehicles
        for what in (*orders, *read)
        if vehicle == host or what in read
    }
    by_socket = fleet.open(None, door.unix)
    for key in ("zmav/alpha/quad2/do/land", last):
        by_socket.get(key, lambda reply: None, timeout=5.0)
    assert "zmav/alpha/quad2/do/land" in home.asked.until(last)


async def test_the_sockets_owner_and_group_alone_use_it(fleet: Fleet, monkeypatch: pytest.MonkeyPatch) -> None:
    """A router as 'zmav router' opens it: clients that name no endpoint find it there, before TCP."""
    fleet.issue(ops=Role.OPERATOR)
    port = free_port(socket.SOCK_STREAM)
    file = FleetConfig(fleet="alpha", stations={"ops": StationConfig(listen=[f"tcp/127.0.0.1:{port}"])})
    base = SessionSettings(credentials=str(fleet.members["ops"]))
    plan = plan_router(file, "ops", base)
    endpoint = socket_to_listen(port)
    assert endpoint is not None
    assert plan.listens == [f"tcp/127.0.0.1:{port}", endpoint]
    path = path_of(endpoint)
    assert path is not None
    async with Router(plan, base, parts=()):
        assert stat.S_IMODE(path.stat().st_mode) == 0o660
        assert sockets_to_call(port) == [endpoint]
        monkeypatch.setattr("zmav.session.DEFAULT_PORT", port)
        with open_session(SessionSettings()) as session:  # nothing is at the usual port of TCP
            assert [str(zid) for zid in session.info.routers_zid()]
    assert sockets_to_call(port) == []


async def test_a_socket_that_another_router_holds_keeps_none_from_starting(fleet: Fleet) -> None:
    fleet.issue(ops=Role.OPERATOR)
    port = free_port(socket.SOCK_STREAM)
    endpoint = socket_to_listen(port)
    assert endpoint is not None
    fleet.open(None, mode="router", listen=[endpoint])
    file = FleetConfig(fleet="alpha", stations={"ops": StationConfig(listen=[f"tcp/127.0.0.1:{port}"])})
    base = SessionSettings(credentials=str(fleet.members["ops"]))
    async with Router(plan_router(file, "ops", base), base, parts=()):
        with open_session(SessionSettings(connect=[f"tcp/127.0.0.1:{port}"])) as session:
            assert [str(zid) for zid in session.info.routers_zid()]


def test_without_credentials_there_is_none() -> None:
    assert plan_router(None, "ops", SessionSettings()).listens == ["tcp/127.0.0.1:7447"]
