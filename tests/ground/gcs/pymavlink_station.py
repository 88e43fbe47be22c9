"""A station in a few lines of pymavlink, as people write them: every vehicle's parameters, one mission up and down.

python pymavlink_station.py ADDRESS SYSID VEHICLES MISSION_VEHICLE; prints JSON. It knows nothing of zmav.
"""

from __future__ import annotations

import collections
import json
import sys
import time
from typing import Any

from pymavlink import mavutil

PATIENCE_S = 60.0
STEP = 1e-4


def main(address: str, sysid: int, vehicles: list[int], target: int) -> dict[str, Any]:
    link = mavutil.mavlink_connection(address, source_system=sysid)
    heard: collections.Counter[tuple[str, int, int]] = collections.Counter()
    foreign: list[str] = []

    def recv(*names: str, source: int = 0) -> Any:
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            message = link.recv_match(blocking=True, timeout=1.0)
            if message is None:
                beat()
                continue
            system, name = message.get_srcSystem(), message.get_type()
            addressed = getattr(message, "target_system", 0)
            if name[:7] not in ("BAD_DAT", "UNKNOWN") and (system not in vehicles or addressed not in (0, sysid)):
                foreign.append(f"{name} from {system} to {addressed}")
            if name in names and source in (0, system):
                heard[name, system, getattr(message, "param_index", getattr(message, "seq", -1))] += 1
                return message
        raise TimeoutError(
            f"no {names} of {source or 'anybody'}; so far {collections.Counter((n, s) for n, s, _ in heard)}"
        )

    def beat() -> None:
        link.mav.heartbeat_send(mavutil.mavlink.MAV_TYPE_GCS, mavutil.mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0)

    beat()
    for system in vehicles:
        recv("HEARTBEAT", source=system)
    for system in vehicles:
        link.mav.param_request_list_send(system, 1)
    params: dict[int, dict[str, bytes]] = {system: {} for system in vehicles}
    counts: dict[int, int] = {}
    while len(counts) < len(vehicles) or any(len(params[s]) < counts[s] for s in vehicles):
        value = recv("PARAM_VALUE")
        system = value.get_srcSystem()
        counts[system] = value.param_count
        params[system][value.param_id] = bytes(value.get_msgbuf()[10:14])

    # The first item is home on an ArduPilot; on a PX4 it is flown to.
    items = [(-35.36 + seq * STEP, 149.16, 20.0 + target) for seq in range(7)]
    link.mav.mission_count_send(target, 1, len(items), 0)
    answers = ("MISSION_REQUEST_INT", "MISSION_REQUEST", "MISSION_ACK")
    while (asked := recv(*answers, source=target)).get_type() != "MISSION_ACK":
        lat, lon, alt = items[asked.seq]
        link.mav.mission_item_int_send(
            target, 1, asked.seq, 3, 16, 0, 1, 0, 0, 0, 0, round(lat * 1e7), round(lon * 1e7), alt, 0
        )
    link.mav.mission_request_list_send(target, 1, 0)
    back = []
    for seq in range(recv("MISSION_COUNT", source=target).count):
        link.mav.mission_request_int_send(target, 1, seq, 0)
        item = recv("MISSION_ITEM_INT", source=target)
        back.append((item.seq, item.x, item.y, item.z))
    link.mav.mission_ack_send(target, 1, 0, 0)
    return {
        "ack": asked.type,
        "sent": [(seq, round(lat * 1e7), round(lon * 1e7), alt) for seq, (lat, lon, alt) in enumerate(items)],
        "back": back,
        "params": {system: {name: raw.hex() for name, raw in found.items()} for system, found in params.items()},
        "twice": [
            (name, system, index, n)
            for (name, system, index), n in heard.items()
            if n > 1 and name in ("PARAM_VALUE", "MISSION_ITEM_INT")
        ],
        "foreign": foreign,
    }


if __name__ == "__main__":
    where, own, fleet, mission = sys.argv[1:]
    print(json.dumps(main(where, int(own), [int(each) for each in fleet.split(",")], int(mission))))
