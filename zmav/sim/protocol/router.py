"""ArduPilot's own routing between its links: https://ardupilot.org/dev/docs/mavlink-routing-in-ardupilot.html

Anyone who was heard on a link is reached there. A message for somebody else goes to the links where that one was heard,
a message for everybody to all links but its own.
"""

from __future__ import annotations

from zmav.mavlink.codec import targets
from zmav.mavlink.dialect import Dialect
from zmav.mavlink.frames import Frame
from zmav.sim.protocol.channel import Channel

MOST_SOURCES = 64
# What is between one link's two ends.
_PRIVATE = {66, 109, 166}  # REQUEST_DATA_STREAM, RADIO_STATUS, RADIO


class Router:
    """Knows who is behind which channel of one autopilot.

    ``stands_in``: it answers for its own system's components that nobody has heard of.
    """

    def __init__(self, dialect: Dialect, *, stands_in: bool = True) -> None:
        self._dialect = dialect
        self._stands_in = stands_in
        self._heard: dict[tuple[int, int], list[Channel]] = {}

    def forget(self, channel: Channel) -> None:
        """The channel is closed."""
        for source, channels in list(self._heard.items()):
            kept = [c for c in channels if c is not channel]
            if kept:
                self._heard[source] = kept
            else:
                del self._heard[source]

    def route(self, frame: Frame, came_on: Channel, everyone: list[Channel], own: tuple[int, int]) -> bool:
        """Learn, pass on, and tell whether the vehicle itself is to act on ``frame``. ``own``: its (system,
        component).
        """
        source = (frame.sysid, frame.compid)
        if source == own:
            return False  # an echo of its own words
        self._learn(source, came_on)
        system, component = targets(frame, self._dialect)
        if system == own[0] and component in (0, own[1]):
            return True
        if frame.msgid not in _PRIVATE:
            for channel in self._reach(system, component, everyone):
                if channel is not came_on:
                    channel.forward(frame.data)
        if system == own[0]:
            return self._stands_in and (system, component) not in self._heard
        return system == 0

    def _learn(self, source: tuple[int, int], channel: Channel) -> None:
        known = self._heard.get(source)
        if known is None:
            if source[0] != 0 and len(self._heard) < MOST_SOURCES:
                self._heard[source] = [channel]
        elif channel not in known:
            known.append(channel)

    def _reach(self, system: int, component: int, everyone: list[Channel]) -> list[Channel]:
        if system == 0:
            return everyone
        found: list[Channel] = []
        for source, channels in self._heard.items():
            if source[0] == system and component in (0, source[1]):
                found += [c for c in channels if c not in found]
        return found
