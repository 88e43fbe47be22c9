"""What listens: the HTTP gateway and the ground station bridge on sockets, and a vehicle's orders. Whatever is sent,
none of them logs an error.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import logging
import random
import re
import socket
import threading
import time
import traceback
import urllib.parse
from collections.abc import Coroutine, Iterator
from typing import Any, TypeVar

import zenoh
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

import zmav
from ground.gcs.tcp import TcpIn
from ground.gcs.udp import UdpIn
from ground.http.guard import Rules
from ground.http.server import Patience
from tests.conftest import Net
from tests.fuzz.engine import TOKENS, Run, Target
from tests.fuzz.targets.frames import stream, the_dialect
from tests.fuzz.targets.payloads import example, json_words
from tests.ground.gcs.conftest import Scene
from tests.ground.http.conftest import FLEET, Serve, Served
from zmav import keys, wire
from zmav.errors import ZmavError
from zmav.mavlink import Packer
from zmav.onboard import Onboard, OnboardSettings
from zmav.sim import VehicleSpec, World
from zmav.verbs import VERBS

T = TypeVar("T")
PATIENCE_S = 30.0
HURRY = 0.05
"""s for what does not come, instead of the seconds that real clients have"""


OURS = ("zmav", "mesh", "ground", "agents")


class Faults(logging.Handler):
    """Collects what is logged as an error by our loggers, and by others' where its traceback leads through our code:
    callbacks that nobody waits for. What a library, or another test's remains, has to say is nobody's fault here.
    """

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self.heard: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        if not _is_ours(record):
            return
        trace = logging.Formatter().formatException(record.exc_info) if record.exc_info else ""
        self.heard.append(f"{record.getMessage()}\n{trace}")

    def check(self) -> None:
        heard, self.heard = self.heard, []
        assert not heard, "\n".join(heard)


def _is_ours(record: logging.LogRecord) -> bool:
    names = [record.name]
    if record.exc_info and record.exc_info[2] is not None:
        names += [frame.f_globals.get("__name__", "") for frame, _ in traceback.walk_tb(record.exc_info[2])]
    return any(name.partition(".")[0] in OURS for name in names)


@contextlib.contextmanager
def watched() -> Iterator[Faults]:
    faults = Faults()
    logging.getLogger().addHandler(faults)
    try:
        yield faults
    finally:
        logging.getLogger().removeHandler(faults)


class Loop:
    """An event loop in a thread of its own."""

    def __enter__(self) -> Loop:
        self.loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self.loop.run_forever, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.loop.call_soon_threadsafe(self.loop.stop)
        self._thread.join(PATIENCE_S)
        self.loop.close()

    def call(self, coroutine: Coroutine[Any, Any, T]) -> T:
        return asyncio.run_coroutine_threadsafe(coroutine, self.loop).result(PATIENCE_S)


# HTTP.


def _beat(session: zenoh.Session) -> None:
    """A vehicle that was heard a moment ago."""
    state = wire.VehicleState(
        t=time.time(),
        fleet=FLEET,
        name="quad1",
        instance="quad11",
        connected=True,
        sysid=1,
        compid=1,
        autopilot="ardupilot",
        kind="copter",
        mode="GUIDED",
        armed=True,
    )
    session.put(keys.STATE.key(FLEET, "quad1"), wire.encode(state))


def _answer(query: zenoh.Query) -> None:
    """As a vehicle that has done everything at once."""
    with query:
        key = str(query.key_expr)
        if "*" not in key:
            query.reply(key, wire.encode(wire.Outcome(verb=key.rpartition("/")[2], status="done", took=0.0)))


@contextlib.contextmanager
def gateway() -> Iterator[tuple[Served, Faults]]:
    serve = Serve()
    with watched() as faults:
        try:
            served = serve(Rules(body_patience=HURRY), patience=Patience(HURRY, HURRY))
            answering = served.session.declare_queryable(f"zmav/{FLEET}/quad1/**", _answer)
            served.vehicle("quad1", 1)
            served.hear("SYSTEM_TIME", time_unix_usec=5, time_boot_ms=6)
            yield served, faults
            answering.undeclare()
        finally:
            serve.close()


@contextlib.contextmanager
def http() -> Iterator[Run]:
    with gateway() as (served, faults):

        def run(data: bytes) -> None:
            _beat(served.session)
            answer = _sent(served.port, data)
            faults.check()
            assert not answer or answer.startswith(b"HTTP/1."), answer[:200]
            assert b"HTTP/1.1 500" not in answer, answer[:500]
            if answer.startswith((b"HTTP/1.1 4", b"HTTP/1.1 5")) or not answer:
                raise ZmavError("refused")

        yield run


def _sent(port: int, data: bytes) -> bytes:
    """What is answered until the gateway shuts the connection, or says nothing more: a stream goes on."""
    found = b""
    with socket.create_connection(("127.0.0.1", port), PATIENCE_S) as sock, contextlib.suppress(OSError):
        sock.sendall(data)
        sock.settimeout(4 * HURRY)
        while part := sock.recv(65536):
            found += part
            if len(found) > 1_000_000:
                break
    return found


def requests() -> list[bytes]:
    def ask(line: str, body: bytes = b"", *more: str) -> bytes:
        length = [f"Content-Length: {len(body)}"] if body else []
        head = [f"{line} HTTP/1.1", "Host: localhost", "Connection: close", *length, *more]
        return "\r\n".join((*head, "", "")).encode() + body

    chunked = b'8\r\n{"alt_re\r\n6;x=y\r\nl": 5}\r\n0\r\nTrailer: x\r\n\r\n'
    sha = ("Upgrade: websocket", "Sec-WebSocket-Version: 13", "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==")
    return [
        ask("GET /vehicles"),
        ask("GET /last/1/1/SYSTEM_TIME"),
        ask("GET /send/1/1/SET_MODE?base_mode=1&custom_mode=4"),
        ask("GET /stop/1/1"),
        ask("GET /v1/mavlink/vehicles/1/components/1/messages/SYSTEM_TIME"),
        ask("GET /metrics"),
        ask("GET /keys/quad1/SYSTEM_TIME?timeout=0.1"),
        ask("GET /v1/helper/mavlink?name=COMMAND_LONG"),
        ask("POST /do/quad1/goto?arrive=false", b'{"pos": [1, 2, -3]}', "Content-Type: application/json"),
        ask("POST /do/quad1/takeoff", b"alt_rel=5&id=7", "Content-Type: application/x-www-form-urlencoded"),
        ask("POST /fleet/hold", b'{"vehicles": ["quad*"]}'),
        ask("POST /v1/mavlink", b'{"message": {"type": "SYSTEM_TIME", "time_unix_usec": 1, "time_boot_ms": 1}}'),
        ask("GET /setpoint/quad1?n=1&e=2&d=-3"),
        ask("GET /release/quad1"),
        b"POST /do/quad1/takeoff HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n" + chunked,
        b"GET /ws HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\n" + "\r\n".join((*sha, "", "")).encode(),
    ]


def request(rng: random.Random, data: bytes) -> bytes | None:
    """A sound request around something odd: in the body, of which the length is right again, or in the address."""
    head, blank, body = data.partition(b"\r\n\r\n")
    line, _, rest = head.partition(b"\r\n")
    words = line.split(b" ")
    if len(words) != 3 or not blank:
        return None
    if body and rng.random() < 0.6:
        body = json_words(rng, body) or body
    else:
        parts = re.split(rb"([/?&=])", words[1])
        odd = urllib.parse.quote(rng.choice(TOKENS)[:300], safe="*{}[],:\"'").encode()
        parts[rng.randrange(len(parts))] = odd
        words[1] = b"/" + b"".join(parts).lstrip(b"/")
    rest = re.sub(rb"Content-Length: [0-9]+", b"Content-Length: %d" % len(body), rest)
    return b" ".join(words) + b"\r\n" + rest + blank + body


@contextlib.contextmanager
def websockets() -> Iterator[Run]:
    """Messages on both kinds of WebSocket, which stay open."""
    with gateway() as (served, faults), contextlib.ExitStack() as stack:
        opened: dict[str, ClientConnection] = {}
        turns = itertools.cycle(("/ws", "/v1/ws/mavlink?filter=ATT"))

        def run(data: bytes) -> None:
            _beat(served.session)
            path = next(turns)
            if path not in opened:
                url = f"ws://127.0.0.1:{served.port}{path}"
                opened[path] = stack.enter_context(connect(url, open_timeout=PATIENCE_S))
            try:
                opened[path].send(data.decode("utf-8", "replace"))
                opened[path].recv(HURRY / 5)
            except TimeoutError:
                pass
            except ConnectionClosed:
                del opened[path]
            faults.check()

        yield run


def messages() -> list[bytes]:
    return [
        b'{"subscribe": "quad1/SYSTEM_TIME", "hz": 5}',
        b'{"unsubscribe": "quad1/SYSTEM_TIME"}',
        b'{"ping": 7}',
        b'{"header": {"system_id": 1}, "message": {"type": "SYSTEM_TIME", "time_unix_usec": 1, "time_boot_ms": 1}}',
    ]


# The bridge.


@contextlib.contextmanager
def bridge() -> Iterator[Run]:
    """By TCP and by UDP in turn, as a station that then goes away."""
    net = Net()
    with watched() as faults, Loop() as loop:
        stack = contextlib.AsyncExitStack()
        try:
            scene = Scene(net, stack)
            scene.craft("quad1", 1)
            opened = loop.call(scene.bridge())
            tcp, udp = (_address(kind, opened.endpoints) for kind in (TcpIn, UdpIn))
            for_udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            turns = itertools.cycle((True, False))

            def run(data: bytes) -> None:
                if next(turns):
                    with socket.create_connection(tcp, PATIENCE_S) as sock, contextlib.suppress(OSError):
                        sock.sendall(data)
                        sock.shutdown(socket.SHUT_WR)
                        while sock.recv(65536):
                            pass
                else:
                    for_udp.sendto(data[:60_000], udp)
                    loop.call(asyncio.sleep(0))
                faults.check()

            yield run
            for_udp.close()
        finally:
            loop.call(stack.aclose())
            for session in reversed(net.sessions):
                session.close()


def _address(kind: type[Any], endpoints: Any) -> Any:
    (end,) = (each for each in endpoints if isinstance(each, kind))
    return end.address[:2]


def from_stations() -> list[bytes]:
    packer = Packer(the_dialect(), 255, 190)
    to = {"target_system": 1, "target_component": 1}
    beat = packer.pack("HEARTBEAT", type=6, autopilot=8, system_status=4)
    asked = [
        packer.pack("COMMAND_LONG", **to, command=400, param1=1.0),
        packer.pack("PARAM_REQUEST_LIST", **to),
        packer.pack("PARAM_REQUEST_READ", **to, param_id="RTL_ALT", param_index=-1),
        packer.pack("PARAM_SET", **to, param_id="RTL_ALT", param_value=5.0, param_type=9),
        packer.pack("MISSION_REQUEST_LIST", **to),
        packer.pack("MISSION_COUNT", **to, count=3),
        packer.pack("MISSION_REQUEST_INT", **to, seq=1),
        packer.pack("MISSION_ITEM_INT", **to, seq=0, command=16),
        packer.pack("MISSION_ACK", **to),
        packer.pack("REQUEST_DATA_STREAM", **to, req_message_rate=4, start_stop=1),
        packer.pack("FILE_TRANSFER_PROTOCOL", target_system=1, payload=[1, 0, 0, 4, 9] + [0] * 246),
        packer.pack("SET_MODE", target_system=1, base_mode=1, custom_mode=4),
        packer.pack("LOG_ERASE", **to),
        packer.pack("LOG_REQUEST_LIST", **to, end=9),
        packer.pack("COMMAND_INT", **to, command=512, param1=148.0),
    ]
    return [beat + each for each in asked] + [beat + b"".join(asked)]


# Orders.


@contextlib.contextmanager
def orders() -> Iterator[Run]:
    """A simulated vehicle's real agent: the first line of an input is the verb, the rest its arguments."""
    net, numbers = Net(), itertools.count()
    spec = VehicleSpec(name="quad1", params={"DISARM_DELAY": 0.0})
    with watched() as faults, World([spec], endpoint="tcp:0", speed=8.0, ready_s=0.5) as world, Loop() as loop:
        session, _ = net.router()
        settings = OnboardSettings(link=world.urls[0], name="quad1", origin=ORIGIN)
        vehicle = loop.call(_begun(session, settings))
        try:

            def run(data: bytes) -> None:
                verb, _, arguments = data.partition(b"\n")
                name = verb.decode("latin-1")
                name = name if name in VERBS else sorted(VERBS)[len(data) % len(VERBS)]
                key = keys.DO.key("demo", "quad1", verb=name)
                told = _told(arguments, next(numbers))
                replies = list(session.get(key, payload=told, timeout=1.0))
                said = [reply.err.payload.to_bytes() for reply in replies if reply.err is not None]
                for each in said:
                    assert b"inside the agent" not in each, each
                for operation in vehicle.orders.operations:
                    task = operation.task
                    error = task.exception() if task.done() and not task.cancelled() else None
                    assert error is None or isinstance(error, ZmavError), (operation.verb, error)
                faults.check()
                if said:
                    raise wire.error_from(said[0])

            yield run
        finally:
            loop.call(vehicle.__aexit__(None, None, None))
            for each in reversed(net.sessions):
                each.close()


