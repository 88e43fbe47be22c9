"""Opening a session: zmav's own settings, a Zenoh file's, the options', and what is said where it fails."""

from __future__ import annotations

import asyncio
import json
import socket
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
import zenoh

from tests.conftest import Net, endpoint_of
from zmav import keys
from zmav.errors import BadConfig, SessionError
from zmav.session import (
    DEFAULT_ROUTER,
    LARGEST_MESSAGE,
    LARGEST_PAYLOAD,
    SessionSettings,
    config,
    open_in_thread,
    open_session,
)


def value(built: zenoh.Config, path: str) -> Any:
    return json.loads(built.get_json(path))


def test_an_application_is_a_client_of_its_hosts_router() -> None:
    built = config(SessionSettings())
    assert value(built, "mode") == "client"
    assert value(built, "connect/endpoints") == [DEFAULT_ROUTER] == ["tcp/127.0.0.1:7447"]
    assert value(built, "listen/endpoints") == []
    assert value(built, "scouting/multicast/enabled") is False
    assert value(built, "transport/shared_memory/enabled") is False


def test_a_router_waits_for_its_neighbours_for_ever_and_can_be_looked_into() -> None:
    built = config(SessionSettings(mode="router", connect=["tcp/127.0.0.1:1"]))
    assert value(built, "connect/timeout_ms") == -1
    assert value(built, "connect/exit_on_failure") is False
    assert value(built, "connect/retry")["period_max_ms"] == 1000
    assert value(built, "adminspace") == {"enabled": True, "permissions": {"read": True, "write": False}}
    assert value(built, "listen/endpoints") == []


def test_a_file_goes_before_the_defaults_and_the_options_before_the_file(tmp_path: Path) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text(
        '{mode: "router", connect: {endpoints: ["tcp/10.0.0.1:7447"]}, listen: {endpoints: ["tcp/10.0.0.2:7447"]}, '
        "transport: {link: {tx: {lease: 5000}}}}"
    )
    built = config(SessionSettings(file=str(file)))
    assert value(built, "mode") == "router"
    assert value(built, "connect/endpoints") == ["tcp/10.0.0.1:7447"]
    assert value(built, "listen/endpoints") == ["tcp/10.0.0.2:7447"]
    assert value(built, "transport/link/tx/lease") == 5000
    assert value(built, "transport/link/tx/keep_alive") == 4
    assert value(built, "adminspace/enabled") is True

    built = config(
        SessionSettings(
            mode="client", file=str(file), connect=["tcp/10.0.0.3:7447"], cfg=["transport/link/tx/lease:2000"]
        )
    )
    assert value(built, "mode") == "client"
    assert value(built, "connect/endpoints") == ["tcp/10.0.0.3:7447"]
    assert value(built, "transport/link/tx/lease") == 2000


def test_single_values_are_json5_or_a_bare_word() -> None:
    built = config(SessionSettings(cfg=["transport/link/tx/lease:2500", "mode:peer", "metadata:{name: 'x:y'}"]))
    assert value(built, "transport/link/tx/lease") == 2500
    assert value(built, "mode") == "peer"
    assert value(built, "metadata") == {"name": "x:y"}


@pytest.mark.parametrize(
    ("how", "field", "words"),
    [
        ({"cfg": ["lease"]}, "cfg", "expected PATH:VALUE"),
        ({"cfg": ["no/such/path:1"]}, "no/such/path", "Zenoh refuses"),
        ({"cfg": ["mode:captain"]}, "mode", "expected one of `router`, `peer`, `client`"),
        ({"connect": ["loopback"]}, "connect/endpoints", "<protocol>/<address>"),
        ({"listen": ["7447"]}, "listen/endpoints", "<protocol>/<address>"),
        ({"file": "/no/such/file.json5"}, "config", "No such file"),
    ],
)
def test_what_zenoh_refuses_is_named(how: dict[str, Any], field: str, words: str) -> None:
    with pytest.raises(BadConfig) as caught:
        open_session(SessionSettings(**how))
    assert caught.value.detail["field"] == field
    assert words in caught.value.message
    assert ".rs" not in caught.value.message


def test_a_file_that_is_none(tmp_path: Path) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text("{mode: ")
    with pytest.raises(BadConfig, match="cannot read the Zenoh configuration"):
        open_session(SessionSettings(file=str(file)))


