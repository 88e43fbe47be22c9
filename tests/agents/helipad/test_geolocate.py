"""From a pixel to the ground and back: by the simulator's own projection, by hand, and with what is not exact."""

from __future__ import annotations

import math

import cv2
import msgspec
import numpy as np
import pytest

from agents.helipad import Detection
from agents.helipad.geolocate import AGREE, bearing, camera_height, fix, locate, pixel, sized_plane
from tests.agents.helipad.generator import INFO
from zmav.sim.arrays import quat_from_euler
from zmav.sim.camera import CameraSpec
from zmav.sim.camera.projection import camera_matrix, camera_rotation, quat_matrix
from zmav.vision.optics import Optics
from zmav.vision.poses import Pose

BENT = (-0.12, 0.03, 0.001, -0.0005, 0.0)


def pose(
    *,
    pos: tuple[float, float, float] = (10.0, -4.0, -6.0),
    roll: float = 0.0,
    pitch: float = 0.0,
    yaw: float = 0.0,
    rate: float = 0.0,
) -> Pose:
    return Pose(0.0, pos, roll, pitch, yaw, rate)


def seen(u: float, v: float, scale_px: float = 10.0, heading: float = 0.0) -> Detection:
    return Detection(u=u, v=v, scale_px=scale_px, heading=heading, score=0.9)


def test_straight_down_by_hand() -> None:
    optics = Optics.of(INFO)
    assert locate(optics, pose(), (319.5, 239.5), 0.0) == pytest.approx((10.0, -4.0))
    # The upper edge is to the nose: 52 px up are a tenth of the height ahead.
    assert locate(optics, pose(), (319.5, 239.5 - 52.0), 0.0) == pytest.approx((10.6, -4.0))
    assert locate(optics, pose(yaw=math.pi / 2.0), (319.5, 239.5 - 52.0), 0.0) == pytest.approx((10.0, -3.4))
    assert locate(optics, pose(), (319.5 + 52.0, 239.5), 0.0) == pytest.approx((10.0, -3.4))
    # Rolled to the right the camera looks to the left; pitched up, ahead.
    assert locate(optics, pose(roll=0.1), (319.5, 239.5), 0.0) == pytest.approx((10.0, -4.0 - 6.0 * math.tan(0.1)))
    assert locate(optics, pose(pitch=0.1), (319.5, 239.5), 0.0) == pytest.approx((10.0 + 6.0 * math.tan(0.1), -4.0))
    level = Optics.of(msgspec.structs.replace(INFO, gimbal=True))
    assert locate(level, pose(roll=0.3, pitch=0.2), (319.5, 239.5), 0.0) == pytest.approx((10.0, -4.0))
    assert camera_height(optics, pose(), -0.3) == pytest.approx(5.7)


@pytest.mark.parametrize("seed", range(8))
def test_it_undoes_the_simulators_camera(seed: int) -> None:
    """A point of the ground is projected by the simulator, with lens, mount and offset, and found where it was."""
    rng = np.random.default_rng(seed)
    mount = rng.uniform(-0.2, 0.2, 3)
    offset = rng.uniform(-0.3, 0.3, 3)
    spec = CameraSpec(mount_deg=tuple(np.degrees(mount)), offset_m=tuple(offset))
    info = msgspec.structs.replace(
        INFO, distortion=BENT, mount=tuple(map(float, mount)), offset=tuple(map(float, offset))
    )
    optics = Optics.of(info)
    assert optics.matrix == pytest.approx(camera_matrix(spec))
    angles = rng.uniform(-0.26, 0.26, 2)
    yaw = float(rng.uniform(-3.0, 3.0))
    where = pose(pos=(float(rng.uniform(-9, 9)), 3.0, -7.0), roll=float(angles[0]), pitch=float(angles[1]), yaw=yaw)
    point = np.array([where.pos[0] + rng.uniform(-1, 1), 3.0 + rng.uniform(-1, 1), -0.4])
    turned = quat_from_euler(*(np.array([angle]) for angle in (where.roll, where.pitch, where.yaw)))
    centre = np.array(where.pos) + quat_matrix(turned[:, 0]) @ offset
    seen = camera_rotation(spec, turned[:, 0]).T @ (point - centre)
    projected, _ = cv2.projectPoints(seen[None], np.zeros(3), np.zeros(3), camera_matrix(spec), np.array(BENT))
    u, v = projected.ravel().tolist()
    assert locate(optics, where, (u, v), -0.4) == pytest.approx(tuple(point[:2]), abs=1e-4)
    assert pixel(optics, where, float(point[0]), float(point[1]), -0.4) == pytest.approx((u, v), abs=1e-6)


