"""A vehicle that a real flight controller flies, on its own hardware, over a serial line (HIL).

PX4 with SYS_HITL 1 takes HIL_SENSOR and HIL_GPS from the line and answers with HIL_ACTUATOR_CONTROLS. There is no lock
step: everything goes in real time, readings evenly spaced. The line carries the controller's other MAVLink too, which
is passed on to ground stations.
Source: docs.px4.io, "Hardware in the Loop Simulation (HITL)"; mavlink.io, MAV_MODE_FLAG_HIL_ENABLED.
"""

from __future__ import annotations

import errno
import os
import selectors
import termios
import threading
import time
from collections.abc import Callable, Sequence

import msgspec

from zmav.errors import BadMessage, BadUrl
from zmav.hil.plant import Plant
from zmav.hil.stream import BEAT_EVERY_S, FAULTS, SENSOR_HZ, HilStream
from zmav.hil.vehicle import External
from zmav.mavlink.codec import decode
from zmav.mavlink.dialect import Dialect
from zmav.mavlink.frames import Frame, Splitter
from zmav.sim.endpoints import Address, Endpoint, Wiring, open_endpoint
from zmav.sim.endpoints.base import BACKLOG_BYTES, ByteLine
from zmav.sim.protocol.channel import Channel, Outlet
from zmav.sim.status import HilLoop, VehicleStatus

MOST_LATE = 5  # beats that are made up for after a delay


READING_BYTES = 76  # a HIL_SENSOR frame
SHARE = 0.6  # of the line for readings; the rest is for everything else
SLOWEST_HZ = 20.0
STALE_BYTES = 2048  # waiting on the line: readings that would come after them are too old to send
LEAD_S = 0.0101  # that readings may be ahead of the world's last tick
REOPEN_S = 1.0
ASKED_ENOUGH = 5  # times for the HIL mode, before a person is told
HIL, ARMED = 32, 128  # MAV_MODE_FLAG
SET_MESSAGE_INTERVAL = 511
GCS, AUTOPILOT_NONE = 6, 8
USUAL_BAUD = 921600
_EXPECTED = "PATH[:BAUD] of a serial device, such as /dev/ttyACM0 or /dev/ttyUSB0:921600"


def parse_device(text: str) -> tuple[str, int]:
    """``PATH[:BAUD]``; :class:`BadUrl` says what is wrong."""
    path, colon, rate = text.rpartition(":")
    if not colon:
        path, rate = text, str(USUAL_BAUD)
    if not path or not rate.isdigit() or not hasattr(termios, f"B{rate}") or rate == "0":
        raise BadUrl.wrong("hil", text, _EXPECTED, f"no serial device {text!r}")
    return path, int(rate)


def is_usb(path: str) -> bool:
    """A USB device whose line speed means nothing."""
    return "ttyACM" in os.path.realpath(path)


def open_device(path: str, baud: int) -> int:
    """An open descriptor, raw, 8N1. Raises :class:`OSError` while it cannot be opened, and :class:`BadUrl` where it is
    no serial device.
    """
    descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        settings = termios.tcgetattr(descriptor)
        settings[0] = settings[1] = settings[3] = 0
        settings[2] = termios.CS8 | termios.CREAD | termios.CLOCAL
        settings[4] = settings[5] = getattr(termios, f"B{baud}")
        settings[6][termios.VMIN], settings[6][termios.VTIME] = 1, 0
        termios.tcsetattr(descriptor, termios.TCSANOW, settings)
        termios.tcflush(descriptor, termios.TCIOFLUSH)
    except termios.error as e:
        os.close(descriptor)
        if e.args[0] != errno.ENOTTY:  # it was unplugged just now
            raise OSError(*e.args) from None
        raise BadUrl(f"{path} is no serial device", field="hil", value=path, expected=_EXPECTED) from None
    return descriptor


def fitting_hz(path: str, baud: int) -> float:
    """Readings a second that the line has room for: a byte takes ten bits."""
    return SENSOR_HZ if is_usb(path) else max(min(SENSOR_HZ, SHARE * baud / 10 / READING_BYTES), SLOWEST_HZ)


