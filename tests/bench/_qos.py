"""The processes of the quality-of-service benchmark.

_qos.py air RATE QUEUE LEFT RIGHT      a radio: UDP through a bucket of so many bytes/s and a queue of so many seconds
_qos.py far CONFIG                     the ground's router and its readers
_qos.py near CONFIG                    the vehicle's router, what it says, and who commands through it
_qos.py video CONFIG                   its camera, in a session of its own
"""

from __future__ import annotations

import collections
import contextlib
import heapq
import json
import selectors
import socket
import struct
import subprocess
import sys
import threading
import time
from typing import Any

import zenoh

from mesh.bearer.bearer import Bearer, Far
from zmav import keys
from zmav.config import Radio
from zmav.session import SessionSettings, open_session

STAMP = struct.Struct("<Qd")
FLEET, VEHICLE = "demo", "quad1"
RAW = 20
"""messages of raw telemetry, at 10 Hz each"""
SETPOINT_HZ = 50
RX = {"sys": 1, "comp": 1}
CAMERA = f"zmav/{FLEET}/{VEHICLE}/camera/front/frame"


def stamped(number: int, size: int) -> bytes:
    return STAMP.pack(number, time.monotonic()).ljust(size, b".")


def air(rate: float, queue: float, left: int, right: int) -> None:
    """From ``left`` to anyone who listens on ``right``, and back; what finds the queue full is dropped."""
    inner = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    inner.bind(("127.0.0.1", left))
    inner.setblocking(False)
    selector = selectors.DefaultSelector()
    selector.register(inner, selectors.EVENT_READ, None)
    outer: dict[Any, socket.socket] = {}
    due: list[tuple[float, int, socket.socket, Any, bytes]] = []
    free, count = [0.0, 0.0], 0
    print("ready", flush=True)
    while True:
        for key, _ in selector.select(max(due[0][0] - time.monotonic(), 0.0) if due else None):
            sock: Any = key.fileobj
            with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
                while True:
                    data, source = sock.recvfrom(65536)
                    back = sock is not inner
                    if not back and source not in outer:
                        made = outer[source] = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
                        made.connect(("127.0.0.1", right))
                        made.setblocking(False)
                        selector.register(made, selectors.EVENT_READ, source)
                    now = time.monotonic()
                    at = max(free[back], now) + (len(data) + 28) / rate
                    if at - now <= queue:
                        free[back], count = at, count + 1
                        heapq.heappush(due, (at, count, inner if back else outer[source], key.data, data))
        while due and due[0][0] <= time.monotonic():
            _, _, to, source, data = heapq.heappop(due)
            with contextlib.suppress(OSError):
                to.sendto(data, source) if source else to.send(data)


def router(config: dict[str, Any], side: int) -> tuple[zenoh.Session, Bearer | None]:
    """The router of a side, behind a bearer where there is a budget."""
    listen, connect, bearer = [f"tcp/127.0.0.1:{config['local'][side]}"], [], None
    form = "quic/127.0.0.1:{}?mixed_rel=1" if config["credentials"] else "udp/127.0.0.1:{}?rel=1;mixed_rel=1"
    if config["budget"]:
        names, ports = ("near", "far"), config["radios"]
        radio = Radio(address="127.0.0.1", budget=config["budget"])
        far = Far(names[1 - side], [(0, ("127.0.0.1", ports[1 - side]), 20)], opens=side == 0)
        bearer = Bearer(FLEET, names[side], [(radio, ports[side])], [far], ("127.0.0.1", config["router"]))
        bearer.__enter__()
        listen += [form.format(config["router"])] if side else []
        connect += [form.format(bearer.local["far"][1])] if not side else []
    else:
        listen += [form.format(config["router"])] if side else []
        connect += [form.format(config["air"])] if not side else []
    credentials = config["credentials"][side] if config["credentials"] else None
    how = SessionSettings(
        mode="router", listen=listen, connect=connect, credentials=credentials, cfg=["scouting/delay:0", *config["cfg"]]
    )
    return open_session(how), bearer


def client(config: dict[str, Any], side: int) -> zenoh.Session:
    return open_session(SessionSettings(connect=[f"tcp/127.0.0.1:{config['local'][side]}"]))