ORIGIN = wire.Origin(lat_deg=-35.363261, lon_deg=149.165230, alt_amsl=584.09)


async def _begun(session: zenoh.Session, settings: OnboardSettings) -> Onboard:
    return await Onboard(session, settings).__aenter__()


@contextlib.contextmanager
def tokens() -> Iterator[Run]:
    """Liveliness tokens, whatever their keys say, beside a vehicle's agent and a client; each comes and goes."""
    net = Net()
    with watched() as faults, World([VehicleSpec(name="quad1")], endpoint="tcp:0") as world, Loop() as loop:
        session, endpoint = net.router()
        stranger = net.ground(endpoint).session
        vehicle = loop.call(_begun(session, OnboardSettings(link=world.urls[0], name="quad1", origin=ORIGIN)))
        client = zmav.open(fleet="*", connect=[endpoint])
        try:
            z = loop.call(client.__aenter__())

            def run(data: bytes) -> None:
                try:
                    token = stranger.liveliness().declare_token(data.decode("utf-8", "replace"))
                except zenoh.ZError as e:
                    raise ZmavError("no key") from e
                loop.call(asyncio.sleep(0.002))
                token.undeclare()
                loop.call(asyncio.sleep(0.002))
                z.fleet()
                faults.check()

            yield run
        finally:
            loop.call(client.__aexit__(None, None, None))
            loop.call(vehicle.__aexit__(None, None, None))
            for each in reversed(net.sessions):
                each.close()


