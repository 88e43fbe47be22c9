"""How much of a core the simulator takes: vehicles in flight with default telemetry, stepped as fast as it goes.

    python tests/bench/sim_rate.py [SECONDS] [KIND...]

For 1, 5, 10 and 50 vehicles of each kind, on their way with one link each: the CPU time of one simulated second, in all
and per vehicle, what share of a core real time takes, and how many vehicles one core would carry at that price. Copters
and planes have the telemetry that a ground station asks for (about 100 messages a second), a PX4 what its onboard link
sends by itself. A last line for each kind says how the cost grows from 1 and from 10 vehicles to 50. Links lead to a
sink in memory: sockets and clients are not measured.
"""

from __future__ import annotations

import sys
import time

from zmav.mavlink import load_dialect
from zmav.mavlink.codec import Packer
from zmav.sim import World
from zmav.sim.protocol.channel import Channel
from zmav.sim.spec import ARDUCOPTER, ARDUPLANE, ARDUROVER, PX4, VehicleSpec

FLEETS = (1, 5, 10, 50)
KINDS = {"copter": ARDUCOPTER, "px4": PX4, "rover": ARDUROVER, "plane": ARDUPLANE}
RATES = {0: 2.0, 10: 10.0, 11: 10.0, 6: 5.0}  # MAV_DATA_STREAM -> Hz; 0 sets all of them first
GUIDED = {"copter": 4, "rover": 15}
PLANE_TAKEOFF = 13
PX4_MISSION_TAKEOFF = (4.0, 2.0)  # main and sub mode


class Sink:
    """Takes every frame and counts it."""

    def __init__(self) -> None:
        self.frames = 0

    def room(self) -> int:
        return 1 << 20

    def put(self, frame: bytes) -> None:
        self.frames += 1


class Fleet:
    """Vehicles of one kind, each with a ground station that tells it to be on its way."""

    def __init__(self, kind: str, count: int) -> None:
        self.kind = kind
        self.world = World([VehicleSpec(autopilot=KINDS[kind]) for _ in range(count)], epoch_s=0.0)
        self._packer = Packer(load_dialect("ardupilotmega"), 255, 190)
        self.sinks = [Sink() for _ in self.world.vehicles]
        link = "onboard" if kind == "px4" else ""
        self._channels: list[Channel] = [
            vehicle.node.open_channel(sink, link) for vehicle, sink in zip(self.world.vehicles, self.sinks, strict=True)
        ]

    def tell(self, name: str, **fields: object) -> None:
        for vehicle, channel in zip(self.world.vehicles, self._channels, strict=True):
            target = {} if name == "HEARTBEAT" else {"target_system": vehicle.sysid, "target_component": 1}
            vehicle.node.receive(channel, self._packer.pack(name, **target, **fields))

    def command(self, number: int, *params: float) -> None:
        self.tell("COMMAND_LONG", command=number, **{f"param{i}": float(p) for i, p in enumerate(params, start=1)})

    def set_off(self) -> None:
        """Have all of them on their way."""
        self.tell("HEARTBEAT", type=6)
        if self.kind != "px4":
            for stream, rate in RATES.items():
                self.tell("REQUEST_DATA_STREAM", req_stream_id=stream, req_message_rate=round(rate), start_stop=1)
        self.world.step(6.0)
        if self.kind == "px4":
            self.command(176, 1.0, *PX4_MISSION_TAKEOFF)
            self.command(400, 1.0)
            self.world.step(12.0)
        elif self.kind == "plane":
            self.command(176, 1.0, PLANE_TAKEOFF)
            self.command(400, 1.0)
            self.world.step(20.0)
        else:
            self.command(176, 1.0, GUIDED[self.kind])
            self.command(400, 1.0)
            self.command(22, 0, 0, 0, 0, 0, 0, 10.0)
            self.world.step(10.0)
            self.tell("SET_POSITION_TARGET_LOCAL_NED", coordinate_frame=1, type_mask=0x0DF8, x=5000.0, z=-20.0)

    def measure(self, seconds: float) -> tuple[float, float]:
        """CPU seconds of a simulated second, and messages a second of each vehicle."""
        before = sum(sink.frames for sink in self.sinks)
        start = time.process_time()
        self.world.step(seconds)
        spent = (time.process_time() - start) / seconds
        return spent, (sum(sink.frames for sink in self.sinks) - before) / seconds / len(self.sinks)


def main() -> None:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 10.0
    heads = (("", 8), ("number", 6), ("ms CPU per sim s", 17), ("per vehicle", 12), ("of a core", 10), ("a core", 7))
    print(" ".join(f"{head:>{width}}" for head, width in heads), " msg/s")
    for kind in sys.argv[2:] or KINDS:
        costs = {}
        for count in FLEETS:
            fleet = Fleet(kind, count)
            fleet.set_off()
            spent, rate = fleet.measure(seconds)
            moving = all(vehicle.status().armed for vehicle in fleet.world.vehicles)
            fleet.world.close()
            costs[count] = spent
            note = "" if moving else "  (not all are on their way)"
            each = spent / count
            print(
                f"{kind:>8} {count:6d} {spent * 1e3:17.1f} {each * 1e3:12.2f} {spent * 100:9.1f}% "
                f"{1.0 / each:7.0f} {rate:6.0f}{note}"
            )
        print(f"{kind:>8} 50 cost {costs[50] / costs[1]:.1f} times 1, and {costs[50] / costs[10]:.1f} times 10")


if __name__ == "__main__":
    main()
