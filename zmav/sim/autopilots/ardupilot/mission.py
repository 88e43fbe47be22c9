"""ArduPilot's mission: the list of commands, and which of them runs.

One navigation command runs at a time; "do" and "condition" commands between it and the next one run beside it, one
after another. After ArduPilot's AP_Mission library; commands:
https://ardupilot.org/copter/docs/common-mavlink-mission-command-messages-mav_cmd.html
"""

from __future__ import annotations

import enum
from collections import deque
from collections.abc import Callable
from typing import ClassVar, Protocol

import msgspec

from zmav.mavlink.results import MissionResult
from zmav.sim.autopilots import items
from zmav.sim.autopilots.ardupilot.plan import KINDS, is_navigation, stored
from zmav.sim.autopilots.items import Item, ItemStore

JUMP, TAKEOFF = 177, 22
FOREVER = -1  # of a jump
MOST_LOOPS = 64
WARNING, INFO = 4, 6


class State(enum.IntEnum):
    STOPPED = 0
    RUNNING = 1
    COMPLETE = 2


class Performer(Protocol):
    """Who flies the commands."""

    def start(self, item: Item) -> None:
        """Begin."""

    def verify(self, item: Item) -> bool:
        """Whether it is done."""

    def finished(self) -> None:
        """There is nothing more to do."""