class HardwareVehicle(External):
    """Serves the flight controller at ``device`` (``PATH[:BAUD]``), and passes its MAVLink on at ``addresses``.

    The device may be absent, and may go and come back: it is looked for every second. A controller that does not say it
    is in HIL is asked to be, unless it is armed; it gets no reading before.
    """

    autopilot = "px4"
    feels = FAULTS

    def __init__(
        self,
        name: str,
        sysid: int,
        plant: Plant,
        say: Callable[[str], None],
        dialect: Dialect,
        epoch_us: int,
        device: str,
        addresses: Sequence[Address],
    ) -> None:
        super().__init__(name, sysid, plant, say)
        self.path, self.baud = parse_device(device)
        rate = fitting_hz(self.path, self.baud)
        self.stream = HilStream(plant, dialect, sysid, epoch_us, rate)
        self.channels: list[Channel] = []
        self.bad = self.dropped = self.readings = self.controls = 0
        self._controlled: float | None = None  # wall time of the last controls
        self._longest_s = 0.0
        self.in_hil = False
        self._dialect = dialect
        self._addresses = addresses
        self._splitter = Splitter(dialect)
        self._endpoints: list[Endpoint] = []
        self._selector: selectors.BaseSelector | None = None
        self._metronome: Metronome | None = None
        self._line: ByteLine | None = None
        self._next_try = self._next_beat = 0.0  # wall time
        self._in_its_place = ""
        """what is said to be wrong with what stands where the device was"""
        self._asked = 0
        self._heartbeat = dialect.message("HEARTBEAT").id

    def open(self, wiring: Wiring) -> None:
        self._selector = wiring.selector
        for address in self._addresses:
            self._endpoints.append(open_endpoint(address, self, wiring))
        self._try()
        if self._line is None:
            self.say(f"{self.name}: waiting for {self.path}")
        self._metronome = Metronome(self.stream.sensor_hz, wiring.selector, self._beat)

    def close(self) -> None:
        if self._metronome is not None:
            self._metronome.close()
            self._metronome = None
        if self._line is not None:
            self._line.close()
            self._line = None
        for endpoint in self._endpoints:
            endpoint.close()
        self._endpoints.clear()

    @property
    def url(self) -> str:
        return self._endpoints[0].url if self._endpoints else f"serial:{self.path}:{self.baud}"

    @property
    def armed(self) -> bool:
        return self.connected and self.stream.armed

    # ---- what stands behind the endpoints in place of a simulated autopilot

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

    # ---- the line

    def _try(self) -> None:
        """Open the device, if it is there."""
        assert self._selector is not None
        self._next_try = time.monotonic() + REOPEN_S
        try:
            descriptor = open_device(self.path, self.baud)
        except OSError:
            return
        self._line = ByteLine(descriptor, self._selector, self._hear, self._leave)
        self._splitter = Splitter(self._dialect)
        self.say(f"{self.name}: {self.path} is open, {self.stream.sensor_hz:.0f} readings a second")

    def _leave(self, why: str) -> None:
        self._line = None
        self.connected = self.in_hil = False
        self._asked = 0
        self.plant.drive([0.0] * len(self.plant.values))
        self._in_its_place = ""
        self.say(f"{self.name}: {self.path} has gone ({why}); waiting for it")

    def _to_autopilot(self, frame: bytes) -> None:
        if self._line is not None and self._line.room() > len(frame):
            self._line.put(frame)
            self._line.flush()

    def _hear(self, data: bytes) -> None:
        for frame in self._splitter.feed(data):
            if frame.verified and frame.msgid == self._heartbeat:
                self._beats(frame)
            if not self.stream.is_hil(frame):
                for channel in self.channels:
                    channel.forward(frame.data)
            elif frame.verified and self.in_hil:
                try:
                    self.stream.take(frame)
                except BadMessage:
                    self.bad += 1
                else:
                    self._count()
                self.heard()

    def _count(self) -> None:
        now = time.monotonic()
        if self._controlled is not None:
            self._longest_s = max(self._longest_s, now - self._controlled)
        self.controls, self._controlled = self.controls + 1, now

    def _beats(self, frame: Frame) -> None:
        """A heartbeat: whose, and in HIL or not."""
        fields = decode(frame, self._dialect)
        if fields["type"] == GCS or fields["autopilot"] == AUTOPILOT_NONE:
            return
        self.sysid = self.stream.packer.sysid = frame.sysid
        if fields["base_mode"] & HIL:
            if not self.in_hil:
                self._begin(frame)
            return
        if self.in_hil:
            self.in_hil = self.connected = False
            self.say(f"{self.name}: the flight controller has left HIL")
        self._ask(frame, fields["base_mode"], fields["custom_mode"])

    def _begin(self, frame: Frame) -> None:
        """It takes readings now: the vehicle stands at its start. It is asked for controls as often as there are
        readings; by itself it sends 200 a second.
        """
        self.in_hil, self._asked = True, 0
        self._controlled, self._longest_s = None, 0.0
        self._to_autopilot(
            self.stream.packer.pack(
                "COMMAND_LONG",
                target_system=frame.sysid,
                target_component=frame.compid,
                command=SET_MESSAGE_INTERVAL,
                param1=float(self._dialect.message("HIL_ACTUATOR_CONTROLS").id),
                param2=1e6 / self.stream.sensor_hz,
            )
        )
        self.plant.reset()
        self.stream.restart()
        self.heard()
        self.restarted()
        self.say(f"{self.name}: system {self.sysid} flies in HIL")

    def _ask(self, frame: Frame, base_mode: int, custom_mode: int) -> None:
        """Ask for HIL, as ground stations do."""
        if base_mode & ARMED:
            if self._asked == 0:
                self.say(f"{self.name}: system {frame.sysid} is armed outside HIL: it is left alone. Disarm it first")
            self._asked = 1
            return
        self._asked += 1
        if self._asked == ASKED_ENOUGH:
            self.say(f"{self.name}: system {frame.sysid} does not go to HIL; set SYS_HITL to 1 and reboot it")
        pack = self.stream.packer.pack
        self._to_autopilot(
            pack("SET_MODE", target_system=frame.sysid, base_mode=base_mode | HIL, custom_mode=custom_mode)
        )

    # ---- time

    @property
    def waits(self) -> bool:
        return True  # for the metronome, which the world need not mind

    def behind(self) -> bool:
        return False

    def proceed(self) -> None:
        """Readings go by the metronome's beats, not by the world's ticks."""

    def grant(self, now: float) -> None:
        super().grant(now)
        if now - self._offset - self.plant.time_s > 5 * LEAD_S:
            self.restarted()  # the world was faster than real time: what was missed is missed
        if self._line is None:
            if time.monotonic() >= self._next_try:
                try:
                    self._try()
                except BadUrl as e:  # one may yet come
                    if self._in_its_place != e.message:
                        self.say(f"{self.name}: {e.message}: remove what stands there, so that the device can come")
                    self._in_its_place = e.message
        elif not self.in_hil and time.monotonic() >= self._next_beat:
            # PX4 says nothing on its USB port before it has heard a HEARTBEAT there.
            self._next_beat = time.monotonic() + BEAT_EVERY_S
            self._to_autopilot(self.stream.heartbeat())

    def _beat(self) -> None:
        line = self._line
        if line is None or not self.in_hil or not self.granted(self.stream.interval_s - LEAD_S):
            return
        frames = self.stream.step()
        if BACKLOG_BYTES - line.room() > STALE_BYTES:
            self.dropped += 1
            return
        self.readings += 1
        line.put(frames)
        line.flush()

    def flush(self) -> None:
        if self._line is not None:
            self._line.flush()

    @property
    def links(self) -> int:
        return len(self.channels)

    def status(self) -> VehicleStatus:
        loop = HilLoop(self.readings, self.controls, self.dropped, self.bad, self._longest_s)
        return msgspec.structs.replace(super().status(), loop=loop)