def token_keys() -> list[bytes]:
    about = {"sys": 1, "autopilot": "ardupilot", "uid": "none", "instance": "a1"}
    found = [keys.ALIVE.key("demo", name, role=role, **about) for name in ("quad1", "quad2") for role in ROLES]
    found += [keys.WANT.key("demo", "quad1", msg=msg, hz=5, instance="a1") for msg in ("ATTITUDE", "UNKNOWN_410")]
    tokens = [each for each in keys.CHANNELS.values() if each.kind == "token"]
    found += [re.sub(r"{(\w+)}", "a1", each.template) for each in tokens]
    return [each.encode() for each in found]


ROLES = (keys.VEHICLE, keys.OPERATOR, keys.PLANNER, keys.REPLAY)


def key_chunk(rng: random.Random, data: bytes) -> bytes:
    """One part of the key becomes another's, or something odd."""
    parts = data.split(b"/")
    odd = rng.choice(TOKENS)[:60].replace(b"/", b"")
    parts[rng.randrange(len(parts))] = rng.choice((odd, b"QUAD1", b"a b", b"", rng.choice(parts)))
    return b"/".join(parts)


def _told(arguments: bytes, number: int) -> bytes:
    """With an id of its own, so that the answer comes at once; as they are where they are no object."""
    try:
        given = json.loads(arguments)
        if isinstance(given, dict):
            return json.dumps({**given, "id": f"n{number}", "wait": 0.02, "uid": "", "lease": ""}).encode()
    except (ValueError, RecursionError):
        pass
    return arguments


