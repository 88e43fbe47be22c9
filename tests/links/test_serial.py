"""Serial links over pseudo-terminals: every byte value, unplugging, a device in use, the rate found by listening."""

from __future__ import annotations

import os
import tty
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import serial
from pymavlink.dialects.v20 import ardupilotmega

from zmav.links import LinkState, open_link
from zmav.links import serial as serial_link
from zmav.links.serial import CANDIDATES, NOISE, SerialLink

if TYPE_CHECKING:
    from tests.links.conftest import Watch

EVERY_BYTE = bytes(range(256))
Frames = Callable[[int], list[bytes]]


class Device:
    """A pseudo-terminal that stands for an autopilot on a cable, plugged in as a symlink of any name."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._master = -1

    def plug(self) -> None:
        self._master, slave = os.openpty()
        tty.setraw(slave)
        replacement = self.path.with_suffix(".new")
        replacement.symlink_to(os.ttyname(slave))
        replacement.rename(self.path)
        self._slave = slave  # held, as a driver holds its device, so that data sent before it is opened is not lost

    def unplug(self) -> None:
        if self._master >= 0:
            self.path.unlink(missing_ok=True)
            os.close(self._slave)
            os.close(self._master)
            self._master = -1

    def write(self, data: bytes) -> None:
        while data:
            data = data[os.write(self._master, data) :]

    def read(self, count: int) -> bytes:
        """So many bytes; blocks until they came."""
        data = b""
        while len(data) < count:
            data += os.read(self._master, count - len(data))
        return data


@pytest.fixture
def device(tmp_path: Path) -> Iterator[Device]:
    made = Device(tmp_path / "ttyUSB0")
    yield made
    made.unplug()


@pytest.fixture
def acm(tmp_path: Path) -> Iterator[Device]:
    made = Device(tmp_path / "ttyACM0")
    yield made
    made.unplug()


@pytest.fixture
def heartbeats() -> bytes:
    mav = ardupilotmega.MAVLink(None, srcSystem=1, srcComponent=1)
    return bytes(mav.heartbeat_encode(2, 3, 81, 4, 4, 3).pack(mav))


def test_both_ways_every_byte(watch: Watch, device: Device) -> None:
    device.plug()
    watched = watch(f"serial:{device.path}:57600")
    watched.expect_state(LinkState.UP, f"{device.path} at 57600 baud")
    device.write(EVERY_BYTE)
    watched.expect_data(EVERY_BYTE)
    assert watched.link.send(EVERY_BYTE) is True
    assert device.read(256) == EVERY_BYTE
    counters = watched.link.counters
    assert (counters.rx_bytes, counters.tx_bytes, counters.tx_dropped, counters.opens) == (256, 256, 0, 1)


def test_burst(watch: Watch, device: Device) -> None:
    device.plug()
    watched = watch(f"{device.path},921600")
    watched.expect_state(LinkState.UP)
    device.write(EVERY_BYTE * 400)
    watched.expect_data(EVERY_BYTE * 400)


def test_much_is_read_soon_though_it_may_lie(watch: Watch, device: Device) -> None:
    """A terminal gives 4095 bytes at once: they are taken more often where more wait."""
    device.plug()
    watched = watch(f"{device.path},921600")
    watched.expect_state(LinkState.UP)
    watched.link.patience = lambda: 2.0
    device.write(EVERY_BYTE * 1000)
    watched.expect_data(EVERY_BYTE * 1000)


def test_absent_then_plugged_in(watch: Watch, device: Device) -> None:
    watched = watch(f"{device.path},57600")
    after = watched.expect_state(LinkState.DOWN, f"no device {device.path}: is it plugged in?")
    assert watched.link.send(b"x") is False
    device.plug()
    watched.expect_state(LinkState.UP, after=after)
    device.write(b"here")
    watched.expect_data(b"here")


def test_unplugged_and_back_as_another_device(watch: Watch, device: Device) -> None:
    """The name stays and points elsewhere, as /dev/serial/by-id does."""
    device.plug()
    watched = watch(f"{device.path},57600")
    after = watched.expect_state(LinkState.UP)
    for word in (b"first", b"second"):
        target = device.path.readlink()
        device.unplug()
        after = watched.expect_state(LinkState.DOWN, after=after)
        assert watched.link.send(b"x") is False
        holder = os.openpty() if word == b"first" else ()  # takes the number that was freed
        device.plug()
        assert not holder or device.path.readlink() != target
        after = watched.expect_state(LinkState.UP, after=after)
        before = watched.data
        device.write(word)
        watched.expect_data(before + word)
        assert watched.link.send(word) is True
        assert device.read(len(word)) == word
        for descriptor in holder:
            os.close(descriptor)
    assert watched.link.counters.opens == 3


def test_held_by_another_program(watch: Watch, device: Device) -> None:
    device.plug()
    with serial.Serial(str(device.path), exclusive=True):
        watched = watch(f"{device.path},57600")
        after = watched.expect_state(LinkState.DOWN, f"{device.path} is held by another program")
    watched.expect_state(LinkState.UP, after=after)
    with pytest.raises(serial.SerialException, match=r"exclusively lock|busy"):
        serial.Serial(str(device.path), exclusive=True)


def test_not_a_serial_port(watch: Watch, tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_bytes(b"")
    watch(f"{file},57600").expect_state(LinkState.DOWN, f"{file} is not a serial port")
    watch(f"{tmp_path},57600").expect_state(LinkState.DOWN, f"{tmp_path} is not a serial port")


def test_a_device_that_takes_nothing_gets_whole_frames_or_none(watch: Watch, device: Device, frames: Frames) -> None:
    device.plug()
    watched = watch(f"{device.path},57600")
    watched.expect_state(LinkState.UP)
    accepted, refused = [], 0
    for frame in frames(256) * 100:
        if watched.link.send(frame):
            accepted.append(frame)
        else:
            refused += 1
            if refused == 20:
                break
    assert refused == 20
    assert watched.link.counters.tx_dropped == 20
    stream = b"".join(accepted)
    assert device.read(len(stream)) == stream
    assert watched.link.send(b"and on") is True
    assert device.read(6) == b"and on"


def test_rate_found_by_listening(watch: Watch, device: Device, heartbeats: bytes) -> None:
    """Silent at first: send refuses. Then MAVLink is heard: it is up, and delivers that from its beginning."""
    device.plug()
    watched = watch(str(device.path))
    after = watched.expect_state(LinkState.CONNECTING, f"{device.path}: listening for MAVLink at 115200 baud")
    assert watched.link.send(b"x") is False
    watched.expect_state(LinkState.CONNECTING, "listening for MAVLink at 57600 baud", after)
    device.write(heartbeats)
    watched.expect_data(heartbeats)
    watched.expect_state(LinkState.UP, "baud, found by listening")
    assert watched.link.send(b"hello") is True
    assert device.read(5) == b"hello"
    device.write(b"more")
    watched.expect_data(heartbeats + b"more")


def test_usb_device_that_waits_to_be_spoken_to(watch: Watch, acm: Device, heartbeats: bytes) -> None:
    """PX4's USB port says nothing until it hears MAVLink: what is sent while listening must go out."""
    acm.plug()
    watched = watch(str(acm.path))
    watched.expect_state(LinkState.CONNECTING, "listening")
    watched.until(lambda: watched.link.send(heartbeats), "device that takes a heartbeat")
    assert acm.read(len(heartbeats)) == heartbeats
    # One answer may be lost in a change of rate, as the next one would not be.
    while not watched.link.wait(LinkState.UP, 0.1):
        acm.write(heartbeats)
    watched.until(lambda: len(watched.data) > 0, "heartbeat")
    assert watched.pieces[0].startswith(heartbeats)


