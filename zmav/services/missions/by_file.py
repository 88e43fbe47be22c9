"""Downloads by the file that ArduPilot makes of each plan: a few round trips, however many items there are.

The file's items are those of the moment at which each of them is read, and nothing in it tells of an upload by another.
So the mission protocol, which denies all reading meanwhile, is asked for the number of items before and after; and
where others are told of a plan in between, the items are asked for one by one. Item 0, home, may be torn: the main loop
moves it while the file server reads it, without a lock. It is shown, and compared with nothing. Uploads
stay with that protocol: a file that is written clears the plan before any item of it is looked at, the answer to its
closing does not tell whether it was taken, and of a mission that is being flown the rest of the old one would stay.
Which plans can be read so is the autopilot's rule (``MissionRules.files``).
"""

from __future__ import annotations

import contextlib
import functools
import logging
from collections.abc import Callable

from zmav.errors import BadMessage, Refused, Stale, TimedOut
from zmav.mavlink import Dialect, Frame, decode
from zmav.mavlink.ftp import Nak
from zmav.mavlink.plan_file import PATH, count_of, size_of, unpack_items
from zmav.mavlink.results import MissionResult
from zmav.services.files.ftp import Ftp
from zmav.services.files.sink import Gaps
from zmav.services.link.port import Port, is_ours, listening
from zmav.services.missions.items import KINDS, MOST, WORDS, Raw, raw_from
from zmav.services.missions.transfer import DOWNLOAD, Busy, Download, Step, Transfer, TransferTimes
from zmav.wire import MissionKind

logger = logging.getLogger(__name__)
OTHERS = ("MISSION_ACK", "MISSION_COUNT")
"""what tells that another client wrote a plan, or found another one"""


class PlanFile:
    """The bytes of a plan's file (a ``Sink``), which says itself how many they are."""

    def __init__(self, kind: MissionKind, dialect: Dialect, step: Step) -> None:
        self._kind, self._dialect, self._step = kind, dialect, step
        self._size, self._count = size_of(MOST, dialect), 0
        self.gaps = Gaps([(0, self._size)])
        self.data = bytearray()

    def put(self, offset: int, data: bytes) -> int:
        """As ``Sink.put``; raises :class:`BadMessage` where it does not begin as such a file does."""
        if offset >= self._size:
            return 0
        data = data[: self._size - offset]
        new = self.gaps.fill(offset, offset + len(data))
        self.data += bytes(max(offset + len(data) - len(self.data), 0))
        self.data[offset : offset + len(data)] = data
        if new and offset == 0:
            self._count = count_of(data, KINDS[self._kind])
            self.cut(size_of(self._count, self._dialect))
        if new and self._count:
            self._step(self._count * (self._size - self.gaps.total) // self._size, self._count)
        return new

    def cut(self, size: int) -> None:
        self.gaps.cut(size)
        self._size = min(self._size, size)
        del self.data[self._size :]

    def items(self) -> list[Raw]:
        """Raises :class:`BadMessage` where the file ended before it should."""
        count = count_of(self.data, KINDS[self._kind])
        found = [raw_from(fields) for fields in unpack_items(self.data, self._dialect)]
        if len(found) != count:
            text = f"the file of the {WORDS[self._kind]} holds {len(found)} items, not {count}"
            raise BadMessage(text, field="items", value=len(found), expected=str(count))
        return found


class FileTransfer(Transfer):
    """A :class:`Transfer` that downloads by the plan's file, and as that does where the file cannot be had.

    ``may``: whether files are to be asked for at this moment. ``shut`` is called where there is no such file, and never
    will be.
    """

    def __init__(
        self,
        port: Port,
        source: tuple[int, int],
        kind: MissionKind,
        times: TransferTimes,
        window: int,
        ftp: Ftp,
        may: Callable[[], bool],
        shut: Callable[[], object],
    ) -> None:
        super().__init__(port, source, kind, times, window)
        self._ftp, self._may, self._shut = ftp, may, shut
        self._given_up = False
        """there is no such file, or none of a plan, or nobody answers: this transfer asks for it no second time"""

    async def download(self, step: Step) -> Download:
        for _ in range(2):
            before, after = await self._patiently(DOWNLOAD, self._count), None
            told: list[int | None] = []  # what was told before that count is no news
            with listening(self._port, self._source, OTHERS, functools.partial(self._note_other, told)):
                items = await self._read(step)
                if items is not None:
                    with contextlib.suppress(Busy):  # it is read again when whoever writes it is through
                        after = await self._run(DOWNLOAD, self._count())
            if items is None or any(count != before[0] for count in told):
                break
            if after == before and before[0] == len(items):
                return Download(items, before[1])
        return await super().download(step)

    def _note_other(self, told: list[int | None], frame: Frame) -> None:
        """In the link's thread: how many items another client was told of, and None where its upload was accepted."""
        fields = decode(frame, self._port.dialect)
        if fields["mission_type"] != KINDS[self._kind] or is_ours(fields, self._port):
            return
        if fields.get("type", MissionResult.ACCEPTED) == MissionResult.ACCEPTED:
            told.append(fields.get("count"))

    async def _read(self, step: Step) -> list[Raw] | None:
        """The items of the file, home included; None: not now, or never."""
        if self._given_up or not self._may() or not self._ftp.idle:
            return None  # a file or a log may be minutes on its way
        path = PATH.format(self._kind)
        file = PlanFile(self._kind, self._port.dialect, step)
        try:
            await self._ftp.fetch(path, lambda size: file, lambda news: None, busy=(), give_up=self._times.file)
            return file.items()
        except (BadMessage, Refused, Stale, TimedOut) as e:
            logger.debug("%s: the %s by the mission protocol: %s", self._port.name, WORDS[self._kind], e.message)
            missing = e.detail.get("nak") == Nak.FILE_NOT_FOUND.name and "path" in e.detail  # to read it names none
            if missing:  # anything else may pass
                self._shut()
            self._given_up |= missing or isinstance(e, TimedOut) or e.detail.get("field") == "header"
            return None
