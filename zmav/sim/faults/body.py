"""Motors, battery, radio, camera and the autopilot's own computer."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
from msgspec import Meta

from zmav.errors import BadInput
from zmav.sim.dynamics.battery import open_circuit_share
from zmav.sim.faults.base import AutopilotFault, Fault, Undo, Victim
from zmav.sim.protocol.gimbal import OTHER


class MotorFailure(Fault, frozen=True):
    """One motor (number: 1 is the first) gives only that share of its thrust: 0 nothing, 1 all of it."""

    KIND: ClassVar[str] = "motor"
    number: Annotated[int, Meta(ge=1, le=32)] = 1
    efficiency: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.0

    def check(self, victim: Victim) -> None:
        seat = victim.seat
        if self.number > seat.motors:
            expected = f"1 to {seat.motors}" if seat.motors else "a vehicle whose motors can fail"
            raise BadInput.wrong("number", self.number, expected, f"{victim.name} has no motor {self.number}")

    def begin(self, victim: Victim) -> Undo:
        seat = victim.seat
        seat.weaken_motor(self.number - 1, self.efficiency)
        return lambda: seat.weaken_motor(self.number - 1, 1.0)


class BatteryCollapse(Fault, frozen=True):
    """The battery has only so much percent of its charge left."""

    KIND: ClassVar[str] = "battery"
    left_percent: Annotated[float, Meta(ge=0.0, le=100.0)] = 5.0

    def begin(self, victim: Victim) -> Undo:
        handle = victim.seat.battery
        battery, i = handle.battery, handle.index
        charge = float(battery.charge[i])
        resting = float(open_circuit_share(np.array([charge]))[0]) * float(battery.full_v[i])
        consumed = float(battery.consumed[i])
        battery.drain(i, min(self.left_percent / 100.0, charge))
        lost = float(battery.consumed[i]) - consumed

        def mend() -> None:
            battery.fit(i, volts=resting, capacity_mah=float(battery.capacity_mah[i]))
            battery.consumed[i] -= lost

        return mend


class RcLoss(AutopilotFault, frozen=True):
    """The receiver hears the pilot's transmitter no more."""

    KIND: ClassVar[str] = "rc-loss"

    def begin(self, victim: Victim) -> Undo:
        pilot = victim.vehicle.brain.pilot
        pilot.lose()
        return pilot.regain


class Frozen(AutopilotFault, frozen=True):
    """The autopilot hangs: it says nothing and hears nothing, and the actuators stay where they are."""

    KIND: ClassVar[str] = "frozen"

    def begin(self, victim: Victim) -> Undo:
        vehicle, seat = victim.vehicle, victim.seat
        seat.freeze(True)
        vehicle.node.hung = True

        def go_on() -> None:
            vehicle.node.hung = vehicle.failed is not None
            seat.freeze(False)

        return go_on


class Reboot(AutopilotFault, frozen=True):
    """The autopilot starts again, wherever it is: its outputs stop, its clock and its sequence numbers begin again. One
    that hangs is well again.
    """

    KIND: ClassVar[str] = "reboot"
    ONCE: ClassVar[bool] = True

    def begin(self, victim: Victim) -> Undo:
        victim.end(Frozen.KIND)
        victim.vehicle.brain.now = victim.now()  # which one that hangs does not follow
        victim.vehicle.node.restart()
        return lambda: None


class CameraBlackout(Fault, frozen=True):
    """The camera's pictures are black, or show what the last good one did."""

    KIND: ClassVar[str] = "camera-blackout"
    picture: Literal["black", "frozen"] = "black"

    def check(self, victim: Victim) -> None:
        if victim.camera is None:
            raise BadInput(
                f"{victim.name} has no camera", field="vehicle", value=victim.name, expected="a vehicle with a camera"
            )

    def begin(self, victim: Victim) -> Undo:
        camera = victim.camera
        assert camera is not None
        camera.blackout = self.picture

        def show() -> None:
            camera.blackout = None

        return show


class GimbalFault(AutopilotFault, frozen=True):
    """The gimbal does not answer; has no yaw axis (stiff); or a ground station has its control (taken)."""

    KIND: ClassVar[str] = "gimbal"
    how: Literal["silent", "stiff", "taken"] = "silent"

    def begin(self, victim: Victim) -> Undo:
        gimbal = victim.vehicle.node.gimbal
        if self.how == "taken":
            gimbal.control = OTHER
        else:
            gimbal.silent, gimbal.turns = self.how == "silent", self.how != "stiff"

        def mend() -> None:
            gimbal.silent, gimbal.turns = False, True

        return mend
