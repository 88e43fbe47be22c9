"""The rest of an autopilot's MAVLink: passed on to ground stations, and theirs to it, while the port is ours."""

from __future__ import annotations

from collections.abc import Callable

from zmav.mavlink.dialect import Dialect
from zmav.mavlink.frames import Frame
from zmav.sim.protocol.channel import Channel, Outlet


class Relay:
    """What an endpoint (:mod:`zmav.sim.endpoints`) has behind it in place of a simulated autopilot: ``to_autopilot``
    takes each whole frame of a client.
    """

    def __init__(self, dialect: Dialect, to_autopilot: Callable[[bytes], None]) -> None:
        self.channels: list[Channel] = []
        self._dialect = dialect
        self._to_autopilot = to_autopilot

    def open_channel(self, outlet: Outlet, link: str = "") -> Channel:
        channel = Channel(self._dialect, outlet, 0, 0, 0.0, link)
        self.channels.append(channel)
        return channel

    def close_channel(self, channel: Channel) -> None:
        if channel in self.channels:
            self.channels.remove(channel)

    def receive(self, channel: Channel, data: bytes) -> None:
        for frame in channel.splitter.feed(data):
            self._to_autopilot(frame.data)

    def pass_on(self, frame: Frame) -> None:
        """A frame of the autopilot for everybody."""
        for channel in self.channels:
            channel.forward(frame.data)
