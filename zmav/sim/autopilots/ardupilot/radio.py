"""What ArduPilot takes for its pilot's input: the receiver's channels, with those that a ground station overrides.

Overrides: https://ardupilot.org/dev/docs/mavlink-rcinput.html; the loss of the radio:
https://ardupilot.org/copter/docs/radio-failsafe.html
"""

from __future__ import annotations

from typing import Any

from zmav.sim.autopilots.ardupilot.state import VehicleState
from zmav.sim.autopilots.pilot import Pilot, Sticks

CHANNELS = 16
RELEASED = 0
IGNORED, RELEASED_UPPER = 65535, 65534  # UINT16_MAX and one less
NO_AXIS = 32767  # INT16_MAX in MANUAL_CONTROL
FRAME_S = 0.02
CONFIRMATIONS = 3  # throttle values in a row that start or end the failsafe
USUAL_TIMEOUT_S = 1.0


class Radio(Sticks):
    """The autopilot's view of all channels; ``lost``: the failsafe is on."""

    def __init__(self, vehicle: VehicleState, pilot: Pilot) -> None:
        super().__init__()
        self.pilot = pilot
        self.lost = False
        self._vehicle = vehicle
        self._overrides: dict[int, tuple[int, float]] = {}
        self._fresh = False
        self._next = self._heard = vehicle.now
        self._low = 0
        self._had_receiver = False

    # ---- from the ground

    def override(self, msg: dict[str, Any]) -> None:
        """Apply an RC_CHANNELS_OVERRIDE: of the first eight channels 0 releases one and 65535 leaves it, of the
        others 65534 releases one, and 0 and 65535 leave it.
        """
        for index in range(CHANNELS):
            value = msg[f"chan{index + 1}_raw"]
            if index < 8:
                if value != IGNORED:
                    self.set_override(index, value)
            elif value not in (0, IGNORED):
                self.set_override(index, RELEASED if value == RELEASED_UPPER else value)

    def manual(self, msg: dict[str, Any]) -> None:
        """Apply a MANUAL_CONTROL by the vehicle's :attr:`~.VehicleState.AXES`; none with a thrust below the lowest."""
        if any(name == "z" and msg["z"] < lowest for name, _, _, lowest in self._vehicle.AXES):
            return
        for name, index, sign, lowest in self._vehicle.AXES:
            if msg[name] == NO_AXIS:
                self.set_override(index, RELEASED)
                continue
            low, high = (int(self._vehicle.params[f"RC{index + 1}_{end}"]) for end in ("MIN", "MAX"))
            pwm = low + (high - low) * (sign * msg[name] - lowest) / (1000 - lowest)
            self.set_override(index, max(int(pwm), 0))

    def set_override(self, index: int, pwm: int) -> None:
        self._overrides[index] = (pwm, self._vehicle.now)
        self._fresh = True

    def clear_overrides(self) -> None:
        self._overrides.clear()

    def _override_of(self, index: int) -> int:
        """The pulse width that a channel is held at; 0 for none."""
        pwm, since = self._overrides.get(index, (RELEASED, 0.0))
        lasts = self._vehicle.params["RC_OVERRIDE_TIME"]
        held = pwm != RELEASED and (lasts < 0 or self._vehicle.now - since < lasts)
        return pwm if held else RELEASED

    # ---- every tick

    def update(self) -> None:
        """Read a frame where there is one, and watch for the loss of the radio."""
        now = self._vehicle.now
        if now < self._next:
            return
        self._next = now + FRAME_S - self._vehicle.dt / 2  # half a tick early: times are rounded
        receiving = self.pilot.heard
        self._had_receiver |= receiving
        if receiving or self._fresh:
            self._fresh = False
            self._heard = now
            self._read()
            self._watch_throttle()
        elif not self.lost and self._vehicle.params[self._vehicle.RADIO_PARAMS[0]]:
            self._set_lost(now - self._heard >= self._timeout)

    @property
    def _timeout(self) -> float:
        """Seconds without a frame; for a plane that of its short failsafe, and a rover has none."""
        params = self._vehicle.params
        return max(params.get("RC_FS_TIMEOUT", params.get("FS_SHORT_TIMEOUT", USUAL_TIMEOUT_S)), 0.1)

    def _read(self) -> None:
        if not self._overrides:
            self.pwm = self.pilot.pwm
            return
        source = self.pilot.pwm if self.pilot.heard else self.pwm
        merged = [*source, *[0] * (CHANNELS - len(source))]
        held = self.pwm + [0] * (CHANNELS - len(self.pwm))
        for index in range(CHANNELS):
            pwm = self._override_of(index)
            if pwm != RELEASED:
                merged[index] = pwm
            elif not self._had_receiver:
                merged[index] = held[index]
        self.pwm = merged

    def _watch_throttle(self) -> None:
        params = self._vehicle.params
        enabled, lowest = self._vehicle.RADIO_PARAMS
        if not params[enabled]:
            self._set_lost(False)
        elif self.pwm[2] < params[lowest]:
            if not self.lost:
                self._low += 1
                if self._low >= CONFIRMATIONS:
                    self._set_lost(True)
        else:
            self._low = max(self._low - 1, 0)
            if self._low == 0:
                self._set_lost(False)

    def _set_lost(self, lost: bool) -> None:
        if lost != self.lost:
            self.lost = lost
            self._vehicle.reactions.radio_changed(lost)

    @property
    def silent_s(self) -> float:
        """Since the last frame or override, s."""
        return self._vehicle.now - self._heard

    @property
    def valid(self) -> bool:
        """The sticks may be believed."""
        return not self.lost and self._low == 0
