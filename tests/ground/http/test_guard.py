"""The door of the gateway: who is let in, and what malformed requests get."""

from __future__ import annotations

import asyncio
import contextlib
import http.client
import logging
import socket
import time
from typing import TYPE_CHECKING, Any

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from ground.http import guard, server
from ground.http.guard import Rules
from ground.http.server import Patience, bound
from zmav.errors import BadConfig, PortInUse

if TYPE_CHECKING:
    from starlette.types import Message

    from tests.ground.http.conftest import Serve, Served

SITE = "http://blueos.local"
LOCKED = Rules(token="s3cret ü", read_only=True, origins=frozenset({SITE}))


@pytest.fixture(scope="module")
def locked(serve: Serve) -> Served:
    """With a token, reading only, and one site's pages let in."""
    served = serve(LOCKED)
    served.vehicle("quad1", 1)
    return served


TOKEN = {"Authorization": "Bearer s3cret ü".encode().decode("latin-1")}


# The token.


def test_nothing_without_the_token(locked: Served) -> None:
    for path in ("/", "/vehicles", "/metrics", "/keys/quad1", "/v1/mavlink", "/docs", "/nosuch"):
        for headers in ({}, {"Authorization": "Bearer wrong"}, {"Authorization": "Basic czNjcmV0"}):
            reply = locked.request("GET", path, **headers)
            assert (reply.status, reply.headers["www-authenticate"]) == (401, "Bearer"), path
    assert locked.get("/vehicles?token=s3cre").status == 401
    with pytest.raises(InvalidStatus) as refused, websocket(locked, "/v1/ws/mavlink"):
        pass
    assert refused.value.response.status_code == 401


def test_the_token_as_header_or_parameter(locked: Served) -> None:
    assert locked.request("GET", "/vehicles", **TOKEN).status == 200
    assert locked.get("/vehicles", token="s3cret ü").status == 200  # and it is no parameter to /vehicles
    assert locked.get("/last/9/1/HEARTBEAT?token=s3cret%20%C3%BC").status == 404
    with websocket(locked, "/v1/ws/mavlink?filter=HEARTBEAT&token=s3cret%20%C3%BC") as ws:
        ws.ping()


def test_with_a_token_any_name_is_ours(locked: Served) -> None:
    assert locked.request("GET", "/vehicles", Host="drone.example:8088", **TOKEN).status == 200


# Reading only.


@pytest.mark.parametrize(
    ("method", "path"),
    [
        ("GET", "/send/1/1/SET_MODE?base_mode=1&custom_mode=4"),
        ("POST", "/v1/mavlink"),
        ("POST", "/mavlink"),
        ("PUT", "/keys/quad1/mav/tx/1/1/SET_MODE"),
        ("GET", "/do/quad1/land"),
        ("POST", "/do/quad1/land"),
        ("POST", "/keys/demo/quad1/do/land"),
        ("GET", "/setpoint/quad1?n=1&e=2&d=-3"),
        ("GET", "/release/quad1"),
    ],
)
def test_reading_only_refuses_what_writes(locked: Served, method: str, path: str) -> None:
    reply = locked.request(method, path, "{}" if method != "GET" else None, **TOKEN)
    assert reply.status == 403
    assert "--read-only" in reply.text
    assert not locked.tx


def test_reading_only_refuses_what_a_websocket_writes(locked: Served) -> None:
    with websocket(locked, "/ws/mavlink?filter=X&token=s3cret%20%C3%BC") as ws:
        ws.send('{"message": {"type": "SYSTEM_TIME", "time_unix_usec": 1, "time_boot_ms": 1}}')
        assert "only reads" in str(ws.recv(30.0))
    assert not locked.tx


def test_reading_only_still_streams(locked: Served) -> None:
    assert locked.request("GET", "/stream/1/1", **TOKEN).status == 200
    assert locked.request("GET", "/stop/1/1", **TOKEN).status == 200


