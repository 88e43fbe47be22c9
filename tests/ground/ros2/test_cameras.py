"""A vehicle's cameras in ROS: pictures by demand, each with what its lens is."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator
from typing import Any

import msgspec
import numpy as np
import pytest
import zenoh

from ground.ros2 import cameras, convert, graph
from ground.ros2.types import known
from tests.ground.ros2.conftest import Fleet, Peer, first
from tests.waiting import wait_until
from zmav import keys, wire
from zmav.session import SessionSettings, open_session
from zmav.sim import VehicleSpec
from zmav.vision.chunks import split

JPEG = b"\xff\xd8" + bytes(range(200)) * 20 + b"\xff\xd9"
INFO = wire.CameraInfo(
    t=1000.5,
    camera="down-1",
    width=640,
    height=480,
    focal=(500.0, 510.0),
    center=(320.0, 240.0),
    distortion=(0.1, 0.2, 0.3, 0.4, 0.5),
    mount=(0.0, math.pi / 2, 0.0),
    offset=(0.1, 0.2, 0.3),
    rate_hz=10.0,
)
TOPIC = "/quad1/camera/down_1"


class FakeCamera:
    """Says what it is, and sends pictures half its size while anybody reads them."""

    def __init__(self, session: zenoh.Session) -> None:
        key = {"fleet": "demo", "vehicle": "quad1", "camera": "down-1"}
        self.publisher = session.declare_publisher(keys.FRAME.key(**key), **keys.FRAME.publishing())
        info = keys.CAMERA.key(**key)
        self.answers = True

        def answer(query: zenoh.Query) -> None:
            if self.answers:
                query.reply(info, wire.encode(INFO))

        self.queryable = session.declare_queryable(info, answer)
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    @property
    def watched(self) -> bool:
        status: Any = self.publisher.matching_status
        return bool(status.matching)

    def _run(self) -> None:
        number = 0
        while not self._closed.wait(0.1):
            if self.watched:
                for chunk in split(JPEG, sender=7, seq=number, t=time.time(), size=(320, 240)):
                    self.publisher.put(chunk)
                number += 1

    def close(self) -> None:
        self._closed.set()
        self._thread.join(5.0)
        self.queryable.undeclare()
        self.publisher.undeclare()


@pytest.fixture(scope="module")
def fleet() -> Iterator[Fleet]:
    before, cameras.LOOK = cameras.LOOK, 0.3
    with Fleet(["quad1"], [VehicleSpec()], speed=1.0, may_order=False) as fleet:
        yield fleet
    cameras.LOOK = before


@pytest.fixture
def camera(fleet: Fleet) -> Iterator[FakeCamera]:
    with open_session(SessionSettings(connect=[f"tcp/127.0.0.1:{fleet.port}"])) as session:
        camera = FakeCamera(session)
        yield camera
        camera.close()


def stamp_of(message: Any) -> tuple[int, int]:
    return message.header.stamp.sec, message.header.stamp.nanosec


def read(fleet: Fleet) -> dict[str, Any]:
    return {name: camera.read for name, camera in fleet.face.vehicles["quad1"].cameras.cameras.items()}


def test_pictures_come_while_somebody_subscribes(fleet: Fleet, peer: Peer, camera: FakeCamera) -> None:
    wait_until(lambda: f"{TOPIC}/camera_info" in peer.topics())
    assert peer.topics()[f"{TOPIC}/image_raw/compressed"] == ["sensor_msgs/msg/CompressedImage"]
    infos, _ = peer.subscribe(f"{TOPIC}/camera_info", "sensor_msgs/msg/CameraInfo")
    alone = first(infos)
    assert (alone.width, alone.height, alone.header.stamp.sec) == (640, 480, 1000)
    assert not camera.watched, "its lens needs no pictures"

    pictures, close = peer.subscribe(f"{TOPIC}/image_raw/compressed", "sensor_msgs/msg/CompressedImage")
    picture = first(pictures)
    assert bytes(picture.data) == JPEG
    assert (picture.format, picture.header.frame_id) == ("jpeg", "quad1/down_1")
    assert abs(picture.header.stamp.sec - time.time()) < 10.0
    wait_until(lambda: infos[-1].width == 320, "each picture comes with its lens")
    info = infos[-1]
    assert list(info.k) == [250.0, 0.0, 159.75, 0.0, 255.0, 119.75, 0.0, 0.0, 1.0], "half of the edges"
    assert list(info.d) == [0.1, 0.2, 0.3, 0.4, 0.5]
    wait_until(lambda: {stamp_of(each) for each in infos} & {stamp_of(each) for each in pictures}, "of one time")

    close()
    wait_until(lambda: not camera.watched, "nobody subscribes, and pictures are still sent")
    assert read(fleet) == {"down_1": False}


def placed(fleet: Fleet) -> Any:
    """Where the camera is, as tf2 has it that begins to listen now."""
    kind = "tf2_msgs/msg/TFMessage"
    key = f"0/tf_static/{graph.dds_of(kind)}/{known().hash(kind)}"
    with open_session(SessionSettings(connect=[f"tcp/127.0.0.1:{fleet.port}"])) as late:
        came: list[zenoh.Sample] = []
        history = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1)
        zenoh.ext.declare_advanced_subscriber(late, key, came.append, history=history)
        wait_until(lambda: came)
        (one,) = known().decode(came[-1].payload.to_bytes(), kind).transforms
    return one


def test_where_a_camera_is_on_the_vehicle_waits_for_who_comes_late(fleet: Fleet, camera: FakeCamera) -> None:
    """This one looks ahead: its picture's right is the vehicle's right, its depth is forward."""
    wait_until(lambda: "down_1" in read(fleet))
    one = placed(fleet)
    assert (one.header.frame_id, one.child_frame_id) == ("quad1/base_link", "quad1/down_1")
    at, q = one.transform.translation, one.transform.rotation
    assert (at.x, at.y, at.z) == pytest.approx((0.1, -0.2, -0.3))
    sign = math.copysign(1.0, q.w)
    assert (q.x * sign, q.y * sign, q.z * sign, q.w * sign) == pytest.approx((-0.5, 0.5, -0.5, 0.5))


def test_a_camera_that_is_gone_has_no_topics(fleet: Fleet, peer: Peer, camera: FakeCamera) -> None:
    wait_until(lambda: "down_1" in read(fleet))
    camera.answers = False
    wait_until(lambda: not read(fleet))
    wait_until(lambda: f"{TOPIC}/camera_info" not in peer.topics())


def test_what_is_no_camera_is_left_out(fleet: Fleet) -> None:
    """Anybody may answer, and anything."""
    said = [b"{", wire.encode(INFO).replace(b"down-1", b"../up"), b"null"]
    with open_session(SessionSettings(connect=[f"tcp/127.0.0.1:{fleet.port}"])) as session:
        asked = threading.Event()
        for number, payload in enumerate(said):
            key = keys.CAMERA.key("demo", "quad1", camera=f"fake{number}")

            def answer(query: zenoh.Query, key: str = key, payload: bytes = payload) -> None:
                query.reply(key, payload)
                asked.set()

            session.declare_queryable(key, answer)
        assert asked.wait(30.0)
        time.sleep(1.0)
        wait_until(lambda: not read(fleet))


def test_a_place_that_is_none_is_not_told(fleet: Fleet, camera: FakeCamera) -> None:
    wait_until(lambda: "down_1" in read(fleet))
    one = fleet.face.vehicles["quad1"].cameras.cameras["down_1"]
    for wrong in ({"offset": (math.inf, 0.0, 0.0)}, {"mount": (0.0, math.nan, 0.0)}):
        one.take(msgspec.structs.replace(INFO, **wrong))
    assert placed(fleet).transform.translation.x == pytest.approx(0.1)
    one.take(msgspec.structs.replace(INFO, offset=(0.4, 0.0, 0.0), gimbal=True))
    assert placed(fleet).transform.translation.x == pytest.approx(0.1), "a gimbal's is not told"


def test_the_lens_of_a_picture_in_its_own_pixels() -> None:
    header = convert.header(known(), "f", 1.25)
    info = cameras.camera_info(known(), header, INFO, (640, 480))
    assert known().encode(info, "sensor_msgs/msg/CameraInfo")
    assert list(info.p)[:7] == [500.0, 0.0, 320.0, 0.0, 0.0, 510.0, 240.0]
    assert np.array_equal(np.asarray(info.r).reshape(3, 3), np.eye(3))