def far(config: dict[str, Any]) -> None:
    """Count and time what comes; on a line of input, print it."""
    session, bearer = router(config, 1)
    reader = client(config, 1)
    heard: dict[str, list[tuple[int, float]]] = collections.defaultdict(list)

    def note(kind: str, payload: zenoh.ZBytes) -> None:
        number, at = STAMP.unpack_from(payload.to_bytes())
        heard[kind].append((number, time.monotonic() - at))

    def on_sample(sample: zenoh.Sample) -> None:
        channel, key = str(sample.key_expr).split("/")[3], str(sample.key_expr)
        note(key.rpartition("/")[2] if channel == "mav" else channel, sample.payload)

    def on_query(query: zenoh.Query) -> None:
        assert query.payload is not None
        note("do", query.payload)
        query.reply(query.key_expr, b"done")

    for key in (
        keys.SETPOINT.key(FLEET, VEHICLE, agent="*"),
        keys.STATE.key(FLEET, VEHICLE),
        keys.RX.key(FLEET, VEHICLE, sys="*", comp="*", msg="*"),
        CAMERA,
    ):
        reader.declare_subscriber(key, on_sample)
    reader.declare_queryable(keys.DO.key(FLEET, VEHICLE, verb="*"), on_query)
    print("ready", flush=True)
    sys.stdin.readline()
    print(json.dumps(heard), flush=True)
    reader.close()
    session.close()
    if bearer:
        bearer.__exit__()


def video(config: dict[str, Any]) -> None:
    """Pictures at 30 Hz in chunks, as fast as the bit rate says."""
    session = client(config, 0)
    how = zenoh.Reliability.BEST_EFFORT if config["best_effort"] else zenoh.Reliability.RELIABLE
    publisher = session.declare_publisher(CAMERA, reliability=how, **keys.Qos.BULK.options())
    size, number, start = config["chunk"], 0, time.monotonic()
    while (span := time.monotonic() - start) < config["seconds"] + 1.0:
        while number * size < span * config["video"]:
            publisher.put(stamped(number, size))
            number += 1
        time.sleep(1 / 30)
    print(number, flush=True)
    session.close()


def ordered(config: dict[str, Any], session: zenoh.Session, stop: threading.Event) -> dict[str, Any]:
    """Ten orders a second, one after the other: round trips in s, and those without an answer."""
    times: list[float] = []
    given = missed = 0
    while not stop.wait(0.1):
        began = time.monotonic()
        replies = session.get(
            keys.DO.key(FLEET, VEHICLE, verb="arm"), payload=stamped(given, 200), timeout=2.0, **keys.DO.qos.options()
        )
        answered = any(reply.ok is not None for reply in replies)
        given += 1
        missed += not answered
        times += [time.monotonic() - began] if answered else []
    return {"given": given, "times": times, "missed": missed}


def near(config: dict[str, Any]) -> None:
    session, bearer = router(config, 0)
    local = client(config, 0)

    def declared(key: str, qos: keys.Qos) -> zenoh.Publisher:
        publisher = local.declare_publisher(key, **qos.options())
        while not (status := publisher.matching_status).matching:  # type: ignore[attr-defined]
            del status
            time.sleep(0.05)
        return publisher

    setpoint = declared(keys.SETPOINT.key(FLEET, VEHICLE, agent="a"), keys.SETPOINT.qos)
    state = declared(keys.STATE.key(FLEET, VEHICLE), keys.STATE.qos)
    raw = {f"M{n}": declared(keys.RX.key(FLEET, VEHICLE, msg=f"M{n}", **RX), keys.RX.qos) for n in range(RAW)}
    camera = None
    if config["video"]:
        command = [sys.executable, __file__, "video", json.dumps(config)]
        camera = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    time.sleep(1.0)
    stop, orders = threading.Event(), dict[str, Any]()
    commander = threading.Thread(target=lambda: orders.update(ordered(config, local, stop)))
    commander.start()
    sent: collections.Counter[str] = collections.Counter()
    wire: list[tuple[float, int]] = []
    start = time.monotonic()
    for step in range(int(config["seconds"] * SETPOINT_HZ)):
        setpoint.put(stamped(sent["setpoint"], 150))
        sent["setpoint"] += 1
        if step % 10 == 0:
            state.put(stamped(sent["state"], 900))
            sent["state"] += 1
        if step % 5 == 0:
            for name, publisher in raw.items():
                publisher.put(stamped(sent[name], 40))
                sent[name] += 1
        if bearer:
            wire.append((time.monotonic(), bearer.ports[0].counters.sent_bytes))
        time.sleep(max(start + (step + 1) / SETPOINT_HZ - time.monotonic(), 0.0))
    stop.set()
    commander.join()
    if camera:
        sent["camera"] = int(camera.communicate()[0])
    print(json.dumps({"sent": sent, "orders": orders, "wire": wire}), flush=True)
    local.close()
    session.close()
    if bearer:
        bearer.__exit__()


if __name__ == "__main__":
    role, *rest = sys.argv[1:]
    if role == "air":
        air(float(rest[0]), float(rest[1]), int(rest[2]), int(rest[3]))
    else:
        {"far": far, "near": near, "video": video}[role](json.loads(rest[0]))
