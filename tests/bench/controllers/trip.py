"""(b) The round trip: from the pilot's stick at the autopilot's link to its effect on the controller's output, in the
key space and all the way back at the link. The paper has 1235 µs on the mean from a pilot's command to its effect.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import socket
import time
from collections.abc import AsyncIterator
from typing import Any

import msgspec

from tests.bench.controllers import echo
from tests.bench.controllers.fake import CYCLE, MID, FakeAutopilot, Stick, stick_of
from tests.bench.controllers.processes import (
    FLEET,
    VEHICLE,
    Rig,
    fleet_file,
    frames_key,
    last_words,
    rig,
    signals_key,
    signals_of,
)
from tests.bench.controllers.spread import Spread, effects, spread
from zmav import keys, wire
from zmav.mavlink import decode, parse_frame
from zmav.process import free_port

AGENT = "echo"
FULL_DPS = 220.0
"""deg/s of the full stick"""
FULL = math.radians(FULL_DPS)
PAPER_MEAN = 1235.0
"""µs"""
SETTLE = 1.0
"""s for interpreters, caches and the rates of messages"""


class Trip(msgspec.Struct):
    """µs; each from the moment at which RC_CHANNELS with another stick went out at the autopilot's end of the link."""

    back: Spread
    """to the frame of the output at that link; the attitude that begins a cycle followed the stick at once"""
    output: Spread
    """to the output in the key space, as a subscriber hears it"""
    radio: Spread
    """to the stick in the key space, as a subscriber hears it"""
    controller: Spread
    """to the beginning of the controller's own cycle, in its process"""
    inside: Spread
    """from the attitude at the supervisor to its put of the output: the controller's process and the way there and
    back"""
    anytime: Spread
    """as ``back``, where the stick moves at any moment of a cycle"""
    period: float = CYCLE * 1e6

    @property
    def waiting(self) -> float:
        """What waiting for the next cycle adds on the mean; nothing to a whole cycle, half of one is expected."""
        return self.anytime.mean - self.back.mean


class Taps:
    """Subscribers of ours, which note when a stick passes in the key space."""

    def __init__(self, run: Rig) -> None:
        self._dialect = run.z.dialect
        self.radio: list[Stick] = []
        self.controller: list[Stick] = []
        self.inside: list[float] = []
        self.output: list[Stick] = []
        self.listened = {
            keys.SETPOINT.key(FLEET, VEHICLE, agent=AGENT): self._on_setpoint,
            signals_key(AGENT): self._on_signals,
            frames_key("RC_CHANNELS"): self._on_radio,
        }

    def _on_setpoint(self, sample: Any) -> None:
        now = time.monotonic()
        point = wire.decode(sample.payload.to_bytes(), wire.Setpoint, "setpoint")
        if point.rates is not None:
            self.output.append(Stick(now, stick_of(point.rates[0], FULL)))

    def _on_signals(self, sample: Any) -> None:
        values = signals_of(sample).values
        if "begun" in values:
            self.controller.append(Stick(values["begun"], round(MID + 500.0 * values["roll"])))
            self.inside.append(values["took_us"] * 1e-6)

    def _on_radio(self, sample: Any) -> None:
        now = time.monotonic()
        frame = parse_frame(sample.payload.to_bytes(), self._dialect)
        self.radio.append(Stick(now, int(decode(frame, self._dialect)["chan1_raw"])))


@contextlib.asynccontextmanager
async def echoing() -> AsyncIterator[tuple[Rig, FakeAutopilot]]:
    """A supervisor that runs :class:`~tests.bench.controllers.echo.Echo` for an autopilot that is only a link."""
    with last_words() as processes:
        port = free_port(socket.SOCK_DGRAM)
        file = fleet_file(processes, f"udpin:127.0.0.1:{port}")
        with FakeAutopilot(port, FULL) as fake:
            async with rig(processes, file) as run:
                run.run_controller(echo.__file__, AGENT)
                await run.ready(AGENT)
                await run.vehicle.tell(AGENT, "set", name="stick_rate_dps", value=FULL_DPS)
                yield run, fake


async def engage(run: Rig) -> None:
    """Have the controller fly by the sticks."""
    await run.engage(AGENT)
    await run.vehicle.tell(AGENT, "sticks", level="rates")


async def measure(run: Rig, fake: FakeAutopilot, seconds: float) -> Trip:
    """``seconds``: of each of its three parts."""
    await run.be_patient(AGENT)
    await engage(run)
    await asyncio.sleep(SETTLE)
    fake.at_once = True
    back = await _watch(fake, seconds)
    fake.at_once = False
    anytime = await _watch(fake, seconds)
    fake.at_once = True
    await run.vehicle.tell(AGENT, "set", name="signals_hz", value=500)
    taps = Taps(run)
    with run.listening(taps.listened):
        await asyncio.sleep(SETTLE)
        begun = time.monotonic()
        await asyncio.sleep(seconds)
    sent = [each for each in fake.sent if each.at > begun]
    radio, controller, output = (spread(effects(sent, seen)) for seen in (taps.radio, taps.controller, taps.output))
    inside = spread(taps.inside)
    return Trip(back=back, output=output, radio=radio, controller=controller, inside=inside, anytime=anytime)


async def _watch(fake: FakeAutopilot, seconds: float) -> Spread:
    fake.sent.clear()
    fake.came.clear()
    await asyncio.sleep(seconds)
    return spread(effects(list(fake.sent), list(fake.came)))