def test_how_sure_it_is_grows_with_height_and_turning() -> None:
    optics = Optics.of(INFO)

    def sigma(height: float, rate: float = 0.0, u: float = 400.0) -> float:
        found = fix(optics, pose(pos=(0.0, 0.0, -height), rate=rate), seen(u, 200.0, 520 * 0.25 / height), 0.25, 0.0)
        assert found is not None
        assert not found.by_size
        nn, ne, ee = found.covariance
        assert nn * ee > ne * ne
        return math.sqrt(nn + ee)

    assert sigma(2.0) < sigma(5.0) < sigma(10.0)
    assert sigma(5.0, rate=1.0) > 2.0 * sigma(5.0)
    assert 0.04 < sigma(5.0) < 0.12
    # A hundred pictures with such errors lie about as wide as it says.
    rng, found = np.random.default_rng(3), []
    for _ in range(400):
        d = rng.normal(0.0, math.radians(0.5), 2)
        where = pose(pos=(0.0, 0.0, -5.0 + rng.normal(0.0, 0.03 * 5.0 + 0.05)), roll=d[0], pitch=d[1])
        found.append(locate(optics, where, (400.0 + rng.normal(0, 0.5), 200.0 + rng.normal(0, 0.5)), 0.0))
    assert float(np.sqrt(np.var(np.array(found), axis=0).sum())) == pytest.approx(sigma(5.0), rel=0.25)


def test_a_wrong_height_is_seen_by_the_symbols_size() -> None:
    optics = Optics.of(INFO)
    where = pose(pos=(0.0, 0.0, -5.0))
    size = 520.0 * 0.25 / 5.0
    told_wrong = fix(optics, where, seen(400.0, 239.5, size), 0.25, 5.0)  # "ten metres up"
    right = fix(optics, where, seen(400.0, 239.5, size), 0.25, 0.0)
    assert told_wrong is not None
    assert right is not None
    assert (told_wrong.by_size, right.by_size) == (True, False)
    assert told_wrong.pos == pytest.approx(right.pos, abs=0.05)
    slightly = fix(optics, where, seen(400.0, 239.5, size), 0.25, 5.0 * (AGREE - 1.0) - 0.1)
    assert slightly is not None
    assert not slightly.by_size


@pytest.mark.parametrize("turned", [0.0, 0.8, math.pi / 2.0])
@pytest.mark.parametrize("pitch", [-0.4, 0.0, 0.4])
def test_a_leaning_camera_tells_the_height_from_the_size_too(pitch: float, turned: float) -> None:
    """A symbol 2 m ahead and 1 m to the right of a vehicle that brakes, its upright turned on the ground."""
    optics, where = Optics.of(INFO), pose(pos=(0.0, 0.0, -4.5), roll=0.1, pitch=pitch)
    ends = []
    for side in (0.125, -0.125):
        end = pixel(optics, where, 2.0 + side * math.cos(turned), 1.0 + side * math.sin(turned), -0.3)
        assert end is not None
        ends.append(np.array(end))
    (u, v), (right, down) = 0.5 * (ends[0] + ends[1]), ends[0] - ends[1]
    sized = sized_plane(optics, where, seen(u, v, math.hypot(right, down), math.atan2(right, -down)), 0.25)
    assert sized == pytest.approx(-0.3, abs=0.01)


def test_nothing_is_said_above_the_horizon() -> None:
    optics = Optics.of(msgspec.structs.replace(INFO, mount=(0.0, math.pi / 2.0, 0.0)))
    assert locate(optics, pose(), (319.5, 100.0), 0.0) is None
    assert fix(optics, pose(), seen(319.5, 100.0), 0.25, 0.0) is None
    assert locate(optics, pose(), (319.5, 470.0), 0.0) is not None
    assert pixel(optics, pose(), 0.0, -4.0, 0.0) is None, "behind"
    assert locate(Optics.of(INFO), pose(pos=(0.0, 0.0, 1.0)), (319.5, 239.5), 0.0) is None, "below the plane"


@pytest.mark.parametrize(("yaw", "heading", "expected"), [(0.0, 0.5, 0.5), (1.0, 0.5, 1.5), (-1.0, 0.5, math.pi - 0.5)])
def test_a_heading_in_the_picture_is_one_over_the_ground(yaw: float, heading: float, expected: float) -> None:
    found = bearing(Optics.of(INFO), pose(yaw=yaw), seen(350.0, 250.0, heading=heading), 0.0)
    assert found == pytest.approx(expected, abs=1e-6)
