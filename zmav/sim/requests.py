"""What a running simulator can be asked by its control socket: each request's arguments and who answers it."""

from __future__ import annotations

import math
from concurrent.futures import Future
from typing import TYPE_CHECKING, Any

import msgspec

from zmav.sim.faults import FaultStatus, make_fault
from zmav.sim.listener import Offer
from zmav.sim.status import WorldStatus

if TYPE_CHECKING:
    from zmav.sim.world import World


class Nothing(msgspec.Struct, forbid_unknown_fields=True):
    """No arguments."""


class Speed(msgspec.Struct, forbid_unknown_fields=True):
    """``times`` real time; 0: as fast as it goes."""

    times: float


class Step(msgspec.Struct, forbid_unknown_fields=True):
    """Simulated seconds to go on for."""

    seconds: float


class Fault(msgspec.Struct, forbid_unknown_fields=True):
    """Put a fault on: ``vehicle`` by name or "all"; ``for_s`` simulated seconds, or until it is cleared."""

    vehicle: str
    kind: str
    for_s: float | None = None
    parameters: dict[str, Any] = {}


class Pilot(msgspec.Struct, forbid_unknown_fields=True):
    """What the pilot's hands do: the mode switch, and channels as pulse widths in us."""

    vehicle: str
    mode: str | None = None
    channels: dict[int, int] = {}


class Clear(msgspec.Struct, forbid_unknown_fields=True):
    """End faults: all, of one vehicle, of one kind, or of both."""

    vehicle: str | None = None
    kind: str | None = None


def offers(world: World) -> dict[str, Offer]:
    """By name; all of it is called in the world's thread."""

    def pause(_: Nothing) -> WorldStatus:
        world.pause()
        return world.status()

    def resume(_: Nothing) -> WorldStatus:
        world.resume()
        return world.status()

    def speed(args: Speed) -> WorldStatus:
        world.set_speed(args.times if args.times != 0.0 else math.inf)
        return world.status()

    def step(args: Step) -> Future[WorldStatus]:
        return world.advance(args.seconds)

    def fault(args: Fault) -> list[FaultStatus]:
        return world.put_fault(args.vehicle, make_fault(args.kind, args.parameters), args.for_s)

    def pilot(args: Pilot) -> WorldStatus:
        world.take(args.vehicle, args.mode, args.channels)
        return world.status()

    return {
        "fault": Offer(Fault, fault),
        "clear": Offer(Clear, lambda args: world.clear(args.vehicle, args.kind)),
        "pilot": Offer(Pilot, pilot),
        "faults": Offer(Nothing, lambda _: world.faults()),
        "status": Offer(Nothing, lambda _: world.status()),
        "pause": Offer(Nothing, pause),
        "resume": Offer(Nothing, resume),
        "speed": Offer(Speed, speed),
        "step": Offer(Step, step),
        "stop": Offer(Nothing, lambda _: world.stop()),
    }