# Other sites.


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 200),
        ({"Sec-Fetch-Site": "same-origin"}, 200),
        ({"Sec-Fetch-Site": "none", "Sec-Fetch-Mode": "navigate"}, 200),
        ({"Sec-Fetch-Site": "cross-site"}, 403),
        ({"Sec-Fetch-Site": "same-site"}, 403),
        ({"Origin": "http://evil.example"}, 403),
        ({"Origin": "null"}, 403),
        ({"Origin": "http://localhost:1"}, 403),
        ({"Origin": "http://["}, 403),
        ({"Origin": "http://evil.example", "Host": "evil.example"}, 421),
        ({"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate"}, 403),
        ({"Host": "evil.example"}, 421),
        ({"Host": "evil.example:8088"}, 421),
        ({"Host": ""}, 421),
        ({"Host": "[::1]evil"}, 421),
        ({"Host": "[::1]:80evil"}, 421),
        ({"Host": "[localhost]"}, 421),
        ({"Host": "localhost:80:evil"}, 421),
        ({"Host": "localhost:evil"}, 421),
        ({"Host": "LOCALHOST:1"}, 200),
        ({"Host": "[::1]:8088"}, 200),
    ],
)
def test_another_site_s_page_sends_nothing(served: Served, headers: dict[str, str], status: int) -> None:
    reply = served.request("GET", "/send/2/1/SYSTEM_TIME?time_unix_usec=5&time_boot_ms=6", **headers)
    assert reply.status == status
    assert "access-control-allow-origin" not in reply.headers
    served.sent(status == 200)
    assert not served.tx


@pytest.mark.parametrize(
    ("path", "headers", "status"),
    [
        ("/vehicles", {}, 200),
        ("/stop/1/99", {}, 403),
        ("/do/quad1/nosuch", {}, 403),
        ("/do/quad1/nosuch", {"Origin": "http://drone.lan"}, 400),
        ("/do/quad1/nosuch", {"Sec-Fetch-Site": "same-origin"}, 400),
        ("/do/quad1/nosuch", {"Host": "127.0.0.1"}, 400),
    ],
)
def test_under_a_name_that_was_added_a_stranger_s_image_flies_nothing(
    serve: Serve, path: str, headers: dict[str, str], status: int
) -> None:
    """Browsers say whose page asks of this computer's addresses and over TLS, and not under a name of our network."""
    served = serve(Rules(hosts={*guard.LOOPBACK, "drone.lan"}))
    reply = served.request("GET", path, **{"Host": "drone.lan", **headers})
    assert reply.status == status, reply.text


def test_a_link_may_be_followed_to_what_only_reads(served: Served) -> None:
    followed = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate"}
    assert served.request("GET", "/vehicles", **followed).status == 200
    assert served.request("GET", "/stream/1/1", **followed).status == 403
    assert served.request("POST", "/v1/mavlink", "{}", **followed).status == 403


def test_another_site_s_page_opens_no_websocket(served: Served) -> None:
    with pytest.raises(InvalidStatus) as refused, websocket(served, "/v1/ws/mavlink", origin="http://evil.example"):
        pass
    assert refused.value.response.status_code == 403
    with websocket(served, "/v1/ws/mavlink", origin=f"http://127.0.0.1:{served.port}"):
        pass


def test_a_site_that_is_let_in(locked: Served) -> None:
    reply = locked.request("GET", "/vehicles", Origin=SITE, Sec_Fetch_Site="cross-site", **TOKEN)
    assert (reply.status, reply.headers["access-control-allow-origin"]) == (200, SITE)
    asked = locked.request("OPTIONS", "/v1/mavlink", Origin=SITE, Access_Control_Request_Method="POST")
    assert (asked.status, asked.headers["access-control-allow-origin"]) == (200, SITE)
    assert "authorization" in asked.headers["access-control-allow-headers"]
    other = locked.request("GET", "/vehicles", Origin="http://evil.example", **TOKEN)
    assert (other.status, "access-control-allow-origin" in other.headers) == (403, False)


# What is malformed.


