"""The ground that a simulated ArduPilot asks its station for: which block of it, and how much it keeps."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.sim.conftest import GUIDED, POSITION
from tests.sim.plans import at, degrees, upload
from zmav.sim import VehicleSpec

if TYPE_CHECKING:
    from tests.sim.conftest import Gcs, MakeGcs

OVER_TERRAIN = 10  # MAV_FRAME
BITS = 56
FAR_M = 30_000.0


def test_a_block_that_nobody_knows_keeps_no_other_from_being_asked_for(gcs: Gcs) -> None:
    gcs.world.step(2.0)
    gcs.vehicle.copter.params.set("TERRAIN_ENABLE", 1)
    home = gcs.last("TERRAIN_REQUEST")
    block = {"lat": home["lat"], "lon": home["lon"], "grid_spacing": home["grid_spacing"]}
    gcs.send("TERRAIN_DATA", **block, gridbit=0, data=[600] * 16)  # the rest of it got lost
    upload(gcs, [at(16, FAR_M, 0.0, 20.0, frame=OVER_TERRAIN)])
    asked = [gcs.last("TERRAIN_REQUEST") for _ in range(4)]
    assert {request["lat"] for request in asked} > {home["lat"]}
    assert {request["mask"] for request in asked} == {(1 << BITS) - 1, (1 << BITS) - 2}


def test_places_without_number_leave_it_room(gcs: Gcs) -> None:
    """The report counts what is pending in sixteen bits."""
    gcs.put_up()
    copter = gcs.vehicle.copter
    copter.params.set("TERRAIN_ENABLE", 1)
    assert copter.mode.number == GUIDED
    for i in range(1300):
        lat, lon = degrees(200.0 + 3000.0 * i, 0.0)
        gcs.send(
            "SET_POSITION_TARGET_GLOBAL_INT",
            coordinate_frame=OVER_TERRAIN,
            type_mask=POSITION,
            lat_int=lat,
            lon_int=lon,
            alt=20.0,
        )
    assert gcs.last("TERRAIN_REPORT")["pending"] < 65535
    gcs.world.step(1.0)
    assert gcs.vehicle.failed is None


def test_a_rover_knows_no_terrain_and_drives_on(make_gcs: MakeGcs) -> None:
    gcs = make_gcs([VehicleSpec(autopilot="ardurover")])
    gcs.world.step(2.0)
    assert upload(gcs, [at(16, 5.0, 0.0, frame=OVER_TERRAIN)]) == 0
    gcs.command(511, gcs.dialect.message("TERRAIN_REPORT").id, 1e5)
    assert gcs.command(176, 1, 10) == 0
    gcs.world.step(2.0)
    assert gcs.vehicle.failed is None
    assert gcs.vehicle.rover.mode.place is not None
