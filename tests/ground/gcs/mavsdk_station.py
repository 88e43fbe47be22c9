"""A station in MAVSDK, as its documentation shows: parameters of some vehicles, one mission up and down, one set.

python mavsdk_station.py ADDRESS VEHICLES MISSION_VEHICLE NAME=VALUE; prints JSON. It knows nothing of zmav.
"""

from __future__ import annotations

import asyncio
import json
import math
import sys
from typing import Any

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.mission import MissionAsync
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.autopilot import Autopilot
from mavsdk.plugins.mission import MissionItem, MissionPlan

PATIENCE_S = 60.0


def item(seq: int, alt: float) -> MissionItem:
    no = math.nan
    return MissionItem(
        latitude_deg=-35.361 + seq * 1e-4,
        longitude_deg=149.161,
        relative_altitude_m=alt,
        speed_m_s=5.0,
        is_fly_through=True,
        gimbal_pitch_deg=no,
        gimbal_yaw_deg=no,
        loiter_time_s=no,
        camera_photo_interval_s=no,
        acceptance_radius_m=no,
        yaw_deg=no,
        camera_photo_distance_m=no,
    )


async def main(address: str, vehicles: list[int], target: int, change: str) -> dict[str, Any]:
    mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    try:
        await mavsdk.add_any_connection(address)
        systems = await asyncio.wait_for(found(mavsdk, vehicles), PATIENCE_S)
        params = {}
        for sysid in vehicles:
            every = await ParamAsync(systems[sysid]).get_all_params()
            params[sysid] = {each.name: each.value for each in (*every.int_params, *every.float_params)}
        mission = MissionAsync(systems[target])
        plan = [item(seq, 20.0 + target) for seq in range(6)]
        await mission.upload_mission(MissionPlan(plan))
        back = (await mission.download_mission()).mission_items
        name, _, value = change.partition("=")
        param = ParamAsync(systems[target])
        await param.set_param_float(name, float(value))
        return {
            "params": params,
            "sent": [(i.latitude_deg, i.longitude_deg, i.relative_altitude_m) for i in plan],
            "back": [(i.latitude_deg, i.longitude_deg, i.relative_altitude_m) for i in back],
            "set": await param.get_param_float(name),
        }
    finally:
        mavsdk.destroy()


async def found(mavsdk: Any, vehicles: list[int]) -> dict[int, Any]:
    """The systems, once all of them have said by a heartbeat which autopilot they are: MAVSDK 4.1 makes them of any
    frame, as GENERIC until then, and reads the parameters of those as PX4's.
    """
    while True:
        there = {
            await system.get_system_id(): system
            for system in await mavsdk.get_systems()
            if await system.autopilot_type() in (Autopilot.PX4, Autopilot.ARDUPILOT)
        }
        if set(vehicles) <= there.keys():
            return there
        await asyncio.sleep(0.1)


if __name__ == "__main__":
    where, fleet, mission_of, wanted = sys.argv[1:]
    print(json.dumps(asyncio.run(main(where, [int(each) for each in fleet.split(",")], int(mission_of), wanted))))
