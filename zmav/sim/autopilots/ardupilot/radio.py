"""What ArduPilot takes for its pilot's input: the receiver's channels, with those that a ground station overrides.

Overrides: https://ardupilot.org/dev/docs/mavlink-rcinput.html; the loss of the radio:
https://ardupilot.org/copter/docs/radio-failsafe.html
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from zmav.sim.autopilots.pilot import Pilot, Sticks

if TYPE_CHECKING:
    from zmav.sim.autopilots.ardupilot.vehicle import ArduVehicle

CHANNELS = 16
RELEASED = 0
IGNORED, RELEASED_UPPER = 65535, 65534  # UINT16_MAX and one less
IGNORE_RECEIVER, IGNORE_OVERRIDES = 1, 2  # RC_OPTIONS
NO_PULSES, LOW_THROTTLE = 1, 2  # SIM_RC_FAIL
NO_AXIS = 32767  # INT16_MAX in MANUAL_CONTROL
FRAME_S = 0.02
CONFIRMATIONS = 3  # throttle values in a row that start or end the failsafe
DEBOUNCE_S = 0.2
USUAL_TIMEOUT_S = 1.0
SHORTEST, LONGEST = 800, 2200  # microseconds: pulses beyond are none
LOW, MIDDLE, HIGH = 0, 1, 2
# RCn_OPTION
SAVE_WAYPOINT, CAMERA_TRIGGER, FENCE, MISSION_RESET, CLEAR_WAYPOINTS = 7, 9, 11, 24, 58
OVERRIDE_ENABLE, ARM_DISARM = 46, 153
RELAYS = {28: 0, 34: 1, 35: 2, 36: 3}
_NAMES = {7: "SaveWaypoint", 9: "CameraTrigger", 11: "Fence", 24: "MissionReset", 58: "ClearWaypoint"}
_NAMES |= {option: f"Relay{index + 1}" for option, index in RELAYS.items()}
_FUNCTIONS = {*_NAMES, OVERRIDE_ENABLE, ARM_DISARM}
_POSITIONS = ("LOW", "MIDDLE", "HIGH")
_UNTOUCHED_AT_FIRST = {ARM_DISARM}
_INFO = 6


class Radio(Sticks):
    """The autopilot's view of all channels; ``lost``: the failsafe is on."""

    def __init__(self, vehicle: ArduVehicle, pilot: Pilot) -> None:
        super().__init__()
        self.pilot = pilot
        self.lost = False
        self.overridable = True
        self._vehicle = vehicle
        self._overrides: dict[int, tuple[int, float]] = {}
        self._fresh = False
        self._next = self._heard = vehicle.now
        self._low = 0
        self._had_receiver = False
        self._switches: dict[int, tuple[int, int, float]] = {}

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
        """Apply a MANUAL_CONTROL: sticks as -1000 to 1000, the throttle 0 to 1000. Negative thrust is not taken."""
        if msg["z"] < 0:
            return
        axes = ((0, msg["y"], 1000, 2000), (1, -msg["x"] if msg["x"] != NO_AXIS else NO_AXIS, 1000, 2000))
        for index, value, offset, scale in (*axes, (2, msg["z"], 0, 1000), (3, msg["r"], 1000, 2000)):
            if value == NO_AXIS:
                self.set_override(index, RELEASED)
                continue
            low, high = (int(self._vehicle.params[f"RC{index + 1}_{end}"]) for end in ("MIN", "MAX"))
            self.set_override(index, max(int(low + (high - low) * (value + offset) / scale), 0))

    def set_override(self, index: int, pwm: int) -> None:
        if not self.overridable:
            return
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
        self._next = now + FRAME_S
        fail = int(self._vehicle.params["SIM_RC_FAIL"])
        receiving = self.pilot.sending and fail != NO_PULSES
        self._had_receiver |= receiving
        if receiving or self._fresh:
            self._fresh = False
            self._heard = now
            self._read(fail)
            self._watch_throttle()
        elif not self.lost and self._vehicle.params[self._vehicle.RADIO_PARAMS[0]]:
            self._set_lost(now - self._heard >= self._timeout)

    @property
    def _timeout(self) -> float:
        """Seconds without a frame; for a plane that of its short failsafe, and a rover has none."""
        params = self._vehicle.params
        return max(params.get("RC_FS_TIMEOUT", params.get("FS_SHORT_TIMEOUT", USUAL_TIMEOUT_S)), 0.1)

    def _read(self, fail: int) -> None:
        if not self._overrides and fail == 0:
            self.pwm = self.pilot.pwm
            return
        options = int(self._vehicle.params["RC_OPTIONS"])
        source = self.pilot.pwm if self.pilot.sending else self.pwm
        if fail == LOW_THROTTLE:
            source = [950 if i == 2 else 1500 for i in range(8)]
        merged = [*source, *[0] * (CHANNELS - len(source))]
        held = self.pwm + [0] * (CHANNELS - len(self.pwm))
        for index in range(CHANNELS):
            pwm = RELEASED if options & IGNORE_OVERRIDES else self._override_of(index)
            if pwm != RELEASED:
                merged[index] = pwm
            elif not self._had_receiver or options & IGNORE_RECEIVER:
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

    # ---- auxiliary switches

    def read_switches(self) -> None:
        """Ten times a second: what RCn_OPTION says, for each switch that was moved."""
        if not self.valid:
            return
        now = self._vehicle.now
        for channel in range(5, len(self.pwm) + 1):
            option = int(self._vehicle.params[f"RC{channel}_OPTION"])
            pwm = self.pwm[channel - 1]
            if option == 0 or not SHORTEST < pwm < LONGEST:
                continue
            position = LOW if pwm < 1200 else HIGH if pwm > 1800 else MIDDLE
            first = position if option in _UNTOUCHED_AT_FIRST else -1
            stands, moving, since = self._switches.get(channel, (first, first, now))
            if stands == position:
                moving = position
            elif moving != position:
                moving, since = position, now
            elif now - since >= DEBOUNCE_S:
                stands = position
                if option in _NAMES:
                    self._vehicle.say(_INFO, f"RC{channel}: {_NAMES[option]} {_POSITIONS[position]}")
                self.run_function(option, position)
            self._switches[channel] = stands, moving, since

    def run_function(self, option: int, position: int) -> bool:
        """Do what an auxiliary switch in that position does; False for a function that is not simulated."""
        modes = self._vehicle.SWITCH_MODES
        if option in modes:
            self._change_mode(modes[option], position)
            return True
        _act(self._vehicle, option, position)
        return option in _FUNCTIONS

    def _change_mode(self, number: int, position: int) -> None:
        if position == HIGH:
            self._vehicle.set_mode(number)
        elif self._vehicle.mode.number == number:
            self._vehicle.follow_switch(force=True)


def _override_enable(vehicle: ArduVehicle, position: int) -> None:
    if position == HIGH:
        vehicle.rc.overridable = True
    elif position == LOW:
        vehicle.rc.overridable = False
        vehicle.rc.clear_overrides()


def _arm(vehicle: ArduVehicle, position: int) -> None:
    if position == HIGH:
        vehicle.arm()
    elif position == LOW:
        vehicle.disarm(forced=True)


def _act(vehicle: ArduVehicle, option: int, position: int) -> None:
    """The functions that are no modes."""
    high = position == HIGH
    if option == FENCE:
        vehicle.fence.enable(high)
    elif option in RELAYS:
        vehicle.payload.set_relay(RELAYS[option], int(high))
    elif option == SAVE_WAYPOINT and high:
        vehicle.save_waypoint()
    elif option == CAMERA_TRIGGER and high:
        vehicle.payload.camera.shoot()
    elif option == MISSION_RESET and high:
        vehicle.mission.reset()
    elif option == CLEAR_WAYPOINTS and high:
        vehicle.mission.clear()
    elif option == OVERRIDE_ENABLE:
        _override_enable(vehicle, position)
    elif option == ARM_DISARM:
        _arm(vehicle, position)
