"""What is in the picture: grounds at every scale, sky, shadows, vehicles, roofs, and what lens and sensor do to it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import msgspec
import numpy as np
import pytest

from tests.sim.camera.conftest import PLAIN
from zmav.errors import BadConfig
from zmav.sim import VehicleSpec, World
from zmav.sim.arrays import Array
from zmav.sim.camera import Area, CameraSpec, Light, PadSpec, PlacedPad, Road, Roof, Scene
from zmav.sim.camera.ground import TILE, Ground
from zmav.sim.camera.materials import MATERIALS, mean_color

if TYPE_CHECKING:
    from tests.sim.camera.conftest import MakeStudio

SKY_BLUE = 195  # at least that of blue, in any part of the sky
DOWN = CameraSpec(offset_m=(0.0, 0.0, 0.0))


def mean(image: object) -> Array:
    color: Array = np.asarray(image, dtype=float).reshape(-1, 3).mean(0)
    return color


def correlation(one: object, other: object) -> float:
    return float(np.corrcoef(np.stack([np.asarray(each, dtype=float).ravel() for each in (one, other)]))[0, 1])


class TestGround:
    @pytest.mark.parametrize("kind", list(MATERIALS))
    def test_a_coarser_tile_is_the_finer_ones_from_afar(self, kind: str) -> None:
        ground = Ground(Scene(ground=kind), 1)  # type: ignore[arg-type]
        fine = ground.block(5, 2, -4, 2, 2)[..., :3]
        small = np.asarray(cv2.resize(fine, (TILE, TILE), interpolation=cv2.INTER_AREA), dtype=float)
        coarse = ground.tile(6, 1, -2)[..., :3].astype(float)
        assert mean(coarse) == pytest.approx(mean(small), abs=2.0)
        smooth = (cv2.GaussianBlur(each, (0, 0), 4.0)[20:-20, 20:-20, 1] for each in (small, coarse))
        assert correlation(*smooth) > 0.9

    @pytest.mark.parametrize("kind", list(MATERIALS))
    def test_from_afar_it_has_the_colour_of_the_horizon(self, kind: str) -> None:
        ground = Ground(Scene(ground=kind), 3)  # type: ignore[arg-type]
        tiles = [ground.tile(9, x, y)[..., :3] for x in (-5, 0, 7) for y in (-3, 2)]
        assert mean(np.array(tiles)) == pytest.approx(mean_color(kind), abs=8.0)

    def test_no_two_places_look_alike(self) -> None:
        ground = Ground(Scene(ground="asphalt"), 1)
        near, far = ground.tile(3, 0, 0)[..., 1], ground.tile(3, 40, -17)[..., 1]
        assert abs(correlation(near, far)) < 0.1
        other = Ground(Scene(ground="asphalt"), 2).tile(3, 0, 0)[..., 1]
        assert abs(correlation(near, other)) < 0.1

    def test_tiles_meet_without_a_seam(self) -> None:
        """The step from a tile to the next is as any within a tile."""
        block = Ground(Scene(ground="sand"), 1).block(4, -1, -1, 2, 2)[..., 1].astype(float)
        steps = np.abs(np.diff(block, axis=1)).mean(0)
        assert steps[TILE - 1] < np.quantile(steps, 0.99) * 1.2

    def test_only_so_many_tiles_are_kept(self) -> None:
        ground = Ground(Scene(ground="asphalt"), 1, most=8)
        first = ground.tile(3, 0, 0)
        ground.block(3, 1, 0, 4, 4)
        assert len(ground._tiles) == 8
        made = ground.made
        assert (ground.tile(3, 0, 0) == first).all()
        assert ground.made == made + 1

    @pytest.mark.parametrize("height", [1.0, 10.0, 100.0, 2000.0])
    def test_it_has_detail_at_every_height(self, make_studio: MakeStudio, height: float) -> None:
        image = make_studio(DOWN, scene=Scene(light=PLAIN.light)).take((3.0, 5.0, -height)).image
        assert mean(image) == pytest.approx(mean_color("grass"), abs=25.0)
        assert image[..., 1].std() > 3.0

    def test_a_road_an_area_and_lines_at_their_places(self, make_studio: MakeStudio) -> None:
        scene = Scene(
            light=PLAIN.light,
            roads=(Road(points=((-50.0, 4.0), (50.0, 4.0)), width_m=4.0, center_line="solid"),),
            areas=(Area(center=(0.0, -5.0), size=(4.0, 4.0), ground="sand"),),
        )
        image = make_studio(DOWN, scene=scene).take((0.0, 0.0, -10.4)).image  # 50 px a metre
        assert mean(image[200:280, 260:310]) == pytest.approx(mean_color("grass"), abs=15.0)
        assert mean(image[100:400, 320 + 115 : 320 + 185]) == pytest.approx(mean_color("asphalt"), abs=15.0)
        assert mean(image[160:320, 20:120]) == pytest.approx(mean_color("sand"), abs=15.0)
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
        assert image[0].mean(0)[0] - image[0].mean(0)[2] > 60.0  # blue overhead

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
        assert mean(frame.image) == pytest.approx(mean_color("asphalt"), abs=25.0)

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
        assert rows[0] == pytest.approx(40 + 15, abs=4)  # the rim is dark
        assert rows[-1] == pytest.approx(240 - 15, abs=4)
        assert columns[0] == pytest.approx(120 + 15, abs=4)
        assert columns[-1] == pytest.approx(520 - 15, abs=4)

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

    def test_the_own_vehicle_is_not_seen_but_its_shadow_is(self, make_studio: MakeStudio) -> None:
        sun = Light(sun_azimuth_deg=90.0, sun_elevation_deg=75.0)
        dark = Scene(ground="concrete", light=sun)
        lit, plain = (
            make_studio(DOWN, scene=scene).take((0.0, 0.0, -3.0)).image.astype(int)
            for scene in (dark, Scene(ground="concrete", light=PLAIN.light))
        )
        v, u = np.nonzero((plain - lit).max(2) > 20)
        # The sun is in the east, 75 degrees high: the shadow falls west by the height over the tangent of that.
        assert u.mean() == pytest.approx(319.5 - 520.0 * (3.15 / np.tan(np.radians(75.0))) / 3.0, abs=8.0)
        assert v.mean() == pytest.approx(239.5, abs=8.0)


class TestSensor:
    def test_pictures_are_the_same_in_two_worlds_and_other_by_their_number(self, make_studio: MakeStudio) -> None:
        spec = CameraSpec(noise=5.0, shot_noise=0.4)
        first, second = (make_studio(spec, seed=4) for _ in range(2))
        one, two = ([studio.take((0.0, 0.0, -4.0)) for _ in range(2)] for studio in (first, second))
        assert [frame.sequence for frame in one] == [0, 1]
        assert all((a.image == b.image).all() for a, b in zip(one, two, strict=True))
        assert (one[0].image != one[1].image).any()

    def test_noise_has_its_spread(self, make_studio: MakeStudio) -> None:
        clean = make_studio(CameraSpec()).take((0.0, 0.0, -4.0)).image.astype(int)
        noisy = make_studio(CameraSpec(noise=6.0)).take((0.0, 0.0, -4.0)).image - clean
        assert noisy.std() == pytest.approx(6.0, rel=0.03)
        assert noisy.mean() == pytest.approx(0.0, abs=0.05)
        shot = make_studio(CameraSpec(noise=2.0, shot_noise=0.5)).take((0.0, 0.0, -4.0)).image - clean
        assert shot.std() == pytest.approx(np.sqrt(4.0 + 0.25 * clean.mean()), rel=0.03)

    def test_gain_brightness_and_vignetting(self, make_studio: MakeStudio) -> None:
        clean = make_studio(CameraSpec()).take((0.0, 0.0, -4.0)).image
        night = msgspec.structs.replace(PLAIN, light=Light(shadows=0.0, brightness=0.1))
        dark = make_studio(CameraSpec(), scene=night).take((0.0, 0.0, -4.0)).image
        assert dark.mean() == pytest.approx(0.1 * clean.mean(), abs=0.5)
        again = make_studio(CameraSpec(gain=10.0), scene=night).take((0.0, 0.0, -4.0)).image
        assert again.mean() == pytest.approx(clean.mean(), rel=0.02)
        bright = make_studio(CameraSpec(gain=9.0)).take((0.0, 0.0, -4.0)).image
        assert np.median(bright) == 255
        ratio = make_studio(CameraSpec(vignetting=0.4)).take((0.0, 0.0, -4.0)).image / np.maximum(clean, 1.0)
        assert ratio[230:250, 310:330].mean() == pytest.approx(1.0, abs=0.02)
        assert ratio[:8, :8].mean() == pytest.approx(0.6, abs=0.02)

    def test_exposure_blurs_along_the_motion_only(self, make_studio: MakeStudio) -> None:
        def detail(spec: CameraSpec, vel: tuple[float, float, float]) -> tuple[float, float]:
            grey = make_studio(spec).take((0.0, 0.0, -4.0), vel=vel).image[..., 1].astype(float)
            return float(np.abs(np.diff(grey, axis=0)).mean()), float(np.abs(np.diff(grey, axis=1)).mean())

        still = detail(CameraSpec(exposure_s=0.01), (0.0, 0.0, 0.0))
        assert still == detail(CameraSpec(), (8.0, 0.0, 0.0))
        along, across = detail(CameraSpec(exposure_s=0.01), (8.0, 0.0, 0.0))  # 10 px toward the upper edge
        assert along < 0.35 * still[0]
        assert across > 0.35 * still[1]
        assert along < 0.6 * across

    def test_a_streak_is_as_long_as_the_way_in_the_exposure(self, make_studio: MakeStudio) -> None:
        dot = PadSpec(symbol="none", shape="disc", size_m=0.05, background="white")
        scene = Scene(ground="asphalt", light=PLAIN.light, pads=(PlacedPad(position=(0.0, 0.0), pad=dot),))
        studio = make_studio(CameraSpec(offset_m=(0, 0, 0), exposure_s=0.02), scene=scene)
        image = studio.take((0.0, 0.0, -5.2), vel=(0.0, 10.0, 0.0)).image[..., 1].astype(float)  # 100 px a metre: 20 px
        row = image[238:242].mean(0) - np.median(image)
        seen = np.flatnonzero(row > 0.3 * row.max())
        assert np.ptp(seen) == pytest.approx(20.0, abs=3.0)
        assert seen.mean() == pytest.approx(319.5, abs=0.5)

    def test_defocus_smooths(self, make_studio: MakeStudio) -> None:
        sharp = make_studio(CameraSpec()).take((0.0, 0.0, -4.0)).image
        soft = make_studio(CameraSpec(defocus_px=2.0)).take((0.0, 0.0, -4.0)).image
        assert (
            np.abs(np.diff(soft[..., 1].astype(int))).mean() < 0.3 * np.abs(np.diff(sharp[..., 1].astype(int))).mean()
        )
        assert soft.mean() == pytest.approx(sharp.mean(), abs=0.5)

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

    def test_jpeg(self, make_studio: MakeStudio) -> None:
        sizes = []
        for quality in (30, 95):
            studio = make_studio(CameraSpec(jpeg_quality=quality))
            frame = studio.take((0.0, 0.0, -4.0))
            data = studio.camera.encode(frame)
            back = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_COLOR)
            assert back is not None
            assert np.abs(back.astype(int) - frame.image).mean() < 12.0
            sizes.append(len(data))
        assert sizes[0] < 0.5 * sizes[1]


def test_a_frame_of_a_stepped_world_is_of_its_time_and_place() -> None:
    world = World([VehicleSpec(camera=CameraSpec(), start_ned_m=(3.0, 4.0, 0.0))], epoch_s=500.0, scene=PLAIN)
    camera = world.camera("copter1")
    world.step(0.5)
    first = camera.frame()
    assert (first.time_s, first.unix_s, first.sequence) == (0.5, 500.5, 0)
    assert first.position == pytest.approx((3.0, 4.0, -0.1))
    world.step(0.25)
    assert camera.frame().time_s == pytest.approx(0.75)
    world.close()


def test_without_opencv_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(BadConfig, match=r"zmav\[vision\]"):
        World([VehicleSpec(camera=CameraSpec())])
