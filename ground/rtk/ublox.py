"""A u-blox base receiver, told by UBX to survey itself in or where it is (u-blox ZED-F9P Interface Description, HPG
1.32: UBX-CFG-VALSET, UBX-NAV-SVIN, UBX-ACK). Generation 9 and newer; what is told is in its RAM alone.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any, NamedTuple

from pyubx2 import UBXMessage, UBXParseError, UBXReader, UBXStreamError, UBXTypeError

from ground.rtk.options import Fixed, Survey
from zmav.errors import Refused, TimedOut
from zmav.waiting import within

HEAD, CHECK, MOST_INSIDE = 6, 2, 1024
RAM, NO_TRANSACTION = 1, 0
DISABLED, SURVEY_IN, FIXED = 0, 1, 2
"""CFG-TMODE-MODE"""
LLH = 1
VALSET = (0x06, 0x8A)
ANSWER_S, TRIES = 2.0, 3
MESSAGES = {"1005": 1, "1074": 1, "1084": 1, "1094": 1, "1124": 1, "1230": 5}
"""what a base sends, and at each so manieth second: MSM 4 of four systems, its place, GLONASS's biases"""
EXACT_M = 0.01
"""m that a place which is told to the receiver is taken to be exact by"""


class Progress(NamedTuple):
    """A survey-in: seconds so far, m that the mean is exact by, observations, and whether it is over."""

    seconds: int
    metres: float
    observations: int
    active: bool
    valid: bool


class UbxCutter:
    """Finds UBX frames in whatever comes, each checked; it keeps less than one."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[Any]:
        data, self._rest = self._rest + data, b""
        found, at = [], 0
        while (at := data.find(b"\xb5", at)) >= 0:
            if len(data) - at < HEAD:
                self._rest = data[at:]
                break
            length = int.from_bytes(data[at + 4 : at + 6], "little")
            end = at + HEAD + length + CHECK
            if data[at + 1] != 0x62 or length > MOST_INSIDE:
                at += 1
            elif end > len(data):
                self._rest = data[at:]
                break
            else:
                message = _parsed(data[at:end])
                at = at + 1 if message is None else end
                found += [message] if message is not None else []
        return found


def _parsed(frame: bytes) -> Any:
    try:
        return UBXReader.parse(frame)
    except (UBXParseError, UBXStreamError, UBXTypeError, ValueError):
        return None


class UbloxBase:
    """One receiver. ``send`` puts bytes on its line; what comes from it is given to :meth:`feed`. On the event loop."""

    def __init__(self, send: Callable[[bytes], bool], wanted: Survey | Fixed, port: str) -> None:
        self._send, self._wanted, self._port = send, wanted, port
        self._cutter = UbxCutter()
        self._answer: asyncio.Future[bool] | None = None
        self.progress: Progress | None = None
        self.heard = 0.0
        """monotonic seconds of its last NAV-SVIN"""
        self.told = False
        """it has taken its settings"""

    @property
    def ready(self) -> bool:
        """It is where it says that it is, as far as it was told: a survey-in is over, by its own word."""
        if not self.told or not isinstance(self._wanted, Survey):
            return self.told
        return self.progress is not None and self.progress.valid and not self.progress.active

    def feed(self, data: bytes) -> None:
        for message in self._cutter.feed(data):
            if message.identity == "NAV-SVIN":
                self.heard = time.monotonic()
                self.progress = Progress(
                    seconds=message.dur,
                    metres=message.meanAcc / 1e4,
                    observations=message.obs,
                    active=bool(message.active),
                    valid=bool(message.valid),
                )
            elif message.identity in ("ACK-ACK", "ACK-NAK"):
                self._answered((message.clsID, message.msgID), message.identity == "ACK-ACK")

    def _answered(self, about: tuple[int, int], taken: bool) -> None:
        if about == VALSET and self._answer is not None and not self._answer.done():
            self._answer.set_result(taken)

    async def configure(self) -> None:
        """Raises :class:`Refused` or :class:`TimedOut`, saying what the receiver did not take."""
        self.told = False
        for what, settings in self._settings():
            await self._set(what, settings)
        self.told, self.progress = True, None  # what was said until now is of what it did before

    def _settings(self) -> list[tuple[str, list[tuple[str, int]]]]:
        rates = [(f"CFG_MSGOUT_RTCM_3X_TYPE{name}_{self._port}", every) for name, every in MESSAGES.items()]
        rates.append((f"CFG_MSGOUT_UBX_NAV_SVIN_{self._port}", int(isinstance(self._wanted, Survey))))
        if isinstance(self._wanted, Survey):
            mode = [
                ("CFG_TMODE_MODE", SURVEY_IN),
                ("CFG_TMODE_SVIN_MIN_DUR", self._wanted.seconds),
                ("CFG_TMODE_SVIN_ACC_LIMIT", round(self._wanted.metres * 1e4)),
            ]
        else:
            lat, lat_hp = _split(self._wanted.lat_deg, 1e7)
            lon, lon_hp = _split(self._wanted.lon_deg, 1e7)
            height, height_hp = _split(self._wanted.height, 1e2)
            mode = [
                ("CFG_TMODE_MODE", FIXED),
                ("CFG_TMODE_POS_TYPE", LLH),
                ("CFG_TMODE_LAT", lat),
                ("CFG_TMODE_LAT_HP", lat_hp),
                ("CFG_TMODE_LON", lon),
                ("CFG_TMODE_LON_HP", lon_hp),
                ("CFG_TMODE_HEIGHT", height),
                ("CFG_TMODE_HEIGHT_HP", height_hp),
                ("CFG_TMODE_FIXED_POS_ACC", round(EXACT_M * 1e4)),
            ]
        # A survey-in begins again only where the mode was another.
        return [
            ("to send RTCM 3", [(f"CFG_{self._port}OUTPROT_RTCM3X", 1), *rates]),
            ("to stop what it did before", [("CFG_TMODE_MODE", DISABLED)]),
            ("to be a base", mode),
        ]

    async def _set(self, what: str, settings: list[tuple[str, int]]) -> None:
        frame = UBXMessage.config_set(RAM, NO_TRANSACTION, settings).serialize()
        for _ in range(TRIES):
            self._answer = asyncio.get_running_loop().create_future()
            self._send(frame)
            try:
                taken = await within(ANSWER_S, _result(self._answer))
            except asyncio.TimeoutError:
                continue
            if not taken:
                text = f"the receiver refused {what}: it is older than u-blox's generation 9, or no base"
                raise Refused(text, settings=[name for name, _ in settings])
            return
        text = f"the receiver does not answer when told {what}: is it a u-blox, and is UBX allowed on this port?"
        raise TimedOut(text)


async def _result(answer: asyncio.Future[bool]) -> bool:
    return await answer


def _split(value: float, scale: float) -> tuple[int, int]:
    """A number in units of ``1 / scale``, and the rest in hundredths of that."""
    hundredths = round(value * scale * 100)
    whole = int(hundredths / 100)  # toward zero, so that the rest has its sign
    return whole, hundredths - whole * 100
