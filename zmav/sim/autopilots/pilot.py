"""The pilot's radio: channels of PWM as an RC receiver gives them, and the switch that chooses the mode.

Channel order is ArduPilot's default: roll, pitch, throttle, yaw, mode switch
(https://ardupilot.org/copter/docs/common-rcmap.html).
"""

from __future__ import annotations

SWITCH_PWM = (1165, 1295, 1425, 1555, 1685, 1800)  # centre of each of the six positions
SWITCH_EDGES = (1230, 1360, 1490, 1620, 1749)
DEADZONE = 0.05


class Sticks:
    """Channels as PWM, microseconds, and what the first five of them mean."""

    def __init__(self) -> None:
        self.pwm: list[int] = [1500, 1500, 1000, 1500, 1800, 1000, 1000, 1800]
        self.switch_channel = 5

    @property
    def switch_pwm(self) -> int:
        return self.pwm[self.switch_channel - 1]

    @property
    def switch(self) -> int:
        """The mode switch's position, 1 to 6."""
        return 1 + sum(self.switch_pwm > edge for edge in SWITCH_EDGES)

    @property
    def roll(self) -> float:
        return _centred(self.pwm[0])

    @property
    def pitch(self) -> float:
        """Positive: nose down, fly forward."""
        return -_centred(self.pwm[1])

    @property
    def yaw(self) -> float:
        return _centred(self.pwm[3])

    @property
    def throttle(self) -> float:
        return min(max((self.pwm[2] - 1000) / 1000.0, 0.0), 1.0)

    @property
    def climb(self) -> float:
        """The throttle stick as a wish to climb: -1 to 1, zero in the middle."""
        return _centred(self.pwm[2])


class Pilot(Sticks):
    """Sticks from -1 to 1 (throttle 0 to 1), as PWM; set from any thread, read by the autopilot at its next update."""

    def __init__(self, *, radio: bool = True) -> None:
        super().__init__()
        self.radio, self._lost = radio, False
        """the transmitter is on; and out of range"""

    @property
    def heard(self) -> bool:
        """The receiver gives pulses."""
        return self.radio and not self._lost

    def sticks(
        self,
        *,
        roll: float | None = None,
        pitch: float | None = None,
        throttle: float | None = None,
        yaw: float | None = None,
    ) -> None:
        """Move sticks; what is not named stays. Roll right, nose down, and turning right are positive."""
        if roll is not None:
            self.pwm[0] = round(1500 + 500 * roll)
        if pitch is not None:
            self.pwm[1] = round(1500 - 500 * pitch)
        if throttle is not None:
            self.pwm[2] = round(1000 + 1000 * throttle)
        if yaw is not None:
            self.pwm[3] = round(1500 + 500 * yaw)

    def turn_switch(self, position: int) -> None:
        """Turn the mode switch to one of its positions 1 to 6."""
        self.pwm[self.switch_channel - 1] = SWITCH_PWM[position - 1]

    def flip(self, channel: int, pwm: int) -> None:
        """Set a channel, as a switch or a knob does, to a pulse width in microseconds."""
        self.pwm[channel - 1] = pwm

    def lose(self) -> None:
        """Out of range: the receiver gives no pulses, whatever is switched on."""
        self._lost = True

    def regain(self) -> None:
        """In range again."""
        self._lost = False


def _centred(pwm: int) -> float:
    value = min(max((pwm - 1500) / 500.0, -1.0), 1.0)
    return 0.0 if abs(value) < DEADZONE else value
