"""Pictures through the gateway: who may look, what comes, and what a slow reader gets."""

from __future__ import annotations

import contextlib
import http.client
import socket
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

from agents.camera.mjpeg import part
from ground.http.cameras import MOST_EACH
from ground.http.guard import Rules
from ground.http.server import SEND_BUFFER
from tests.ground.http.camera import FakeCamera

if TYPE_CHECKING:
    from tests.ground.http.conftest import Serve, Served

PATH = "/camera/quad1/down"
PATIENCE_S = 30.0


@pytest.fixture
def camera(served: Served) -> Iterator[FakeCamera]:
    camera = FakeCamera(served.session)
    yield camera
    camera.close()


@contextlib.contextmanager
def looking(served: Served, path: str = PATH, **headers: str) -> Iterator[http.client.HTTPResponse]:
    connection = http.client.HTTPConnection("127.0.0.1", served.port, timeout=PATIENCE_S)
    try:
        connection.request("GET", path, headers=headers)
        with connection.getresponse() as answer:
            yield answer
    finally:
        connection.close()


def until(true: object, what: str) -> None:
    assert callable(true)
    end = time.monotonic() + PATIENCE_S
    while not true():
        assert time.monotonic() < end, what
        time.sleep(0.02)


def test_pictures_come_while_somebody_looks_and_are_sent_no_longer(served: Served, camera: FakeCamera) -> None:
    time.sleep(0.3)
    assert not camera.watched
    assert camera.sent == 0, "nobody looks"
    with looking(served) as first, looking(served) as second:
        assert first.status == 200
        assert first.headers.get_content_type() == "multipart/x-mixed-replace"
        assert first.headers["cache-control"] == "no-store"
        last = -1
        for _ in range(3):  # as our own cameras' agent reads other people's
            headers, jpeg = part(first)
            assert headers["content-type"] == "image/jpeg"
            assert jpeg.startswith(b"\xff\xd8")
            assert abs(time.time() - float(headers["x-timestamp"])) < 5.0
            assert int(headers["x-sequence"]) > last
            last = int(headers["x-sequence"])
        part(second)
        until(lambda: camera.reports, "the camera is told how its pictures come")
        assert len(camera.reports) == 1, "it is read once for all who look here"
    until(lambda: not camera.watched, "the last one went, and it is still read")


def test_a_picture_from_before_is_none(served: Served, camera: FakeCamera) -> None:
    with looking(served) as first:
        part(first)
        camera.sends = False
        time.sleep(0.3)
        with looking(served) as second:
            sent = camera.sent
            camera.sends = True
            assert int(part(second)[0]["x-sequence"]) >= sent, "what it saw before somebody looked is not now"


def test_a_slow_reader_gets_fewer_and_none_late(served: Served) -> None:
    large = FakeCamera(served.session, camera="front", hz=20.0, size=(400, 300), noise=True)
    face = served.face("/camera/{vehicle}/{camera}")
    with contextlib.closing(large), socket.socket() as sock:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 16_384)
        sock.settimeout(PATIENCE_S)
        sock.connect(("127.0.0.1", served.port))
        sock.sendall(b"GET /camera/quad1/front HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        before = face.left_out
        until(lambda: ("quad1", "front") in face.being_read, "the camera is read")
        here = face.being_read["quad1", "front"]  # a busy machine loses some on the way here
        until(lambda: here.count * large.length > 4 * SEND_BUFFER, "more than the kernel would take")
        answer = http.client.HTTPResponse(sock)
        answer.begin()
        stood = large.sent
        waited = 0
        while int(part(answer)[0]["x-sequence"]) < stood - 1:
            waited += 1
        assert waited * large.length < 200_000, "pictures waited for a reader that did not take them"
        assert face.left_out - before > 10


def test_who_takes_nothing_keeps_no_place_and_no_camera(serve: Serve) -> None:
    short = serve(stalled=1.0)
    face = short.face("/camera/{vehicle}/{camera}")
    with contextlib.closing(FakeCamera(short.session, hz=20.0, size=(400, 300), noise=True)) as camera:
        with socket.socket() as sock:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 16_384)
            sock.connect(("127.0.0.1", short.port))
            sock.sendall(f"GET {PATH} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode())
            short.until(lambda: face.readers == 1, "reader")
            short.until(lambda: face.readers == 0, "end of a reader that takes nothing")
        until(lambda: not camera.watched, "it is still read")


def test_a_reading_that_breaks_off_is_told_to_who_looks(served: Served, camera: FakeCamera) -> None:
    face = served.face("/camera/{vehicle}/{camera}")
    with looking(served) as first, looking(served) as second:
        mark = [answer.headers.get_boundary() for answer in (first, second)]
        assert mark[0] != mark[1], "a picture that holds it would pass for parts of ours"
        part(first)
        served.loop.call_soon_threadsafe(face.being_read["quad1", "down"].close)
        first.read()
        second.read()  # both end
    until(lambda: not camera.watched, "it is still read")
    with looking(served) as again:
        part(again)


def test_a_gateway_ends_while_somebody_looks(serve: Serve) -> None:
    own = serve()
    with contextlib.closing(FakeCamera(own.session)) as camera, looking(own) as answer:
        part(answer)
        own.close()
        with contextlib.suppress(http.client.IncompleteRead):
            answer.read()
        until(lambda: not camera.watched, "it is still read")


def test_no_more_than_a_browser_can_spare(served: Served, camera: FakeCamera) -> None:
    face = served.face("/camera/{vehicle}/{camera}")
    served.until(lambda: face.readers == 0, "end of the readers before")
    with contextlib.ExitStack() as stack:
        for _ in range(MOST_EACH):
            part(stack.enter_context(looking(served)))
        with looking(served) as one_more:
            assert one_more.status == 429
            assert f"no more than {MOST_EACH}" in one_more.read().decode()
        assert served.get("/metrics").text.count(f"zmav_http_camera_readers {MOST_EACH}\n") == 1
    served.until(lambda: face.readers == 0, "end of the readers")
    with looking(served) as again:
        part(again)


def test_what_is_no_camera_is_said(served: Served, camera: FakeCamera) -> None:
    reply = served.get("/camera/quad1/front")
    assert (reply.status, reply.json["error"]["kind"]) == (404, "not_found")
    assert "quad1 has no camera 'front'" in reply.json["error"]["text"]
    for path in ("/camera/*/down", "/camera/quad1/*", "/camera/Quad%201/down"):
        assert served.get(path).status == 400, path
    assert served.request("POST", PATH).status == 405
    head = served.request("HEAD", PATH)
    assert (head.status, head.body) == (200, b"")
    assert not camera.watched
    with looking(served, f"{PATH}?envelope=1") as answer:
        part(answer)  # what has no end goes into no envelope


def test_a_viewer_may_look_and_a_stranger_may_not(serve: Serve) -> None:
    locked = serve(Rules(token="s3cret", read_only=True))
    own = FakeCamera(locked.session)
    with contextlib.closing(own):
        assert locked.get(PATH).status == 401
        with looking(locked, f"{PATH}?token=s3cret") as answer:
            part(answer)
        open_one = serve(endpoint=locked.endpoint)
        assert open_one.request("GET", PATH, Host="evil.example").status == 421
        site = {"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": "no-cors"}
        assert open_one.request("GET", PATH, **site).status == 403, "an image in another site's page"
