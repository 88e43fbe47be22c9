"""A MAVSDK client flies the PX4-rules copter as its documentation shows. It knows nothing of zmav.

The vehicle's loss of the stream is put off by a parameter: MAVSDK streams by the wall's clock, and the world is faster.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncGenerator, AsyncIterator, Callable
from typing import Any, TypeVar

import pytest
import pytest_asyncio

from tests.ports import free_udp_ports
from zmav.sim import SimVehicle, VehicleSpec, World

pytest.importorskip("mavsdk", reason="MAVSDK has no wheel for this machine")

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.ftp import FtpAsync
from mavsdk.asyncio.plugins.geofence import GeofenceAsync
from mavsdk.asyncio.plugins.info import InfoAsync
from mavsdk.asyncio.plugins.log_files import LogFilesAsync
from mavsdk.asyncio.plugins.mission import MissionAsync
from mavsdk.asyncio.plugins.offboard import OffboardAsync
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.plugins.geofence import FenceType, GeofenceData, Point, Polygon
from mavsdk.plugins.mission import MissionItem, MissionPlan
from mavsdk.plugins.offboard import Attitude, PositionNedYaw, VelocityNedYaw

SPEED = 10.0  # times real time
PATIENCE_S = 40.0
M_PER_DEG = 111319.5
T = TypeVar("T")


class Client:
    """The plugins of one system, and the vehicle behind it."""

    def __init__(self, system: Any, vehicle: SimVehicle) -> None:
        self.system = system
        self.vehicle = vehicle
        self.telemetry, self.action = TelemetryAsync(system), ActionAsync(system)
        self.offboard, self.mission = OffboardAsync(system), MissionAsync(system)
        self.param, self.info = ParamAsync(system), InfoAsync(system)
        self.ftp, self.logs, self.geofence = FtpAsync(system), LogFilesAsync(system), GeofenceAsync(system)

    async def near(self, north: float, east: float, down: float, within: float = 0.7) -> None:
        def arrived(m: Any) -> bool:
            p = m.position
            return bool(max(abs(p.north_m - north), abs(p.east_m - east), abs(p.down_m - down)) < within)

        await until(self.telemetry.subscribe_position_velocity_ned(), arrived)
        here = self.vehicle.px4.local
        assert math.dist(here, (north, east, down)) < within + 1.5  # it moves on while the message is under way

    async def mode(self, name: str) -> None:
        await until(self.telemetry.subscribe_flight_mode(), lambda mode: mode.name == name)


async def until(values: AsyncGenerator[T, None], true: Callable[[T], bool]) -> T:
    """The first of ``values`` for which ``true`` holds."""

    async def first() -> T:
        try:
            async for value in values:
                if true(value):
                    return value
        finally:
            await values.aclose()
        raise AssertionError("the subscription ended")

    return await asyncio.wait_for(first(), PATIENCE_S)


@pytest_asyncio.fixture
async def client() -> AsyncIterator[Client]:
    port = free_udp_ports(1)
    spec = VehicleSpec(autopilot="px4", endpoints=(f"onboard:0:{port}",), params={"COM_OF_LOSS_T": 20.0})
    with World([spec], speed=SPEED, ready_s=1.0) as world:
        mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
        try:
            await mavsdk.add_any_connection(f"udpin://127.0.0.1:{port}")
            system = await mavsdk.first_autopilot(PATIENCE_S)
            assert system is not None
            yield Client(system, world.vehicles[0])
        finally:
            mavsdk.destroy()


async def test_it_is_found_asked_and_told(client: Client) -> None:
    """Discovery, health, version, parameters of both types, all of them, a folder."""
    assert await client.system.get_system_id() == 1
    assert (await client.system.autopilot_type(), await client.system.vehicle_type()) == (1, 3)  # PX4, multicopter
    health = await until(client.telemetry.subscribe_health(), lambda h: h.is_armable and h.is_home_position_ok)
    assert health.is_local_position_ok and health.is_global_position_ok
    assert health.is_gyrometer_calibration_ok and health.is_accelerometer_calibration_ok
    assert health.is_magnetometer_calibration_ok
    await until(client.telemetry.subscribe_health_all_ok(), bool)
    version = await client.info.get_version()
    assert (version.flight_sw_major, version.flight_sw_minor) == (1, 16)
    assert (await client.info.get_identification()).legacy_uid == client.vehicle.uid
    params = client.vehicle.px4.params
    assert await client.param.get_param_int("COM_LOW_BAT_ACT") == 0
    await client.param.set_param_int("COM_LOW_BAT_ACT", 3)
    await client.param.set_param_float("MPC_XY_CRUISE", 7.5)
    assert (params["COM_LOW_BAT_ACT"], params["MPC_XY_CRUISE"]) == (3.0, 7.5)
    assert await client.param.get_param_float("MPC_XY_CRUISE") == 7.5
    every = await client.param.get_all_params()
    assert len(every.int_params) + len(every.float_params) == len(params)
    assert [entry.name for entry in (await client.ftp.list_directory("/")).entries if "log" in entry.name]


async def test_it_flies(client: Client) -> None:
    """Arm, take off, go to a place, OFFBOARD by position, velocity and attitude, land by itself; the log is listed."""
    telemetry, action, offboard = client.telemetry, client.action, client.offboard
    await until(telemetry.subscribe_health_all_ok(), bool)
    await action.set_takeoff_altitude(8.0)
    await action.arm()
    await action.takeoff()
    await until(telemetry.subscribe_position(), lambda p: p.relative_altitude_m > 7.3)
    await client.mode("HOLD")
    assert await until(telemetry.subscribe_in_air(), bool)
    home = await until(telemetry.subscribe_home(), lambda h: True)
    await action.goto_location(home.latitude_deg + 12 / M_PER_DEG, home.longitude_deg, home.absolute_altitude_m + 9, 90)
    await client.near(12.0, 0.0, -9.0)
    await offboard.set_position_ned(PositionNedYaw(12.0, 0.0, -9.0, 0.0))
    # PX4 wants to have seen the stream for a while; until then it stays in HOLD, and is asked again.
    async for mode in telemetry.subscribe_flight_mode():
        if mode.name == "OFFBOARD":
            break
        await offboard.start()
    await offboard.set_position_ned(PositionNedYaw(6.0, 4.0, -7.0, 0.0))
    await client.near(6.0, 4.0, -7.0)
    await offboard.set_velocity_ned(VelocityNedYaw(0.0, 2.0, 0.0, 0.0))
    await until(telemetry.subscribe_velocity_ned(), lambda v: abs(v.east_m_s - 2.0) < 0.2)
    await offboard.set_attitude(Attitude(0.0, -8.0, 0.0, client.vehicle.px4.airframe.hover_share))
    await until(telemetry.subscribe_attitude_euler(), lambda a: abs(a.pitch_deg + 8.0) < 2.0)
    await offboard.stop()
    await client.mode("HOLD")
    await action.land()
    await until(telemetry.subscribe_landed_state(), lambda state: state.name == "ON_GROUND")
    await until(telemetry.subscribe_armed(), lambda armed: not armed)
    assert [entry.size_bytes > 1000 for entry in await client.logs.get_entries()] == [True]


def item(north: float, home: Any) -> MissionItem:
    no = math.nan
    return MissionItem(
        latitude_deg=home.latitude_deg + north / M_PER_DEG,
        longitude_deg=home.longitude_deg,
        relative_altitude_m=6.0,
        speed_m_s=6.0,
        is_fly_through=True,
        gimbal_pitch_deg=no,
        gimbal_yaw_deg=no,
        loiter_time_s=no,
        camera_photo_interval_s=no,
        acceptance_radius_m=no,
        yaw_deg=no,
        camera_photo_distance_m=no,
    )


async def test_it_flies_a_mission(client: Client) -> None:
    """A fence and a mission go up and come back; the mission runs to its end, and then home."""
    telemetry, mission = client.telemetry, client.mission
    await until(telemetry.subscribe_health_all_ok(), bool)
    home = await until(telemetry.subscribe_home(), lambda h: True)
    corners = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    points = [Point(home.latitude_deg + n * 1e-3, home.longitude_deg + e * 1e-3) for n, e in corners]
    await client.geofence.upload_geofence(GeofenceData([Polygon(points, FenceType.INCLUSION)], []))
    assert len(client.vehicle.px4.fence) == 4
    await mission.upload_mission(MissionPlan([item(north, home) for north in (10.0, 0.0, -6.0)]))
    back = (await mission.download_mission()).mission_items
    assert [i.latitude_deg for i in back] == pytest.approx([home.latitude_deg + n / M_PER_DEG for n in (10, 0, -6)])
    await client.action.arm()
    await mission.start_mission()
    seen = []

    def finished(progress: Any) -> bool:
        seen.append(progress.current)
        return bool(progress.current == progress.total == 3)

    await until(mission.subscribe_mission_progress(), finished)
    assert sorted(set(seen)) == [0, 1, 2, 3]
    assert await mission.is_mission_finished()
    await client.action.return_to_launch()
    await until(telemetry.subscribe_armed(), lambda armed: not armed)
    assert math.hypot(*client.vehicle.px4.local[:2]) < 1.0
