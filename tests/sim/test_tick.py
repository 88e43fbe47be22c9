"""A world that ticks more often: the same flight, and streams as quick as a controller outside wants them."""

from __future__ import annotations

import itertools
import math

import pytest

from tests.sim.conftest import Gcs
from tests.sim.px4.conftest import Companion
from zmav.errors import BadConfig
from zmav.sim import VehicleSpec, World

QUICK = {30: "ATTITUDE", 31: "ATTITUDE_QUATERNION", 32: "LOCAL_POSITION_NED", 105: "HIGHRES_IMU", 331: "ODOMETRY"}


def at(tick_hz: int, **options: object) -> Companion:
    spec = VehicleSpec(autopilot="px4", endpoints=(), **options)  # type: ignore[arg-type]
    world = World([spec], epoch_s=0.0, ready_s=0.5, tick_hz=tick_hz)
    return Companion(world, world.vehicles[0], "pty")  # a board's: PX4's UDP links give no more than 181 Hz


@pytest.mark.parametrize("tick_hz", [0, 50, 150, 250, 1100])
def test_other_rates_are_refused(tick_hz: int) -> None:
    with pytest.raises(BadConfig, match="in hundreds"):
        World(tick_hz=tick_hz)


@pytest.mark.parametrize(("tick_hz", "asked", "given"), [(500, 250, 250.0), (300, 250, 250.0), (100, 250, 100.0)])
def test_streams_go_as_quick_as_the_world_ticks(tick_hz: int, asked: int, given: float) -> None:
    companion = at(tick_hz)
    companion.ready()
    for number in QUICK:
        assert companion.command(511, number, 1e6 / asked) == [0]
    companion.world.step(0.1)
    companion.clear()
    companion.world.step(1.0)
    for name in QUICK.values():
        heard = companion.timed(name)
        assert len(heard) == pytest.approx(given, abs=2), name
        gaps = [after - before for (before, _), (after, _) in itertools.pairwise(heard)]
        assert max(gaps) < 2.0 / given + 1e-6
    companion.world.close()


def test_each_message_is_of_its_own_moment() -> None:
    companion = at(500)
    companion.offboard(lambda: companion.velocity(2.0, 0.0))
    assert companion.command(511, 32, 4000) == [0]
    companion.stream(0.3, lambda: companion.velocity(2.0, 0.0))
    norths = [m["x"] for m in companion.all("LOCAL_POSITION_NED")][-60:]
    assert len(set(norths)) == len(norths)  # never the same numbers twice
    companion.world.close()


def test_a_torque_acts_at_the_next_tick() -> None:
    """Not when the commander looks at its setpoints again, fifty times a second."""
    companion = at(500, firmware="1.13")

    def say(yaw: float) -> None:
        controls = [0.0, 0.0, yaw, 0.5, 0.0, 0.0, 0.0, 0.0]
        companion.send("SET_ACTUATOR_CONTROL_TARGET", group_mlx=0, controls=controls)

    companion.offboard(lambda: say(0.0))
    companion.stream(0.5, lambda: say(0.0))
    outputs = companion.vehicle.node.seat.outputs()
    say(0.2)
    companion.world.step()
    assert companion.vehicle.node.seat.outputs() != pytest.approx(outputs, abs=1e-3)
    companion.world.close()


def test_the_flight_is_the_same() -> None:
    """Loops that are counted in ticks keep their rates: a flight does not depend on how often the world ticks."""
    tracks = []
    for tick_hz in (100, 400):
        companion = at(tick_hz)
        companion.offboard(lambda c=companion: c.position(0.0, 0.0, -4.0))  # type: ignore[misc]
        track = []
        for _ in range(8):
            companion.stream(0.5, lambda c=companion: c.position(6.0, 0.0, -4.0))  # type: ignore[misc]
            track.append(companion.ned)
        tracks.append(track)
        companion.world.close()
    assert max(math.dist(a, b) for a, b in zip(*tracks, strict=True)) < 0.1


def test_an_arducopter_takes_off_alike() -> None:
    heights = []
    for tick_hz in (100, 300):
        world = World([VehicleSpec(endpoints=())], epoch_s=0.0, ready_s=0.5, tick_hz=tick_hz)
        gcs = Gcs(world, world.vehicles[0])
        gcs.until(lambda v=world.vehicles[0]: v.copter.position_ok)  # type: ignore[misc]
        assert [gcs.command(176, 1, 4), gcs.command(400, 1), gcs.command(22, 0, 0, 0, 0, 0, 0, 5.0)] == [0, 0, 0]
        world.step(5.0)
        heights.append(gcs.ned[2])
        world.close()
    assert heights[0] < -1.0
    assert heights[0] == pytest.approx(heights[1], abs=0.05)