@pytest.mark.parametrize(
    "request_line",
    [
        b"GET /last/%00/1/ATTITUDE HTTP/1.1",
        b"GET /last/%ff%fe/1/ATTITUDE HTTP/1.1",
        b"GET /%0d%0aX:1 HTTP/1.1",
        b"GET /last/1/1/" + b"A" * 20_000 + b" HTTP/1.1",
        b"GET /vehicles?" + b"x=1&" * 5_000 + b" HTTP/1.1",
        b"GET /vehicles?" + b"%" * 100 + b" HTTP/1.1",
        b"GET /v1/mavlink/" + b"../" * 50 + b" HTTP/1.1",
        b"GET /send/1/1/SYSTEM_TIME?%FF=%FE&%00=1 HTTP/1.1",
        b"DELETE /vehicles HTTP/1.1",
        b"POST /vehicles HTTP/1.1",
        b"PATCH /v1/mavlink HTTP/1.1",
        b"PUT /send/1/1/SET_MODE HTTP/1.1",
        b"GET /v1/ws/mavlink HTTP/1.1",
        b"GET //// HTTP/1.1",
        b"GET /last/1/1/\xc3\xa4 HTTP/1.1",
        b"nonsense",
        b"GET http://evil/ HTTP/1.1",
        b"GET /" + b"a" * 70_000 + b" HTTP/1.1",
        b"GET /last/1/1/a.b%2Fc HTTP/1.1",
        b"GET /last/\xd9\xa1/1/ATTITUDE HTTP/1.1",
        b"GET /last/%D9%A1/1/ATTITUDE HTTP/1.1",
    ],
)
def test_nonsense_is_the_asker_s_fault(served: Served, request_line: bytes) -> None:
    head = raw(served, request_line + b"\r\nHost: localhost\r\nConnection: close\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 4"), head[:200]
    assert b"Traceback" not in head
    assert not served.tx


