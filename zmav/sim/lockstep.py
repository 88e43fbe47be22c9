"""Lock step with clients: the world goes on only when those who keep up have seen what was sent so far.

Every 20 ms of simulated time the world asks each such client for its time (TIMESYNC), behind everything else on its
link, and waits for the answers. Whether somebody answers at all is tried once a second. A client that stops answering
is waited for a while and then left out, until it answers again. Faults of a link touch neither questions nor answers,
or time would wait for a frame that is late in that time; where nothing passes, or an autopilot hangs, nobody is asked.
https://mavlink.io/en/services/timesync.html
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from zmav.sim.protocol.channel import Channel
from zmav.sim.vehicle import SimVehicle

EVERY_S = 0.02  # of simulated time, between questions to who keeps up
PROBE_S = 1.0  # of simulated time, between questions to all others
PATIENCE_S = 1.0  # of wall time that an answer may take


class Lockstep:
    """Called in the world's thread alone. ``say`` takes what a person should know."""

    def __init__(
        self,
        vehicles: Sequence[SimVehicle],
        say: Callable[[str], None],
        patience_s: float = PATIENCE_S,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._vehicles = vehicles
        self._say = say
        self._patience_s = patience_s
        self._clock = clock
        self._members: set[Channel] = set()
        self._left_out: set[Channel] = set()  # those for whom that was said
        self._waiting: dict[Channel, SimVehicle] = {}
        self._question = 0  # the last one: wall time in nanoseconds, so that every answer tells how long it took
        self._next_ask = self._next_probe = 0.0
        for vehicle in vehicles:
            vehicle.node.timesync_answered = self._answered

    @property
    def members(self) -> int:
        """How many clients keep up."""
        return len(self._members)

    def ticked(self, now: float) -> None:
        """A tick is done; ``now``: simulated seconds."""
        if now < self._next_ask - 1e-9:
            return
        self._next_ask = now + EVERY_S
        probing = now >= self._next_probe
        if probing:
            self._next_probe = now + PROBE_S
            self._forget_closed()
        self._question = max(int(self._clock() * 1e9), self._question + 1)
        for vehicle in self._vehicles:
            for channel in [] if vehicle.node.hung else vehicle.node.channels:
                member = channel in self._members
                if (member or probing) and channel.ask(self._question) and member:
                    self._waiting[channel] = vehicle

    def ready(self) -> bool:
        """Whether time may go on."""
        if not self._waiting:
            return True
        for channel, vehicle in list(self._waiting.items()):
            if vehicle.node.hung or channel not in vehicle.node.channels:
                self._drop(channel)
        if self._waiting and self._clock() - self._question * 1e-9 > self._patience_s:
            for channel, vehicle in list(self._waiting.items()):
                self._drop(channel)
                if channel not in self._left_out:
                    self._left_out.add(channel)
                    self._say(
                        f"{vehicle.name}: no answer for {self._patience_s:g} s; lock step goes on without that client"
                    )
        return not self._waiting

    def _drop(self, channel: Channel) -> None:
        self._waiting.pop(channel, None)
        self._members.discard(channel)

    def _answered(self, channel: Channel, question: int) -> None:
        """A swift answer to any of our questions shows that somebody keeps up; only the last one's lets time go on."""
        took_s = self._clock() - question * 1e-9
        if question <= self._question and took_s < self._patience_s / 2:
            self._members.add(channel)
        if question == self._question:
            self._waiting.pop(channel, None)

    def _forget_closed(self) -> None:
        there = {channel for vehicle in self._vehicles for channel in vehicle.node.channels}
        self._members &= there
        self._left_out &= there
