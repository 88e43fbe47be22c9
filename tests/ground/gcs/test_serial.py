"""A station behind a radio: a pseudo-terminal that comes, goes and comes back."""

from __future__ import annotations

import contextlib
import os
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

import zmav
from ground.gcs.bridge import Bridge, BridgeSettings
from ground.gcs.options import Options, parse_endpoint
from tests.ground.gcs.conftest import FLEET, Scene, command
from tests.waiting import until
from zmav.errors import BadConfig, BadInput
from zmav.mavlink import Frame, Packer, Splitter, load_dialect

ARM = 400


class Radio:
    """The far end of a line; ``path`` leads to the near one, and to another one after :meth:`replug`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._fd, self._near = -1, -1
        self.splitter = Splitter(load_dialect())
        self.replug()

    def replug(self) -> None:
        self.unplug()
        self._fd, self._near = os.openpty()
        tty.setraw(self._near)
        os.set_blocking(self._fd, False)
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(self._near))

    def unplug(self) -> None:
        for fd in (self._fd, self._near):
            if fd >= 0:
                os.close(fd)
        self._fd = self._near = -1

    def write(self, data: bytes) -> None:
        os.write(self._fd, data)

    def read(self) -> list[Frame]:
        with contextlib.suppress(BlockingIOError):
            return self.splitter.feed(os.read(self._fd, 65536))
        return []


@pytest.fixture
def radio(tmp_path: Path) -> Iterator[Radio]:
    radio = Radio(tmp_path / "radio")
    yield radio
    radio.unplug()


def settings(text: str) -> BridgeSettings:
    return BridgeSettings(endpoints=(parse_endpoint("serial", text, Options()),), streams=False)


async def test_a_radio_carries_both_ways_and_is_taken_up_again(scene: Scene, radio: Radio) -> None:
    one = scene.craft("quad1", 1)
    station = Packer(load_dialect(), 255, 190)
    async with zmav.open(connect=[scene.router_endpoint], fleet=FLEET) as z:
        await scene.known(z)
        async with Bridge(z, settings(f"{radio.path},57600"), scene.said.append) as bridge:
            (client,) = bridge.clients
            assert client.options.rate == pytest.approx(0.9 * 5760)

            async def carries() -> None:
                got: list[Frame] = []

                def comes() -> bool:
                    one.says("ATTITUDE")
                    got.extend(radio.read())
                    return any(frame.msgid == 30 for frame in got)

                await until(comes, "telemetry over the radio")

            await carries()
            sent = station.pack("COMMAND_LONG", **command(one, ARM))
            radio.write(sent)
            assert await one.hears(lambda key, data: "COMMAND_LONG" in key, "the command") == sent
            before = len(scene.said)
            radio.unplug()
            await until(lambda: any(f"{radio.path},57600: " in line for line in scene.said[before:]), "it is said")
            radio.replug()
            await carries()
            radio.write(station.pack("COMMAND_LONG", **command(one, ARM, param1=1.0)))
            await until(lambda: sum("COMMAND_LONG" in key for key, _ in one.told) == 2, "the second command")


async def test_a_device_that_is_not_there_is_said_at_once(scene: Scene, tmp_path: Path) -> None:
    async with zmav.open(connect=[scene.router_endpoint]) as z:
        with pytest.raises(BadConfig, match="is it plugged in"):
            async with Bridge(z, settings(f"{tmp_path}/none,57600")):
                pass
        with pytest.raises(BadConfig, match="say its baud rate"):
            async with Bridge(z, settings(str(tmp_path / "none"))):
                pass
        with pytest.raises(BadInput, match="baud"):
            async with Bridge(z, settings("/dev/ttyS0,fast")):
                pass