def test_without_a_router_it_is_said_what_to_do() -> None:
    with socket.create_server(("127.0.0.1", 0)) as closed:
        nobody = f"tcp/127.0.0.1:{closed.getsockname()[1]}"
    with pytest.raises(SessionError, match=f"no Zenoh router answers at {nobody}.*'zmav up'.*-e") as caught:
        open_session(SessionSettings(connect=[nobody]))
    assert caught.value.detail["endpoints"] == [nobody]


async def test_what_is_too_large_fills_nobody_s_memory(net: Net) -> None:
    """Zenoh itself takes a gibibyte: what a member sends would lie in each router on the way, and in the vehicle."""
    router, endpoint = net.router()
    ground = net.ground(endpoint)
    came = ground.samples("zmav/demo/quad1/setpoint/*")
    await net.linked(router, "zmav/demo/quad1/setpoint/x")
    sender = net.ground(endpoint)
    await net.linked(sender.session, "zmav/demo/quad1/setpoint/x")
    # A setpoint's own quality of service drops what a busy sender has no room for.
    kept = {**keys.SETPOINT.qos.options(), "congestion_control": zenoh.CongestionControl.BLOCK}
    for size in (LARGEST_PAYLOAD, LARGEST_MESSAGE + 1000, 1):
        await asyncio.to_thread(sender.session.put, "zmav/demo/quad1/setpoint/x", bytes(size), **kept)
    await came.until(lambda: [len(data) for _, data in came.items[-1:]] == [1], "what came last")
    assert [len(payload) for _, payload in came.items] == [LARGEST_PAYLOAD, 1]


def test_a_client_takes_whichever_of_its_routers_answers() -> None:
    with socket.create_server(("127.0.0.1", 0)) as closed:
        nobody = f"tcp/127.0.0.1:{closed.getsockname()[1]}"
    with open_session(SessionSettings(mode="router", listen=["tcp/127.0.0.1:0"])) as router:
        endpoint = endpoint_of(router)
        for connect in ([nobody, endpoint], [endpoint, nobody]):
            with open_session(SessionSettings(connect=connect)) as session:
                assert session.info.routers_zid() == [router.info.zid()]


def test_a_router_that_is_just_starting_is_waited_for() -> None:
    with socket.create_server(("127.0.0.1", 0)) as closed:
        endpoint = f"tcp/127.0.0.1:{closed.getsockname()[1]}"
    with ThreadPoolExecutor() as pool:
        opening = pool.submit(open_session, SessionSettings(connect=[endpoint]))
        with open_session(SessionSettings(mode="router", listen=[endpoint])) as router, opening.result() as session:
            assert session.info.routers_zid() == [router.info.zid()]


@pytest.mark.parametrize("times", [1, 2])
async def test_a_session_that_is_cancelled_as_it_opens_is_closed(monkeypatch: pytest.MonkeyPatch, times: int) -> None:
    begun, free, opened = threading.Event(), threading.Event(), list[zenoh.Session]()

    def slowly(built: zenoh.Config) -> zenoh.Session:
        begun.set()
        free.wait()
        opened.append(open_at_once(built))
        return opened[-1]

    open_at_once = zenoh.open
    monkeypatch.setattr(zenoh, "open", slowly)
    opening = asyncio.ensure_future(open_in_thread(SessionSettings(mode="peer")))
    await asyncio.to_thread(begun.wait)
    for _ in range(times):
        opening.cancel()
        await asyncio.sleep(0)
    free.set()
    with pytest.raises(asyncio.CancelledError):
        await opening
    while not (opened and opened[0].is_closed()):  # its own time limit ends a test that waits for ever
        await asyncio.sleep(0.01)


async def test_what_fails_to_open_does_not_hide_a_cancellation() -> None:
    opening = asyncio.ensure_future(open_in_thread(SessionSettings(mode="peer", cfg=("nonsense",))))
    await asyncio.sleep(0)
    opening.cancel()
    with pytest.raises(asyncio.CancelledError):
        await opening


def test_a_port_in_use_is_said() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        words = f"127.0.0.1:{port} is in use by another program.*-e tcp/127.0.0.1:{port}"
        with pytest.raises(SessionError, match=words):
            open_session(SessionSettings(mode="router", listen=[f"tcp/127.0.0.1:{port}"]))


def test_an_address_that_is_not_ours_is_said() -> None:
    with pytest.raises(SessionError, match=r"router mode: .*192\.0\.2\.1"):
        open_session(SessionSettings(mode="router", listen=["tcp/192.0.2.1:0"]))
