"""Steps and doublets that are added to a controller's reference in flight: what a response is measured by.

It is added to the one channel and to nothing else: what a jump would feed forward is no number, and how the loop
follows by itself is what the report is about.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from agents.controllers.types import Array, Level, Reference
from zmav import wire
from zmav.errors import BadInput
from zmav.rotation import heading, product

Kind = Literal["step", "doublet"]
KINDS: tuple[Kind, ...] = ("step", "doublet")
SHORTEST, LONGEST = 0.02, 300.0
"""s of an injection"""
MOST_TURN = 0.8
"""rad that rates about roll or pitch may add up to while they are injected"""


@dataclass(frozen=True)
class ReferenceChannel:
    """A number of the reference that can be added to."""

    levels: tuple[Level, ...]
    """of the references that have it"""
    unit: str
    most: float
    """amplitude, in that unit"""
    part: str
    """of the reference: a vector, or its yaw; an angle of a reference without a yaw is one of its attitude"""
    axis: int = 0
    """of that vector"""


CHANNELS: dict[str, ReferenceChannel] = {
    "x": ReferenceChannel(("position",), "m", 20.0, "pos", 0),
    "y": ReferenceChannel(("position",), "m", 20.0, "pos", 1),
    "z": ReferenceChannel(("position", "altitude"), "m", 10.0, "pos", 2),
    "vx": ReferenceChannel(("velocity",), "m/s", 8.0, "vel", 0),
    "vy": ReferenceChannel(("velocity",), "m/s", 8.0, "vel", 1),
    "vz": ReferenceChannel(("velocity",), "m/s", 3.0, "vel", 2),
    "roll": ReferenceChannel(("altitude", "attitude"), "rad", 0.6, "attitude"),
    "pitch": ReferenceChannel(("altitude", "attitude"), "rad", 0.6, "attitude"),
    "yaw": ReferenceChannel(("position", "velocity", "altitude", "attitude"), "rad", math.pi / 2, "yaw", 0),
    "p": ReferenceChannel(("rates",), "rad/s", 4.0, "rates", 0),
    "q": ReferenceChannel(("rates",), "rad/s", 4.0, "rates", 1),
    "r": ReferenceChannel(("rates",), "rad/s", 2.0, "rates", 2),
}
"""North, east and down (z is down), their velocities, Euler angles (yaw, then pitch, then roll), rates about the body's
axes. An altitude reference is a height and an attitude."""


class Inject(wire.Order, kw_only=True):
    """Add a signal to the reference: ``do/inject`` of a controller's agent."""

    kind: Kind
    channel: str
    """of :data:`CHANNELS`"""
    amplitude: float
    """in the channel's unit; a negative one begins the other way"""
    seconds: float
    """it lasts; of a doublet, each half"""


class Injection:
    """What is added at each time from ``start_t`` on (s, by the clock of :meth:`apply`'s ``t``).

    Raises :class:`~zmav.errors.BadInput` as :func:`check` does.
    """

    def __init__(self, args: Inject, level: Level, start_t: float) -> None:
        check(args, level)
        self.args, self.level, self.start_t = args, level, start_t
        self.channel = CHANNELS[args.channel]
        self.seconds = duration(args)

    def done(self, t: float) -> bool:
        """It is over: nothing is added any more."""
        return t - self.start_t >= self.seconds

    def value(self, t: float) -> float:
        """What is added at ``t``."""
        since = t - self.start_t
        if not 0.0 <= since < self.seconds:
            return 0.0
        back = self.args.kind == "doublet" and since >= self.args.seconds
        return -self.args.amplitude if back else self.args.amplitude

    def apply(self, reference: Reference, t: float) -> float:
        """Add to ``reference`` as it is to be at ``t``; gives what was added.

        The reference's vectors are replaced and not written to: others who hold them see no change. A reference of
        another level than it was made for (another controller was loaded) gets nothing.
        """
        if reference.level != self.level:
            return 0.0
        added = self.value(t)
        if added == 0.0:
            return 0.0
        part, axis = self.channel.part, self.channel.axis
        if part == "yaw" and self.level in ("position", "velocity"):
            reference.yaw = math.remainder(reference.yaw + added, 2.0 * math.pi)
        elif part in ("yaw", "attitude"):
            reference.attitude = turned(reference.attitude, self.args.channel, added)
        else:
            changed = getattr(reference, part).copy()
            changed[axis] += added
            setattr(reference, part, changed)
        return added


def duration(args: Inject) -> float:
    """s from the beginning to the end of what is injected."""
    return 2.0 * args.seconds if args.kind == "doublet" else args.seconds


def check(args: Inject, level: Level) -> None:
    """Raises :class:`~zmav.errors.BadInput` naming the field, the value and what was expected, for a channel that a
    reference of ``level`` does not have, and for numbers that are none or beyond what is sane to fly.
    """
    if args.kind not in KINDS:
        raise _bad("kind", args.kind, ", ".join(KINDS))
    channels = [name for name, each in CHANNELS.items() if level in each.levels]
    if args.channel not in channels:
        raise _bad("channel", args.channel, f"one that a reference of level {level} has: {', '.join(channels)}")
    channel = CHANNELS[args.channel]
    if not (0.0 < abs(args.amplitude) <= channel.most):  # false for nan, too
        raise _bad("amplitude", args.amplitude, f"at most {channel.most:g} {channel.unit} either way, and not 0")
    if not SHORTEST <= args.seconds <= LONGEST:
        raise _bad("seconds", args.seconds, f"{SHORTEST:g} to {LONGEST:g} s")
    if args.channel in ("p", "q"):
        turn = abs(args.amplitude) * args.seconds
        if turn > MOST_TURN:
            most = f"at most {MOST_TURN:g} rad that the rates add up to; here {turn:.2f}"
            raise _bad("amplitude", args.amplitude, most)


def turned(q: Array, name: str, angle: float) -> Array:
    """``q`` (4,) with ``angle`` rad added to just its roll, pitch or yaw (Z-Y-X), whatever the other two are.

    Yaw turns about the down axis, roll about the body's nose, pitch about the level axis to the right of the heading.
    """
    cosine, sine = math.cos(angle / 2.0), math.sin(angle / 2.0)
    if name == "roll":
        turned = product(q, (cosine, sine, 0.0, 0.0))
    elif name == "yaw":
        turned = product((cosine, 0.0, 0.0, sine), q)
    else:
        yaw = heading(q)
        turned = product((cosine, -sine * math.sin(yaw), sine * math.cos(yaw), 0.0), q)
    return np.array(turned) / math.hypot(*turned)


def _bad(field: str, value: object, expected: str) -> BadInput:
    return BadInput.wrong(field, value, expected, f"inject: {field} is {value!r}")