def test_an_error_inside_is_no_traceback(
    served: Served, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(served.gateway.client, "fleet", lambda: 1 / 0)
    with caplog.at_level(logging.ERROR):
        reply = served.get("/vehicles")
    assert (reply.status, reply.text) == (500, "an error inside the gateway; its log says which\n")
    assert "ZeroDivisionError" in caplog.text
    monkeypatch.undo()
    assert served.get("/vehicles").status == 200


def test_a_large_body_is_refused(served: Served) -> None:
    reply = raw(served, b"POST /v1/mavlink HTTP/1.1\r\nHost: localhost\r\nContent-Length: 2000000\r\n\r\n")
    assert reply.startswith(b"HTTP/1.1 413")
    chunks = b"10000\r\n" + b" " * 0x10000 + b"\r\n"
    begin = b"POST /v1/mavlink HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n"
    assert raw(served, begin + chunks * 20).startswith(b"HTTP/1.1 413")


def test_a_body_of_two_lengths_is_refused(served: Served) -> None:
    """Anyone who forwards it may take the other one: what follows would be another's request."""
    head = b"POST /do/quad9/hold HTTP/1.1\r\nHost: localhost\r\nContent-Length: 2\r\nTransfer-Encoding: chunked\r\n\r\n"
    reply = raw(served, head + b"2\r\n{}\r\n0\r\n\r\nGET /vehicles HTTP/1.1\r\nHost: localhost\r\n\r\n", whole=True)
    assert reply.startswith(b"HTTP/1.1 400"), reply[:200]
    assert b"Content-Length" in reply
    assert reply.count(b"HTTP/1.1 ") == 1


def test_a_body_that_does_not_come_is_not_waited_for(serve: Serve) -> None:
    served = serve(Rules(body_patience=0.1))
    begin = b"POST /v1/mavlink HTTP/1.1\r\nHost: localhost\r\nContent-Length: 5\r\n\r\n{"
    assert raw(served, begin).startswith(b"HTTP/1.1 408")


def test_a_body_that_breaks_off_is_no_request() -> None:
    """An order whose arguments were lost on the way is none without arguments."""
    said: list[Any] = []

    async def app(*_: object) -> None:
        said.append("was let in")

    async def receive() -> Message:
        return {"type": "http.disconnect"}

    async def send(message: Message) -> None:
        said.append(message.get("status"))

    headers = [(b"host", b"localhost"), (b"content-length", b"20")]
    scope = {"type": "http", "method": "POST", "path": "/do/quad1/arm", "headers": headers}
    asyncio.run(guard.Guard(app, Rules())(scope, receive, send))
    assert said[0] == 400


@pytest.mark.parametrize("begin", [b"", b"GET /vehi"])
def test_a_request_that_does_not_come_is_not_waited_for(serve: Serve, begin: bytes) -> None:
    assert raw(serve(patience=Patience(stranger=0.1)), begin) == b""


def test_nor_is_a_second_one(serve: Serve) -> None:
    served = serve(patience=Patience(head=0.5))
    with socket.create_connection(("127.0.0.1", served.port), 30.0) as sock:
        sock.sendall(b"GET /nosuch HTTP/1.1\r\nHost: localhost\r\n\r\nGET /vehi")
        answer = b"".join(iter(lambda: sock.recv(65536), b""))
    assert answer.startswith(b"HTTP/1.1 404")
    assert answer.count(b"HTTP/1.1") == 1


def test_connections_that_ask_nothing_shut_nobody_out(locked: Served) -> None:
    """More than the gateway takes at once, and none of them says who it is."""
    held: list[socket.socket] = []
    with contextlib.ExitStack() as stack:
        for number in range(server.CONNECTIONS + 8):
            held.append(stack.enter_context(socket.create_connection(("127.0.0.1", locked.port), 30.0)))
            if number % 2:
                held[-1].sendall(b"GET /vehi")
        assert locked.request("GET", "/vehicles", **TOKEN).status == 200
        assert held[0].recv(1) == b"", "the oldest is shut"


def test_one_address_s_connections_do_not_shut_another_s(locked: Served) -> None:
    with contextlib.ExitStack() as stack:
        mine = stack.enter_context(socket.create_connection(("127.0.0.1", locked.port), 30.0, ("127.0.0.2", 0)))
        for _ in range(server.IDLE + server.IDLE_EACH):
            stack.enter_context(socket.create_connection(("127.0.0.1", locked.port), 30.0))
        mine.sendall(b"GET /vehicles HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer wrong\r\n\r\n")
        assert mine.recv(65536).startswith(b"HTTP/1.1 401")


def test_a_connection_that_showed_its_token_is_waited_for_longer(serve: Serve) -> None:
    locked = serve(LOCKED, patience=Patience(stranger=0.1))
    locked.vehicle("quad1", 1)
    with contextlib.closing(http.client.HTTPConnection("127.0.0.1", locked.port, timeout=30.0)) as known:
        known.auto_open = 0  # it does not begin again by itself
        known.connect()
        known.request("GET", "/vehicles", headers=TOKEN)
        assert known.getresponse().read()
        stranger = b"GET /vehicles HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer wrong\r\n\r\n"
        assert raw(locked, stranger, whole=True).startswith(b"HTTP/1.1 401")
        begun = time.monotonic()
        anybody = b"GET /static/main.js HTTP/1.1\r\nHost: x\r\n\r\n"
        assert raw(locked, anybody, whole=True).startswith(b"HTTP/1.1 200")
        assert time.monotonic() - begun < Patience().head / 2, "that file shows no token"
        known.request("GET", "/vehicles", headers=TOKEN)
        assert known.getresponse().status == 200


def test_the_form_of_an_error_is_its_face_s(served: Served) -> None:
    assert served.request("POST", "/vehicles").text == "POST cannot be used on /vehicles\n"
    assert served.request("PUT", "/v1/mavlink").json == "PUT cannot be used on /v1/mavlink"
    assert served.get("/nosuch").json["error"]["kind"] == "not_found"


# The port.


def test_a_port_in_use_and_a_host_that_is_not_ours() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(PortInUse, match=f"port {port} of 127.0.0.1 is in use by another program"):
            bound("127.0.0.1", port)
    with pytest.raises(BadConfig, match=r"cannot listen on 192\.0\.2\.1"):
        bound("192.0.2.1", 0)
    with pytest.raises(BadConfig, match=r"no\.such\.host\.invalid"):
        bound("no.such.host.invalid", 0)


def websocket(served: Served, path: str, **how: Any) -> Any:
    return connect(f"ws://127.0.0.1:{served.port}{path}", open_timeout=30.0, **how)


def raw(served: Served, data: bytes, whole: bool = False) -> bytes:
    """What is answered to bytes: the first part of it, or the whole until the gateway shuts the connection."""
    with socket.create_connection(("127.0.0.1", served.port), 30.0) as sock:
        with contextlib.suppress(ConnectionError):  # the answer may come before all is sent
            sock.sendall(data)
        with contextlib.suppress(ConnectionError):
            return b"".join(iter(lambda: sock.recv(65536), b"")) if whole else sock.recv(65536)
    return b""
