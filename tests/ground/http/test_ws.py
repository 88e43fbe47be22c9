"""The WebSocket: subscriptions with rate caps, events in order, and clients that talk nonsense or do not read."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
import threading
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import pytest
import zenoh
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from ground.http import ws as ours
from ground.http.guard import Rules
from ground.http.ws import MOST_QUEUED, Outbox
from zmav import keys, wire
from zmav.waiting import within

if TYPE_CHECKING:
    from tests.ground.http.conftest import Serve, Served

PATIENCE_S = 30.0


class Client:
    """A client of ``/ws``: what it is told comes by :meth:`get`."""

    def __init__(self, served: Served, query: str = "", **how: Any) -> None:
        url = f"ws://127.0.0.1:{served.port}/ws{query}"
        self._stack = contextlib.ExitStack()
        self.connection: ClientConnection = self._stack.enter_context(
            connect(url, open_timeout=PATIENCE_S, proxy=None, **how)
        )

    def close(self) -> None:
        self._stack.close()

    def say(self, message: Any) -> None:
        self.connection.send(message if isinstance(message, (str, bytes)) else json.dumps(message))

    def get(self) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(self.connection.recv(PATIENCE_S))
        return found

    def until(self, true: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        while not true(found := self.get()):
            pass
        return found

    def ask(self, message: Any) -> dict[str, Any]:
        """Say something, and wait for the answer to it among the samples."""
        self.say(message)
        return self.until(lambda found: "key" not in found)


@pytest.fixture
def client(served: Served) -> Iterator[Client]:
    client = Client(served)
    yield client
    client.close()


def attitude(served: Served, roll: float) -> None:
    served.hear("ATTITUDE", roll=roll, time_boot_ms=1, pitch=0, yaw=0, rollspeed=0, pitchspeed=0, yawspeed=0)


def test_states_and_frames_come_decoded(served: Served, client: Client) -> None:
    told = client.ask({"subscribe": "quad*/ATTITUDE"})
    assert told == {"subscribed": "zmav/demo/quad$*/mav/rx/*/*/ATTITUDE", "hz": None}
    assert client.ask({"subscribe": "quad1"}) == {"subscribed": "zmav/demo/quad1/state", "hz": None}
    attitude(served, 0.25)
    found = client.get()
    assert found["key"] == "zmav/demo/quad1/mav/rx/1/1/ATTITUDE"
    assert found["value"]["fields"]["roll"] == 0.25
    assert abs(found["t"] - time.time()) < 60.0
    served.vehicle("quad1", 1)
    found = client.until(lambda each: each["key"].endswith("/state"))
    assert found["value"]["mode"] == "GUIDED"


def test_the_address_itself_can_subscribe(served: Served) -> None:
    client = Client(served, "?key=quad1/ATTITUDE&key=quad2/ATTITUDE&hz=5")
    assert [client.get()["subscribed"].split("/")[2] for _ in range(2)] == ["quad1", "quad2"]
    client.close()
    wrong = Client(served, "?key=quad1&hz=fast")
    error = wrong.get()["error"]
    assert error["field"] == "hz" and error["text"].endswith(" Hz")
    wrong.close()
    mixed = Client(served, "?key=quad1/%23&key=quad2/ATTITUDE")
    assert mixed.get()["error"]["field"] == "key"
    assert "quad2" in mixed.get()["subscribed"]
    mixed.close()


def test_a_rate_is_wanted_as_long_as_it_is_read(served: Served, client: Client) -> None:
    wanted: set[str] = set()
    news = threading.Condition()

    def on_token(sample: zenoh.Sample) -> None:
        with news:
            (wanted.add if sample.kind == zenoh.SampleKind.PUT else wanted.discard)(str(sample.key_expr))
            news.notify_all()

    def until(true: Callable[[], bool]) -> bool:
        with news:
            return news.wait_for(true, PATIENCE_S)

    pattern = keys.WANT.key("demo", "quad1", msg="VFR_HUD", hz="*", instance="*")
    watch = served.session.liveliness().declare_subscriber(pattern, on_token, history=True)
    client.ask({"subscribe": "quad1/VFR_HUD", "hz": 4})
    assert until(lambda: any("/VFR_HUD/4/http-" in key for key in wanted)), wanted
    client.ask({"subscribe": "quad1/VFR_HUD", "hz": 8})
    assert until(lambda: [key.split("/")[5] for key in wanted] == ["8"]), wanted
    client.ask({"unsubscribe": "quad1/VFR_HUD"})
    assert until(lambda: not wanted), wanted
    client.ask({"subscribe": "quad1/VFR_HUD", "hz": 4})
    assert until(lambda: bool(wanted))
    client.close()
    assert until(lambda: not wanted), wanted
    watch.undeclare()


def test_pictures_and_other_bytes_and_deletions(served: Served, client: Client) -> None:
    client.ask({"subscribe": "zmav/demo/quad1/camera/**"})
    key = "zmav/demo/quad1/camera/down/frame"
    served.linked(key)
    served.session.put(key, b"\xff\xd8\xff", encoding=zenoh.Encoding.IMAGE_JPEG)
    assert client.get()["value"] == {"content_type": "image/jpeg", "base64": "/9j/"}
    served.session.put(key, b"\x00\xff")
    assert client.get()["value"] == {"hex": "00ff"}
    served.session.put(key, b'{"a": NaN}')
    assert client.get()["value"] == {"hex": b'{"a": NaN}'.hex()}
    served.session.delete(key)
    assert client.get() | {"t": 0} == {"key": key, "t": 0, "value": None, "deleted": True}


@pytest.mark.parametrize(
    ("said", "words"),
    [
        ("{", "not understood"),
        ("[]", "not understood"),
        (b"\xff\xfe", "not understood"),
        ("[" * 3000, "not understood"),
        ("{}", "one of subscribe"),
        ({"subscribe": "quad1", "unsubscribe": "quad1"}, "one of subscribe"),
        ({"subscribe": 5}, "not understood"),
        ({"subscribe": "quad1", "often": 5}, "often"),
        ({"subscribe": "quad1", "hz": 0}, "hz"),
        ({"subscribe": "quad1", "hz": 1e9}, "hz"),
        ({"subscribe": "quad1/event", "history": -1}, "history"),
        ({"subscribe": "quad1//state"}, "not a key expression"),
        ({"unsubscribe": "quad1/link/*"}, "was not subscribed to"),
    ],
)
def test_nonsense_is_answered_and_the_socket_lives(client: Client, said: Any, words: str) -> None:
    assert words in client.ask(said)["error"]["text"]
    assert client.ask({"ping": 7}) == {"pong": 7}


def test_subscriptions_are_bounded(client: Client) -> None:
    for number in range(ours.MOST_SUBSCRIPTIONS):
        assert "subscribed" in client.ask({"subscribe": f"zmav/demo/quad1/agent/a{number}/status"})
    refused = client.ask({"subscribe": "quad1/link/*"})
    assert str(ours.MOST_SUBSCRIPTIONS) in refused["error"]["text"]
    client.ask({"unsubscribe": "zmav/demo/quad1/agent/a0/status"})
    assert "subscribed" in client.ask({"subscribe": "quad1/link/*"})


def test_a_client_that_does_not_read_is_cut_off_and_others_read_on(
    served: Served,
    client: Client,
) -> None:
    key = "zmav/demo/quad1/agent/loud/status"
    deaf = socket.create_connection(("127.0.0.1", served.port), timeout=PATIENCE_S)
    deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    deaf.sendall(
        f"GET /ws?key={key} HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n".encode()
    )
    client.ask({"subscribe": key})
    figures = served.gateway.figures
    served.until(lambda: figures["subscriptions"]() == 2, "two subscriptions")
    body = json.dumps({"t": 0, "agent": "loud", "state": "x" * 200_000})
    publisher = served.session.declare_publisher(key, congestion_control=zenoh.CongestionControl.BLOCK)
    served.until(lambda: bool(publisher.matching_status.matching), "a way to the gateway")  # type: ignore[attr-defined]
    end = time.monotonic() + PATIENCE_S
    while not figures["cut"]() and time.monotonic() < end:
        publisher.put(body)
        assert client.get()["key"] == key
        time.sleep(0.1)  # the reader's own pace: what stalls is the other
    served.until(lambda: figures["cut"]() == 1 and figures["websockets"]() == 1, "socket cut off")
    assert client.ask({"ping": 1}) == {"pong": 1}
    deaf.close()


def test_sockets_share_what_they_read_and_end_apart(served: Served, client: Client) -> None:
    other = Client(served, "?key=quad1/ATTITUDE")
    other.get()
    client.ask({"subscribe": "quad1/ATTITUDE"})
    attitude(served, 0.5)
    assert client.get() == other.get()
    other.close()
    served.until(lambda: served.gateway.figures["websockets"]() == 1, "end of the other")
    attitude(served, 0.75)
    assert client.get()["value"]["fields"]["roll"] == 0.75
    client.ask({"unsubscribe": "quad1/ATTITUDE"})
    client.ask({"subscribe": "quad1/ATTITUDE"})
    attitude(served, 1.0)
    assert client.get()["value"]["fields"]["roll"] == 1.0


def test_a_token_and_another_site(serve: Serve, served: Served) -> None:
    guarded = serve(Rules(token="secret"))
    with pytest.raises(InvalidStatus):
        Client(guarded)
    client = Client(guarded, "?token=secret&key=quad1")
    assert "subscribed" in client.get()
    client.close()
    with pytest.raises(InvalidStatus):
        Client(served, additional_headers={"Origin": "http://elsewhere.example"})


def test_a_client_that_vanishes_leaves_nothing(served: Served) -> None:
    client = Client(served, "?key=quad1/ATTITUDE&hz=3")
    client.get()
    served.until(lambda: served.gateway.figures["websockets"]() == 1, "socket")
    client.connection.socket.shutdown(socket.SHUT_RDWR)
    served.until(lambda: served.gateway.figures["websockets"]() == 0, "end of the socket")
    with contextlib.suppress(ConnectionClosed, OSError):
        client.close()


def test_events_all_come_in_order(served: Served, client: Client) -> None:
    client.ask({"subscribe": "quad1/event", "hz": 1})
    key = keys.EVENT.key("demo", "quad1")
    served.linked(key)
    for number in range(20):
        event = wire.Event(t=float(number), kind="statustext", severity="info", text=f"word {number}")
        served.session.put(key, wire.encode(event), congestion_control=zenoh.CongestionControl.BLOCK)
    assert [client.get()["value"]["t"] for _ in range(20)] == [float(number) for number in range(20)]


# The outbox itself, with a clock of its own making.


async def test_of_each_key_the_newest_waits() -> None:
    outbox: Outbox[str] = Outbox()
    for number in range(5):
        outbox.put(1, "a", f"a{number}")
        outbox.put(1, "b", f"b{number}")
    assert [await outbox.get({}), await outbox.get({})] == ["a4", "b4"]
    assert outbox.dropped == 0


async def test_a_rate_cap_holds_back_and_sends_the_newest_when_it_is_due() -> None:
    outbox: Outbox[str] = Outbox()
    outbox.put(1, "a", "first")
    assert await outbox.get({1: 0.2}) == "first"
    sent = asyncio.get_running_loop().time()
    outbox.put(1, "a", "old")
    outbox.put(1, "a", "new")
    outbox.put(2, "a", "another subscription's")
    assert await outbox.get({1: 0.2}) == "another subscription's"
    assert await outbox.get({1: 0.2}) == "new"
    assert asyncio.get_running_loop().time() - sent > 0.15
    with pytest.raises(asyncio.TimeoutError):
        await within(0.05, outbox.get({1: 0.2}))


async def test_what_was_unsubscribed_is_not_sent() -> None:
    outbox: Outbox[str] = Outbox()
    outbox.put(1, "a", "gone")
    outbox.queue(1, "gone, too")
    outbox.put(2, "a", "kept")
    outbox.forget(1)
    assert await outbox.get({}) == "kept"


async def test_memory_is_bounded() -> None:
    outbox: Outbox[int] = Outbox(most_keys=10)
    for number in range(50):
        outbox.put(1, f"key{number}", number)
    for number in range(MOST_QUEUED + 5):
        outbox.queue(1, number)
    assert outbox.dropped == 45
    for number in range(MOST_QUEUED):
        assert await outbox.get({}) == number
    assert [await outbox.get({}) for _ in range(10)] == list(range(10))
    outbox.put(1, "key50", 50)
    assert await outbox.get({}) == 50