def order_texts() -> list[bytes]:
    item = {"command": "MAV_CMD_NAV_WAYPOINT", "params": [0, 0, 0, None], "x": -35.363, "y": 149.165, "z": 12.0}
    sensible: list[tuple[str, dict[str, Any]]] = [
        ("mission_upload", {"kind": "mission", "items": [item, {**item, "z": 15.0}]}),
        ("set_mode", {"mode": "GUIDED"}),
        ("command", {"command": "DO_SET_SERVO", "params": {"Instance": 5, "PWM": 1500}}),
        ("arm", {"ready_timeout": 0}),
        ("command", {"command": "DO_REPOSITION", "params": {"param5": -35.36}, "frame": "MAV_FRAME_GLOBAL_INT"}),
        ("takeoff", {"alt_rel": 5}),
        ("goto", {"pos": [3, 2, -6], "arrive": False}),
        ("file_list", {"path": "/"}),
        ("goto", {"frame": "global", "lat_deg": -35.363, "lon_deg": 149.165, "alt_rel": 8, "yaw": 1, "arrive": False}),
        ("param_set", {"name": "RTL_ALT", "value": 1500}),
        ("param_load", {"values": {"RTL_ALT": 1600, "NONE": 1}}),
    ]
    made = [(verb, example(each.args, whole)) for verb, each in VERBS.items() for whole in (True, False)]
    return [f"{verb}\n{json.dumps(arguments)}".encode() for verb, arguments in (*sensible, *made)]


TARGETS = (
    Target("http", http, requests, 150, request),
    Target("websockets", websockets, messages, 150, json_words),
    Target("bridge", bridge, from_stations, 500, stream),
    Target("tokens", tokens, token_keys, 100, key_chunk),
    Target("orders", orders, order_texts, 60, json_words),
)
