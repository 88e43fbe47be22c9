"""Serial endpoints: a radio or a cable with one ground control station behind it."""

from __future__ import annotations

import os
import time
from pathlib import Path

import msgspec

from ground.gcs.client import Client
from ground.gcs.options import Endpoint
from ground.gcs.places import Hub, StationEndpoint
from zmav.errors import BadConfig
from zmav.links import Link, LinkState, SerialUrl, open_link, parse_url

SHARE = 0.9
"""of a line's bytes a second that is used: what is asked for in between must not wait behind a full one"""
PAUSE = 0.02
"""s until a full line is tried again"""


class SerialSink:
    """A link as a way out: while it is down, what is sent is lost, as on any radio."""

    stream = True

    def __init__(self, link: Link) -> None:
        self._link = link

    def write(self, data: bytes) -> int:
        if self._link.state is not LinkState.UP:
            return len(data)
        return len(data) if self._link.send(data) else 0

    def wait(self, seconds: float) -> None:
        time.sleep(min(seconds, PAUSE))

    def close(self) -> None:
        """The link is the endpoint's."""


class Serial(StationEndpoint):
    """``--serial``: reopened when the device was unplugged and came back. Without a ``rate`` of its own it is paced by
    the line's.
    """

    def __init__(self, endpoint: Endpoint, hub: Hub) -> None:
        super().__init__(endpoint, hub)
        url = parse_url(endpoint.text)
        if not isinstance(url, SerialUrl):
            expected = "a device, such as /dev/ttyUSB0,57600"
            raise BadConfig.wrong("serial", endpoint.text, expected, f"--serial {endpoint.text!r} is no device")
        if url.baud is None and "ttyACM" not in os.path.realpath(url.path):
            # A station is silent until it hears of a vehicle, so that there is nothing to find the rate by.
            expected = f"{url.path},57600 or whatever the radio is set to"
            text = f"--serial {endpoint.text!r}: say its baud rate: {expected}"
            raise BadConfig(text, field="baud", value=endpoint.text, expected=expected)
        self._path = url.path
        self._link = open_link(str(url if url.baud else msgspec.structs.replace(url, baud=115200)))
        options = endpoint.options
        if options.rate is None and self._link.capacity is not None:
            options = msgspec.structs.replace(options, rate=SHARE * self._link.capacity)
        self._client = Client(f"serial {endpoint.text}", SerialSink(self._link), options, hub.dialect, stays=True)

    @property
    def clients(self) -> list[Client]:
        return [self._client]

    def start(self) -> None:
        """Raises :class:`BadConfig` for a device that is not there now; one that goes later is waited for."""
        if not Path(self._path).exists():
            text = f"no device {self._path}: is it plugged in?"
            raise BadConfig(text, field="serial", value=self._path, expected="a device that is there")
        self._hub.joined(self._client)
        self._link.start(self._on_data, self._on_state)

    def close(self) -> None:
        self._client.close()
        self._link.close()

    def _on_data(self, data: bytes) -> None:
        self._take(self._client, data)

    def _on_state(self, state: LinkState, detail: str) -> None:
        if state is LinkState.DOWN:
            self._client.splitter.reset()
        if state in (LinkState.UP, LinkState.DOWN):
            self._hub.news(f"serial {self.endpoint.text}: {detail}")