class Metronome:
    """Calls ``beat`` in the selector's thread, ``hz`` times a second of wall time, while it is open: steadier than the
    loop's own ticks. Late beats come together, but never more than :data:`MOST_LATE`.
    """

    def __init__(self, hz: float, selector: selectors.BaseSelector, beat: Callable[[], None]) -> None:
        self._period = 1.0 / hz
        self._selector = selector
        self._beat = beat
        self._over = threading.Event()
        self._ear, self._bell = os.pipe()
        os.set_blocking(self._ear, False)
        os.set_blocking(self._bell, False)
        selector.register(self._ear, selectors.EVENT_READ, self._hear)
        self._thread = threading.Thread(target=self._run, name="zmav-sim-beat", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        due = time.monotonic()
        while True:
            due += self._period
            late = time.monotonic() - due
            if late > MOST_LATE * self._period:
                due += late
            if self._over.wait(max(due - time.monotonic(), 0.0)):
                return
            try:
                os.write(self._bell, b"\0")
            except BlockingIOError:
                continue  # nobody has listened for thousands of beats

    def _hear(self) -> None:
        try:
            beats = len(os.read(self._ear, 4096))
        except BlockingIOError:
            return
        for _ in range(min(beats, MOST_LATE)):
            self._beat()

    def close(self) -> None:
        self._over.set()
        self._thread.join()
        self._selector.unregister(self._ear)
        os.close(self._ear)
        os.close(self._bell)