def test_silent_port_is_listened_to_for_ever(
    watch: Watch,
    device: Device,
    heartbeats: bytes,
) -> None:
    device.plug()
    link = open_link(str(device.path))
    assert isinstance(link, SerialLink)
    link.listen, link.candidates = 0.01, (115200, 57600)
    watched = watch(link)
    after = 0
    for words in ("at 115200 baud", "at 57600 baud", "no MAVLink heard at any of 115200, 57600 baud; still listening"):
        after = watched.expect_state(LinkState.CONNECTING, words, after)
    link.listen = 1.5
    device.write(heartbeats)
    watched.expect_state(LinkState.UP, after=after)


def test_noise_is_left_at_once_for_the_next_rate(watch: Watch, device: Device) -> None:
    device.plug()
    watched = watch(str(device.path))
    after = watched.expect_state(LinkState.CONNECTING, "at 115200 baud")
    for rate in CANDIDATES[1:4]:
        device.write(bytes(NOISE))
        after = watched.expect_state(LinkState.CONNECTING, f"at {rate} baud", after)


def test_rate_that_carries_only_noise_later_is_given_up(watch: Watch, device: Device, heartbeats: bytes) -> None:
    """Another autopilot on the same wires, at another rate: the link must not stay up with rubbish for ever."""
    device.plug()
    watched = watch(str(device.path))
    watched.expect_state(LinkState.CONNECTING, "listening")
    device.write(heartbeats)
    after = watched.expect_state(LinkState.UP)
    device.write(bytes(serial_link.WATCH - 100) + heartbeats + bytes(200))  # some MAVLink in it: no reason
    device.write(bytes(2 * serial_link.WATCH))
    after = watched.expect_state(LinkState.DOWN, "only noise at", after)
    after = watched.expect_state(LinkState.CONNECTING, "listening", after)
    device.write(heartbeats)
    watched.expect_state(LinkState.UP, after=after)
    assert watched.link.counters.opens == 2


def test_given_rate_is_never_doubted(watch: Watch, device: Device) -> None:
    device.plug()
    watched = watch(f"{device.path},57600")
    watched.expect_state(LinkState.UP)
    device.write(bytes(3 * serial_link.WATCH))
    watched.expect_data(bytes(3 * serial_link.WATCH))
    assert [state for state, _ in watched.states] == [LinkState.CONNECTING, LinkState.UP]


def test_found_rate_is_tried_first_after_a_replug(watch: Watch, device: Device, heartbeats: bytes) -> None:
    device.plug()
    watched = watch(str(device.path))
    after = watched.expect_state(LinkState.CONNECTING, f"at {CANDIDATES[1]} baud")
    device.write(heartbeats)
    after = watched.expect_state(LinkState.UP, after=after)
    found = watched.states[after - 1][1].split(" baud")[0].rpartition(" ")[2]
    device.unplug()
    after = watched.expect_state(LinkState.DOWN, after=after)
    device.plug()
    after = watched.expect_state(LinkState.CONNECTING, after=after)
    assert watched.states[after - 1][1].endswith(f"listening for MAVLink at {found} baud")
