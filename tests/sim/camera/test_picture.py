"""What is in the picture: grounds at every scale, sky, shadows, vehicles, roofs, and what lens and sensor do to it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
import numpy as np
import pytest

from tests.sim.camera.conftest import PLAIN
from zmav.errors import BadConfig
from zmav.sim import VehicleSpec, World
from zmav.sim.arrays import Array
from zmav.sim.camera import CameraSpec, PadSpec, PlacedPad, Road, Roof, Scene
from zmav.sim.camera.ground import COLOURS, PERIOD_M, SIDE, GroundTexture

if TYPE_CHECKING:
    from tests.sim.camera.conftest import MakeStudio

SKY_BLUE = 200  # at least that of blue, in any part of the sky
DOWN = CameraSpec(offset_m=(0.0, 0.0, 0.0))
GRASS, ASPHALT = COLOURS["grass"][0], COLOURS["asphalt"][0]


def mean(image: object) -> Array:
    color: Array = np.asarray(image, dtype=float).reshape(-1, 3).mean(0)
    return color


def correlation(one: object, other: object) -> float:
    return float(np.corrcoef(np.stack([np.asarray(each, dtype=float).ravel() for each in (one, other)]))[0, 1])


class TestGround:
    @pytest.mark.parametrize("kind", list(COLOURS))
    def test_a_coarser_texture_is_the_finer_one_from_afar(self, kind: str) -> None:
        levels = GroundTexture(Scene(ground=kind), 1).levels  # type: ignore[arg-type]
        assert [len(level) for level in levels] == [SIDE >> i for i in range(len(levels))]
        for level in levels:
            assert mean(level[..., :3]) == pytest.approx(COLOURS[kind][0], abs=6.0)

    def test_it_hangs_on_the_seed(self) -> None:
        one, same, other = (GroundTexture(Scene(), seed).levels[0][..., 1] for seed in (1, 1, 2))
        assert (one == same).all()
        assert abs(correlation(one, other)) < 0.1

    def test_it_repeats_without_a_seam(self) -> None:
        """The step from the last column to the first is as any within."""
        level = GroundTexture(Scene(), 1).levels[0][..., 1].astype(float)
        steps = np.abs(np.diff(level, axis=1, append=level[:, :1])).mean(0)
        assert steps[-1] < np.quantile(steps, 0.99) * 1.2

    def test_far_away_it_is_the_same(self, make_studio: MakeStudio) -> None:
        studio = make_studio(DOWN)
        near, far = (studio.take((0.3 + 500 * d, 0.2 - 700 * d, -5.0)).image for d in (0.0, PERIOD_M))
        assert np.abs(near.astype(int) - far).mean() < 1.0

    @pytest.mark.parametrize("height", [1.0, 10.0, 100.0])
    def test_it_has_detail_at_every_height(self, make_studio: MakeStudio, height: float) -> None:
        image = make_studio(DOWN, scene=Scene()).take((3.0, 5.0, -height)).image
        assert mean(image) == pytest.approx(GRASS, abs=25.0)
        assert image[..., 1].std() > 3.0

    def test_a_road_and_its_lines_at_their_places(self, make_studio: MakeStudio) -> None:
        scene = Scene(roads=(Road(points=((-50.0, 4.0), (49.0, 4.0)), width_m=4.0),))
        image = make_studio(DOWN, scene=scene).take((-4.0, 0.0, -10.4)).image  # 50 px a metre; a dash from -5 to -2
        assert mean(image[200:280, 260:310]) == pytest.approx(GRASS, abs=15.0)
        road = image[100:400, 320 + 115 : 320 + 185]
        assert mean(road) == pytest.approx(ASPHALT, abs=15.0)
        assert (np.ptp(road, axis=2) == 0).all()
        white = np.flatnonzero(image[240].min(1) > 200)
        lines = [part.mean() for part in np.split(white, np.flatnonzero(np.diff(white) > 1) + 1)]
        # 4 m to the east the middle one, those at the edges 1.85 m beside it.
        assert lines == pytest.approx([319.5 + 50 * 2.15, 319.5 + 50 * 4.0, 319.5 + 50 * 5.85], abs=0.6)


class TestSky:
    def test_the_horizon_is_where_it_must_be(self, make_studio: MakeStudio) -> None:
        """Level ahead: it lies in the middle of the picture, above it is sky."""
        image = make_studio(CameraSpec(mount_deg=(0.0, 90.0, 0.0))).take((0.0, 0.0, -30.0)).image
        assert image[:238, :, 0].min() > SKY_BLUE
        below = image[300:].astype(int)
        assert (below[..., 0] < 150).mean() > 0.95
        assert image[0].mean(0)[0] - image[0].mean(0)[2] > 30.0  # blue

    @pytest.mark.parametrize("roll", [-40.0, 40.0])
    def test_it_leans_with_the_vehicle(self, make_studio: MakeStudio, roll: float) -> None:
        image = make_studio(CameraSpec(mount_deg=(0.0, 80.0, 0.0))).take((0.0, 0.0, -30.0, roll, 0.0, 0.0)).image
        left, right = (float((image[:, part, 0] > SKY_BLUE).mean()) for part in (slice(0, 100), slice(540, 640)))
        assert (left > right + 0.3) if roll > 0 else (right > left + 0.3)

    def test_straight_up_there_is_only_sky(self, make_studio: MakeStudio) -> None:
        assert make_studio(DOWN).take((0.0, 0.0, -5.0, 180.0, 0.0, 0.0)).image[..., 0].min() > SKY_BLUE - 5

    @pytest.mark.parametrize("down", [0.0, 0.5, -0.001])
    def test_on_the_ground_and_below_it_sees_the_ground(self, make_studio: MakeStudio, down: float) -> None:
        frame = make_studio(DOWN).take((1.0, 2.0, down))
        assert frame.position[2] == pytest.approx(-0.02)
        assert mean(frame.image) == pytest.approx(ASPHALT, abs=25.0)

    def test_any_attitude_and_place_gives_a_picture(self, make_studio: MakeStudio) -> None:
        rng = np.random.default_rng(1)
        scene = Scene(
            roofs=(Roof(center=(0.0, 0.0), size=(5.0, 5.0), height_m=3.0),), pads=(PlacedPad(position=(0, 0)),)
        )
        others = [VehicleSpec(pad=PadSpec()), VehicleSpec()]
        studio = make_studio(CameraSpec(width=64, height=48, focal_px=52.0), *others, scene=scene)
        with np.errstate(invalid="raise", divide="raise", over="raise"):
            for _ in range(40):
                places = np.hstack([rng.normal(0.0, 3.0, (3, 3)), rng.uniform(-180.0, 180.0, (3, 3))])
                image = studio.take(*map(tuple, places)).image
                assert image.shape == (48, 64, 3)
                assert image.dtype == np.uint8


class TestThings:
    def test_a_roof_hides_a_rover_and_not_a_copter_above_it(self, make_studio: MakeStudio) -> None:
        roof = Roof(center=(0.0, 0.0), size=(6.0, 6.0), height_m=4.0)
        scene = msgspec.structs.replace(PLAIN, roofs=(roof,))
        studio = make_studio(DOWN, VehicleSpec(autopilot="ardurover", pad=PadSpec()), scene=scene)
        bare = studio.take((0.0, 0.0, -12.0)).image
        under = studio.take((0.0, 0.0, -12.0), (0.5, 0.5, 0.0)).image
        assert (bare == under).all()
        outside = studio.take((0.0, 0.0, -12.0), (4.3, 0.0, 0.0)).image
        assert (bare != outside).any()
        over = studio.take((0.0, 0.0, -12.0), (0.5, 0.5, -6.0)).image
        assert (bare != over).any()

    def test_a_roof_covers_its_rectangle_as_seen_from_above(self, make_studio: MakeStudio) -> None:
        roof = Roof(center=(1.0, 0.0), size=(2.0, 4.0), height_m=4.8)
        scene = msgspec.structs.replace(PLAIN, roofs=(roof,))
        image = make_studio(DOWN, scene=scene).take((0.0, 0.0, -10.0)).image.astype(int)  # 100 px a metre at the roof
        bright = image.min(2) > 115
        rows, columns = np.flatnonzero(bright.mean(1) > 0.2), np.flatnonzero(bright[60:200].mean(0) > 0.5)
        assert rows[0] == pytest.approx(40, abs=2)
        assert rows[-1] == pytest.approx(240, abs=2)
        assert columns[0] == pytest.approx(120, abs=2)
        assert columns[-1] == pytest.approx(520, abs=2)

    @pytest.mark.parametrize(
        ("spec", "reach"),
        [(VehicleSpec(), 0.6), (VehicleSpec(autopilot="ardurover"), 0.35), (VehicleSpec(autopilot="arduplane"), 1.1)],
    )
    def test_vehicles_are_where_they_are(self, make_studio: MakeStudio, spec: VehicleSpec, reach: float) -> None:
        studio = make_studio(DOWN, spec)
        place = (1.2, -0.8, -1.0 if spec.autopilot != "ardurover" else 0.0, 0.0, 0.0, 30.0)
        height = 8.0
        with_it = studio.take((0.0, 0.0, -height), place).image.astype(int)
        without = studio.take((0.0, 0.0, -height)).image.astype(int)
        v, u = np.nonzero(np.abs(with_it - without).max(2) > 8)
        scale = 520.0 / (height + place[2])
        expected = 319.5 + place[1] * scale, 239.5 - place[0] * scale
        assert ((u.min() + u.max()) / 2, (v.min() + v.max()) / 2) == pytest.approx(expected, abs=0.2 * scale)
        assert np.ptp(u) < 2.5 * reach * scale
        assert np.ptp(u) > 0.8 * reach * scale


class TestBlackout:
    def test_blackouts(self, make_studio: MakeStudio) -> None:
        studio = make_studio(CameraSpec())
        before = studio.take((0.0, 0.0, -4.0))
        studio.camera.blackout = "frozen"
        frozen = studio.take((3.0, 0.0, -8.0), time_s=1.0)
        assert (frozen.image == before.image).all()
        assert (frozen.sequence, frozen.time_s, frozen.unix_s) == (1, 1.0, 1001.0)
        studio.camera.blackout = "black"
        assert not studio.take((3.0, 0.0, -8.0)).image.any()
        studio.camera.blackout = None
        assert (studio.take((3.0, 0.0, -8.0)).image != before.image).any()

    def test_it_freezes_black_where_it_has_seen_nothing(self, make_studio: MakeStudio) -> None:
        studio = make_studio(CameraSpec())
        studio.camera.blackout = "frozen"
        assert not studio.take((0.0, 0.0, -4.0)).image.any()


def test_a_frame_of_a_stepped_world_is_of_its_time_and_place() -> None:
    world = World([VehicleSpec(camera=CameraSpec(), start_ned_m=(3.0, 4.0, 0.0))], epoch_s=500.0, scene=PLAIN)
    camera = world.camera("quad1")
    world.step(0.5)
    first = camera.frame()
    assert (first.time_s, first.unix_s, first.sequence) == (0.5, 500.5, 0)
    assert first.position == pytest.approx((3.0, 4.0, -0.1))
    world.step(0.25)
    assert camera.frame().time_s == pytest.approx(0.75)
    world.close()


def test_a_picture_of_a_world_that_fell_behind_has_the_vehicles_utc() -> None:
    world = World([VehicleSpec(camera=CameraSpec())], epoch_s=500.0, scene=PLAIN)
    world.step(1.0)
    world.pacer.on_given_up(2.5)  # the computer slept
    frame = world.camera("quad1").frame()
    assert frame.time_s == pytest.approx(1.0)
    assert frame.unix_s == pytest.approx(world.vehicles[0].node.unix_us / 1e6) == pytest.approx(503.5)
    world.close()


def test_without_opencv_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(BadConfig, match=r"zmav\[vision\]"):
        World([VehicleSpec(camera=CameraSpec())])
