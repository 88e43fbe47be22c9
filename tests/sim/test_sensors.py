"""What the sensors measure, how good they are, and that nothing but the seed decides it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from zmav.errors import BadConfig
from zmav.sim.arrays import Array, quat_from_euler
from zmav.sim.dynamics.airframe import GRAVITY, airframe
from zmav.sim.dynamics.copter import CopterDynamics
from zmav.sim.geo import Position
from zmav.sim.sensors import atmosphere
from zmav.sim.sensors.estimate import Estimator
from zmav.sim.sensors.magnetic import earth_field
from zmav.sim.sensors.noise import NONE, TYPICAL, Noise, NoiseRows, Wander, noise_profile
from zmav.sim.sensors.suite import RANGE_MAX_M, RANGE_MOUNT_M, SensorSuite
from zmav.sim.sensors.troubles import FINE, Trouble

PLACE = Position(-35.363261, 149.165230, 584.09)
TICK_S = 0.01


def bodies(count: int = 1, down: float = -20.0) -> CopterDynamics:
    start = np.zeros((3, count))
    start[2] = down
    return CopterDynamics(airframe("quad"), start, np.zeros(count), 1 / 200)


def suite(body: CopterDynamics, noise: Noise = NONE, seed: int = 1) -> SensorSuite:
    return SensorSuite(body, PLACE, (seed,), noise)


class TestTruth:
    """Without noise a sensor measures what is there."""

    def test_at_rest(self) -> None:
        seen = suite(bodies()).readings(0)
        assert seen.gyro == (0.0, 0.0, 0.0)
        assert seen.accel == pytest.approx((0.0, 0.0, -GRAVITY))
        assert seen.mag == pytest.approx(earth_field(PLACE.lat_deg, PLACE.lon_deg))
        assert seen.pressure_alt_m == pytest.approx(PLACE.alt_amsl_m + 20.0, abs=0.01)
        assert seen.range_m != seen.range_m  # 20 m is beyond its reach
        assert seen.gps is not None
        assert (seen.gps.fix_type, seen.gps.down) == (3, -20.0)

    def test_axes_are_the_bodys(self) -> None:
        body = bodies()
        body.q[:] = quat_from_euler(np.array([0.0]), np.array([0.0]), np.array([math.pi / 2]))
        body.accel[:] = [[1.0], [2.0], [0.5]]  # north is to the left now, east ahead
        body.vel[:] = [[0.0], [30.0], [0.0]]
        sensors = suite(body)
        seen = sensors.readings(0)
        assert seen.accel == pytest.approx((2.0, -1.0, 0.5 - GRAVITY))
        north, east, down = earth_field(PLACE.lat_deg, PLACE.lon_deg)
        assert seen.mag == pytest.approx((east, -north, down))
        pressure = 0.5 * atmosphere.density(PLACE.alt_amsl_m + 20.0) * 30.0**2 / 100.0
        assert seen.diff_pressure_hpa == pytest.approx(pressure)
        assert seen.airspeed_mps == pytest.approx(30.0 * math.sqrt(atmosphere.density(604.09) / 1.225), rel=1e-4)

    def test_the_pitot_tube_feels_the_wind_ahead_only(self) -> None:
        body = bodies()
        body.wind[:] = [[-12.0], [5.0], [0.0]]
        assert suite(body).readings(0).airspeed_mps == pytest.approx(
            12.0 * math.sqrt(atmosphere.density(604.09) / 1.225), rel=1e-4
        )
        body.wind[:] = [[12.0], [0.0], [0.0]]
        assert suite(body).readings(0).airspeed_mps == 0.0

    @pytest.mark.parametrize(("height", "lean", "expected"), [(3.0, 0.0, 3.0), (3.0, 0.6, 3.0 / math.cos(0.6))])
    def test_the_rangefinder_looks_along_the_body(self, height: float, lean: float, expected: float) -> None:
        body = bodies(down=-height)
        body.q[:] = quat_from_euler(np.array([lean]), np.array([0.0]), np.array([1.0]))
        assert suite(body).readings(0).range_m == pytest.approx(expected + RANGE_MOUNT_M, rel=1e-6)

    def test_and_sees_no_sky_and_nothing_far(self) -> None:
        body = bodies(down=-3.0)
        body.q[:] = quat_from_euler(np.array([2.0]), np.array([0.0]), np.array([0.0]))
        assert math.isnan(suite(body).readings(0).range_m)
        assert math.isnan(suite(bodies(down=-RANGE_MAX_M)).readings(0).range_m)
        assert suite(bodies(down=0.0)).readings(0).range_m == pytest.approx(RANGE_MOUNT_M)

    @pytest.mark.parametrize(
        ("lat", "lon", "north", "east", "down"),
        [
            # nT at sea level at 2025.0, worked out by pygeomag 1.1 from the same coefficients.
            (47.4, 8.55, 21522.8, 1287.8, 43254.4),
            (51.5, -0.1, 19542.1, 312.4, 45005.1),
            (-35.36, 149.17, 23028.1, 5167.6, -53110.4),
            (37.77, -122.4, 22384.5, 5162.6, 41593.4),
            (80.0, 0.0, 6521.6, 145.9, 54791.5),
        ],
    )
    def test_the_magnetic_field_is_the_world_magnetic_models(
        self, lat: float, lon: float, north: float, east: float, down: float
    ) -> None:
        assert [1e5 * part for part in earth_field(lat, lon)] == pytest.approx([north, east, down], abs=0.1)

    @pytest.mark.parametrize("lat", [90.0, -90.0, 0.0])
    def test_the_poles_have_one_too(self, lat: float) -> None:
        assert 0.25 < math.hypot(*earth_field(lat, 180.0)) < 0.7

    @pytest.mark.parametrize("height", [-300.0, 0.0, 584.0, 4000.0, 10_000.0])
    def test_the_atmosphere_reads_back(self, height: float) -> None:
        assert atmosphere.altitude_m(atmosphere.pressure_hpa(height)) == pytest.approx(height, abs=0.05)

    def test_the_atmosphere_is_the_standard_one(self) -> None:
        assert atmosphere.pressure_hpa(0.0) == pytest.approx(1013.25)
        assert atmosphere.pressure_hpa(5000.0) == pytest.approx(540.2, abs=0.3)
        assert atmosphere.density(0.0) == pytest.approx(1.225, abs=0.001)
        assert atmosphere.temperature_c(2000.0) == pytest.approx(2.0)


class TestNoise:
    """Standard deviations, over many vehicles, are what the profile says."""

    @pytest.fixture
    def many(self) -> tuple[CopterDynamics, SensorSuite]:
        body = bodies(400, down=-3.0)
        sensors = suite(body, TYPICAL)
        for _ in range(60):
            sensors.tick(TICK_S)
        return body, sensors

    def test_imu(self, many: tuple[CopterDynamics, SensorSuite]) -> None:
        seen = [many[1].readings(i) for i in range(400)]
        gyro = np.array([s.gyro for s in seen])
        wanted = math.hypot(TYPICAL.gyro_white, math.hypot(TYPICAL.gyro_turn_on, TYPICAL.gyro_drift))
        assert gyro.std() == pytest.approx(wanted, rel=0.08)
        accel = np.array([s.accel for s in seen]) - (0.0, 0.0, -GRAVITY)
        wanted = math.hypot(TYPICAL.accel_white, math.hypot(TYPICAL.accel_turn_on, TYPICAL.accel_drift))
        assert accel.std() == pytest.approx(wanted, rel=0.08)

    def test_motors_shake_the_accelerometers(self, many: tuple[CopterDynamics, SensorSuite]) -> None:
        many[1].throttle = np.full(400, 0.5)
        accel = np.array([many[1].readings(i).accel for i in range(400)])
        many[1].throttle = np.zeros(400)
        assert accel[:, 2].std() == pytest.approx(0.5 * TYPICAL.vibration, rel=0.1)

    def test_height_compass_and_rangefinder(self, many: tuple[CopterDynamics, SensorSuite]) -> None:
        seen = [many[1].readings(i) for i in range(400)]
        height = np.array([s.pressure_alt_m for s in seen]) - PLACE.alt_amsl_m - 3.0
        assert height.std() == pytest.approx(math.hypot(TYPICAL.baro_white_m, TYPICAL.baro_drift_m), rel=0.12)
        field = np.array(earth_field(PLACE.lat_deg, PLACE.lon_deg))
        mag = np.array([s.mag for s in seen]) - field
        soft = np.sqrt((TYPICAL.mag_soft_iron * field) ** 2 + TYPICAL.mag_hard_iron**2 + TYPICAL.mag_white**2)
        assert mag.std(0) == pytest.approx(soft, rel=0.12)
        distance = np.array([s.range_m for s in seen])
        assert distance.std() == pytest.approx(TYPICAL.range_white_m + TYPICAL.range_share * 3.12, rel=0.12)
        assert distance.mean() == pytest.approx(3.12, abs=0.01)

    def test_gps(self, many: tuple[CopterDynamics, SensorSuite]) -> None:
        fixes = [many[1].fix(i) for i in range(400)]
        level = np.array([(f.north, f.east) for f in fixes])
        assert level.std() == pytest.approx(math.hypot(TYPICAL.gps_wander_m, TYPICAL.gps_white_m), rel=0.08)
        assert np.std([f.vn for f in fixes]) == pytest.approx(TYPICAL.gps_speed_mps, rel=0.12)

    def test_what_wanders_is_a_gauss_markov_process(self) -> None:
        rows = NoiseRows((1,), "test", 300, 1)
        wander = Wander(rows, np.array([2.0]), np.array([5.0]), 0.2)
        path = []
        for _ in range(400):
            wander.step()
            path.append(wander.value[0])
        values = np.array(path)
        assert values.std() == pytest.approx(2.0, rel=0.06)
        lag = 25  # 5 s: the correlation has fallen to 1/e
        correlation = (values[:-lag] * values[lag:]).mean() / values.var()
        assert correlation == pytest.approx(math.exp(-1.0), abs=0.05)


class TestGps:
    def test_solutions_come_late_and_five_times_a_second(self) -> None:
        body = bodies()
        sensors = suite(body, TYPICAL)
        times = set()
        for tick in range(1, 301):
            body.pos[0] += 10.0 * TICK_S
            sensors.tick(TICK_S)
            fix = sensors.fix(0)
            assert fix.time_s <= tick * TICK_S
            if tick > 100:
                assert TYPICAL.gps_delay_s - 1e-6 <= tick * TICK_S - fix.time_s < TYPICAL.gps_delay_s + 0.2 + 1e-6
                times.add(fix.time_s)
        assert len(times) == pytest.approx(10, abs=1)
        assert sensors.fix(0).north == pytest.approx(30.0 - 2.0, abs=6.0)

    def test_lost_and_found(self) -> None:
        sensors = suite(bodies(2), TYPICAL)
        sensors.tick(TICK_S)
        sensors.troubles.put(0, "test", Trouble(gps_lost=True))
        lost, other = sensors.fix(0), sensors.fix(1)
        assert (lost.fix_type, lost.satellites < 5, other.fix_type) == (1, True, 3)
        sensors.troubles.put(0, "test", FINE)
        assert sensors.fix(0).fix_type == 1  # it has to find its satellites again
        for _ in range(round(TYPICAL.gps_acquire_s / TICK_S)):
            sensors.tick(TICK_S)
        assert sensors.fix(0).fix_type == 3

    def test_causes_add_up_and_end_each_for_itself(self) -> None:
        sensors = suite(bodies())
        sensors.troubles.put(0, "one", Trouble(gps_shift=(10.0, 0.0, 0.0)))
        sensors.troubles.put(0, "other", Trouble(gps_shift=(0.0, 5.0, 0.0), baro_shift=2.0))
        assert (sensors.fix(0).north, sensors.fix(0).east) == (10.0, 5.0)
        assert sensors.readings(0).pressure_alt_m == pytest.approx(PLACE.alt_amsl_m + 22.0, abs=0.01)
        sensors.troubles.put(0, "one", FINE)
        assert (sensors.fix(0).north, sensors.fix(0).east) == (0.0, 5.0)
        sensors.troubles.put(0, "other", FINE)
        assert not sensors.troubles.any[0]
        assert sensors.fix(0).east == 0.0


class TestDeterminism:
    def test_the_same_seed_gives_the_same_readings_whoever_asks_how_often(self) -> None:
        asked, quiet = suite(bodies(3), TYPICAL), suite(bodies(3), TYPICAL)
        for _ in range(50):
            asked.tick(TICK_S)
            for i in (2, 0, 2):
                asked.readings(i)
            quiet.tick(TICK_S)
        assert [asked.readings(i) for i in range(3)] == [quiet.readings(i) for i in range(3)]
        assert asked.readings(1) == asked.readings(1)

    def test_another_seed_gives_others_and_so_does_another_tick(self) -> None:
        first, second = suite(bodies(), TYPICAL, seed=1), suite(bodies(), TYPICAL, seed=2)
        first.tick(TICK_S)
        second.tick(TICK_S)
        before = first.readings(0)
        assert before != second.readings(0)
        first.tick(TICK_S)
        assert first.readings(0).gyro != before.gyro

    def test_another_vehicle_changes_nothing_for_the_others(self) -> None:
        few, more = suite(bodies(2), TYPICAL), suite(bodies(5), TYPICAL)
        for _ in range(30):
            few.tick(TICK_S)
            more.tick(TICK_S)
        assert [few.readings(i) for i in range(2)] == [more.readings(i) for i in range(2)]


class TestEstimate:
    def run(self, noise: Noise, seconds: float, count: int = 100) -> tuple[CopterDynamics, Estimator]:
        body = bodies(count)
        estimate = Estimator(body, suite(body, noise), (3,))
        for _ in range(round(seconds / TICK_S)):
            estimate.refresh()
            estimate.observe(TICK_S)
        return body, estimate

    def test_without_noise_it_is_the_truth_itself(self) -> None:
        body, estimate = self.run(NONE, 0.1, 2)
        assert estimate.pos is body.pos
        assert estimate.vel is body.vel
        assert estimate.q is body.q

    def test_with_noise_it_is_near_the_truth(self) -> None:
        body, estimate = self.run(TYPICAL, 5.0)
        level = (estimate.pos - body.pos)[:2]
        assert level.std() == pytest.approx(TYPICAL.gps_wander_m, rel=0.15)
        assert (estimate.pos - body.pos)[2].std() == pytest.approx(TYPICAL.baro_drift_m, rel=0.2)
        assert (estimate.vel - body.vel).std() == pytest.approx(TYPICAL.believed_speed_mps, rel=0.15)
        euler = estimate.euler
        assert euler[:2].std() == pytest.approx(TYPICAL.believed_tilt, rel=0.2)
        assert euler[2].std() == pytest.approx(TYPICAL.believed_yaw, rel=0.2)
        lengths: Array = np.sqrt((estimate.q * estimate.q).sum(0))
        assert lengths == pytest.approx(np.ones(100))


def test_an_unknown_profile_names_those_there_are() -> None:
    with pytest.raises(BadConfig, match="none or typical"):
        noise_profile("lots")