class Mission(ItemStore):
    """Item 0 is home, whatever was uploaded; the commands are items 1 and on."""

    kind: ClassVar[int] = items.MISSION
    title: ClassVar[str] = "Mission"
    most: ClassVar[int] = 650

    def __init__(
        self,
        performer: Performer,
        home: Callable[[], Item],
        param: Callable[[str], float],
        say: Callable[[int, str], None],
        sized: Callable[[int], None],
        armed: Callable[[], bool],
    ) -> None:
        self._performer, self._home, self._param = performer, home, param
        self._say, self._sized, self._armed = say, sized, armed
        self.state = State.STOPPED
        self.nav: Item | None = None
        self._items: list[Item] = []
        self._dos: deque[Item] = deque()  # between the navigation command and the one before it; the first has begun
        self._loaded = False  # the navigation command has begun
        self._jumped: dict[int, int] = {}

    # ---- the list

    def __len__(self) -> int:
        return len(self._items)

    @property
    def present(self) -> bool:
        """There is more than home."""
        return len(self._items) > 1

    @property
    def current(self) -> int:
        """Number of the navigation command that runs or is to be resumed; 0: none."""
        return 0 if self.nav is None else self.nav.seq

    def keep_home(self) -> None:
        """Home is set: the list has at least that."""
        if not self._items:
            self._items.append(self._home())
            self._sized(len(self._items))

    def read(self, seq: int) -> Item | MissionResult:
        if seq == 0:
            return self._home()
        return self._items[seq] if seq < len(self._items) else MissionResult.INVALID_SEQUENCE

    def open(self, count: int) -> MissionResult:
        self._truncate(count)
        return MissionResult.ACCEPTED

    def put(self, item: Item, last: int) -> MissionResult:
        kept = stored(item)
        if kept is MissionResult.UNSUPPORTED:
            self._say(WARNING, f"Mission: MAV_CMD {item.command} is not simulated")
        if isinstance(kept, MissionResult):
            return kept
        if kept.command == JUMP:
            target = int(kept.p1)
            if target == 0 or (target >= len(self._items) and target > last):
                return MissionResult.ERROR
        if kept.seq < len(self._items):
            if kept.seq > 0:
                self._items[kept.seq] = kept
            return MissionResult.ACCEPTED
        return MissionResult.ACCEPTED if self.add(kept) else MissionResult.ERROR

    def add(self, item: Item) -> bool:
        """Append a command; home comes first where the list is empty. False where it is full."""
        self.keep_home()
        if len(self._items) >= self.most:
            return False
        self._items.append(msgspec.structs.replace(item, seq=len(self._items)))
        self._sized(len(self._items))
        return True

    def clear(self) -> bool:
        if self._armed() and self.state is State.RUNNING:
            return False
        self._truncate(0)
        self.reset()
        self.state = State.STOPPED
        return True

    def _truncate(self, count: int) -> None:
        if len(self._items) > count:
            del self._items[count:]
            self._sized(len(self._items))

    # ---- starting and stopping

    def power_on(self) -> None:
        """After a reset the list is there, and nothing runs."""
        self.state = State.STOPPED
        self.reset()

    def start(self) -> None:
        """From the first command."""
        self.state = State.RUNNING
        self.reset()
        if not self._advance(1):
            self._complete()

    def stop(self) -> None:
        self.state = State.STOPPED

    def resume(self) -> None:
        """From where it was stopped; what ran is begun again."""
        if self.state is State.COMPLETE:
            self.start()
            return
        self.state = State.RUNNING
        if self.nav is None or self.nav.seq >= len(self._items):
            self.start()
        else:
            self.set_current(self._dos[0].seq if self._dos else self.nav.seq)

    def start_or_resume(self) -> None:
        """As MIS_RESTART says."""
        if int(self._param("MIS_RESTART")) == 1:
            self.start()
        else:
            self.resume()

    def reset(self) -> None:
        self.nav, self._loaded = None, False
        self._dos.clear()
        self._jumped.clear()

    def update(self) -> None:
        """Ten times a second or more: go on where a command is done."""
        if self.state is not State.RUNNING or not self._items:
            return
        if self._loaded and self.nav is not None:
            self._loaded = not self._performer.verify(self.nav)
        if not self._loaded and not self._advance(1 if self.nav is None else self.nav.seq + 1):
            self._complete()
        elif self._dos and self._performer.verify(self._dos[0]):
            self._dos.popleft()
            if self._dos:
                self._start(self._dos[0])

    def set_current(self, index: int) -> bool:
        """Go to a command: at once where the mission runs, else with the next resume."""
        if index >= len(self._items) or len(self._items) == 1:
            return False
        if index == 0 or self.state is State.COMPLETE:
            self._jumped.clear()
            index = max(index, 1)
        self._loaded = False
        if self.state is not State.RUNNING:
            self.state = State.STOPPED
            self.nav = self._look_for(index)
            return self.nav is not None
        if not self._advance(index):
            self._complete()
            return False
        return True

    # ---- looking ahead

    def next_navigation(self, index: int) -> Item | None:
        """The navigation command at or after ``index``; jumps are followed and not counted."""
        while index < len(self._items):
            item = self._next(index, counting=False)
            if item is None or is_navigation(item):
                return item
            index = item.seq + 1
        return None

    def takeoff_next(self, index: int) -> bool:
        """Whether a takeoff is the next thing to fly at or after ``index``."""
        item = self.next_navigation(index)
        return item is not None and item.command == TAKEOFF

    def starts_with_takeoff(self) -> bool:
        restart = int(self._param("MIS_RESTART")) == 1
        return self.takeoff_next(1 if restart or self.nav is None else self.nav.seq)

    # ---- going on

    def _look_for(self, index: int) -> Item | None:
        """The navigation command at or after ``index``; notes those beside it."""
        self._dos.clear()
        for _ in range(255):
            item = self._next(index, counting=True)
            if item is None or is_navigation(item):
                return item
            self._dos.append(item)
            index = item.seq + 1
        return None

    def _advance(self, index: int) -> bool:
        """Begin the navigation command at or after ``index``, and the first of those beside it; False: none."""
        found = self._look_for(index)
        if self._dos:
            self._start(self._dos[0])
        if found is not None:
            self.nav, self._loaded = found, True
            self._start(found)
        return found is not None

    def _next(self, index: int, *, counting: bool) -> Item | None:
        """The command at or after ``index`` that is no jump; ``counting``: jumps are taken, not just looked at."""
        first_jump: int | None = None
        for _ in range(MOST_LOOPS + len(self._items)):
            if index >= len(self._items):
                return None
            item = self._items[index]
            if item.command != JUMP:
                return item
            target = int(item.p1)
            if not 0 < target < len(self._items) or (not counting and first_jump == index):
                return None
            first_jump = index if first_jump is None else first_jump
            index = self._jump(item, target, counting)
        return None

    def _jump(self, item: Item, target: int, counting: bool) -> int:
        times, done = int(item.p2), self._jumped.get(item.seq, 0)
        if times == FOREVER or done < times:
            if counting:
                self._jumped[item.seq] = done + 1
                self._say(INFO, f"Mission: {item.seq} Jump {done + 1}/{'unlimited' if times == FOREVER else times}")
            return target
        if counting:
            self._jumped.pop(item.seq, None)
        return item.seq + 1

    def _start(self, item: Item) -> None:
        self._say(INFO, f"Mission: {item.seq} {KINDS[item.command].name}")
        self._performer.start(item)

    def _complete(self) -> None:
        self.state = State.COMPLETE
        self._performer.finished()
