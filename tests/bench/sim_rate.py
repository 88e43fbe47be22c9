"""How much of a core the simulator takes: vehicles in flight with usual telemetry, stepped as fast as it goes.

    python tests/bench/sim_rate.py [SECONDS]

Prints, for 1, 3, 10 and 50 copters flying with one link each (about 90 messages a second), the CPU time of one
simulated second, in all and per vehicle, and what share of a core real time would take. Links lead to a sink in
memory: sockets and clients are not measured.
"""

from __future__ import annotations

import sys
import time

from zmav.mavlink.codec import Packer
from zmav.mavlink.dialect import load_dialect
from zmav.sim import World
from zmav.sim.protocol.channel import Channel

FLEETS = (1, 3, 10, 50)
RATES = {0: 2.0, 10: 10.0, 11: 10.0, 6: 5.0}  # MAV_DATA_STREAM -> Hz; 0 sets all of them first


class Sink:
    """Takes every frame and counts it."""

    def __init__(self) -> None:
        self.frames = 0

    def room(self) -> int:
        return 1 << 20

    def put(self, frame: bytes) -> None:
        self.frames += 1


def fly(world: World) -> list[Sink]:
    """Have every vehicle take off and fly a circle's worth of legs; its telemetry goes to a sink."""
    packer = Packer(load_dialect("ardupilotmega"), 255, 190)
    sinks = []
    channels: list[Channel] = []
    for vehicle in world.vehicles:
        sinks.append(Sink())
        channels.append(vehicle.node.open_channel(sinks[-1]))

    def tell(name: str, **fields: object) -> None:
        for vehicle, channel in zip(world.vehicles, channels, strict=True):
            vehicle.node.receive(channel, packer.pack(name, target_system=vehicle.sysid, target_component=1, **fields))

    for stream, rate in RATES.items():
        tell("REQUEST_DATA_STREAM", req_stream_id=stream, req_message_rate=round(rate), start_stop=1)
    world.step(5.0)
    tell("COMMAND_LONG", command=176, param1=1.0, param2=4.0)
    tell("COMMAND_LONG", command=400, param1=1.0)
    tell("COMMAND_LONG", command=22, param7=10.0)
    world.step(10.0)
    tell("SET_POSITION_TARGET_LOCAL_NED", coordinate_frame=1, type_mask=0x0DF8, x=5000.0, z=-20.0)
    return sinks


def main() -> None:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 10.0
    print(
        f"{'copters':>8} {'ms CPU per sim s':>17} {'per copter':>11} {'core at real time':>18} {'msg/s per copter':>17}"
    )
    for count in FLEETS:
        world = World(copters=count, epoch_s=0.0)
        sinks = fly(world)
        before = sum(sink.frames for sink in sinks)
        start = time.process_time()
        world.step(seconds)
        spent = (time.process_time() - start) / seconds
        rate = (sum(sink.frames for sink in sinks) - before) / seconds / count
        print(f"{count:8d} {spent * 1e3:17.1f} {spent * 1e3 / count:11.2f} {spent * 100:17.1f}% {rate:17.0f}")
        world.close()


if __name__ == "__main__":
    main()
