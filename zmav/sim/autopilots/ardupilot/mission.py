"""ArduPilot's mission: the list of commands, and which of them runs.

One navigation command runs at a time; "do" and "condition" commands between it and the next one run beside it, one
after another. After ArduPilot's AP_Mission library; commands:
https://ardupilot.org/copter/docs/common-mavlink-mission-command-messages-mav_cmd.html
"""

from __future__ import annotations

import enum
from collections.abc import Callable
from typing import ClassVar, Protocol

import msgspec

from zmav.sim.autopilots import items
from zmav.sim.autopilots.ardupilot.plan import NAMES, is_navigation, stored
from zmav.sim.autopilots.items import Item, ItemStore, Result

JUMP, TAKEOFF = 177, 22
LAND_START = 189
LAND = 21
FOREVER = -1  # of a jump
MOST_LOOPS = 64
CLEAR_ON_BOOT, CONTINUE_AFTER_LAND, KEEP_COUNTER = 1, 4, 8  # MIS_OPTIONS
WARNING, INFO = 4, 6


class State(enum.IntEnum):
    STOPPED = 0
    RUNNING = 1
    COMPLETE = 2


class Performer(Protocol):
    """Who flies the commands."""

    def start(self, item: Item) -> bool:
        """Begin; False for a command that cannot be begun: the next one is tried."""

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
        self, home: Callable[[], Item], param: Callable[[str], float], say: Callable[[int, str], None]
    ) -> None:
        self._home = home
        self._param = param
        self._say = say
        self.performer: Performer | None = None
        self.stored: Callable[[Item], Item | Result] = stored  # how this kind keeps an item
        self.armed: Callable[[], bool] = lambda: False
        self.sized: Callable[[int], None] = lambda count: None
        self.changes = 0  # counts up with every change of the list
        self.state = State.STOPPED
        self.nav: Item | None = None
        self.landing = False  # in the part after DO_LAND_START, or in a landing
        self._items: list[Item] = []
        self._do: Item | None = None
        self._nav_loaded = self._do_loaded = self._do_all_done = False
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
            self._resized()

    def read(self, seq: int) -> Item | Result:
        if seq == 0:
            return self._home()
        return self._items[seq] if seq < len(self._items) else Result.INVALID_SEQUENCE

    def open(self, count: int) -> Result:
        self._truncate(count)
        return Result.ACCEPTED

    def put(self, item: Item, last: int) -> Result:
        kept = self.stored(item)
        if kept is Result.UNSUPPORTED:
            self._say(WARNING, f"Mission: MAV_CMD {item.command} is not simulated")
        if isinstance(kept, Result):
            return kept
        if kept.command == JUMP:
            target = int(kept.p1)
            if target == 0 or (target >= len(self._items) and target > last):
                return Result.ERROR
        if kept.seq < len(self._items):
            if kept.seq > 0:
                self._items[kept.seq] = kept
                self.changes += 1
            return Result.ACCEPTED
        return Result.ACCEPTED if self.add(kept) else Result.ERROR

    def add(self, item: Item) -> bool:
        """Append a command; home comes first where the list is empty. False where it is full."""
        self.keep_home()
        if len(self._items) >= self.most:
            return False
        self._items.append(msgspec.structs.replace(item, seq=len(self._items)))
        self.changes += 1
        self._resized()
        return True

    def clear(self) -> bool:
        if self.armed() and self.state is State.RUNNING:
            return False
        self._truncate(0)
        self.nav = self._do = None
        self._nav_loaded = self._do_loaded = False
        self.state = State.STOPPED
        return True

    def _truncate(self, count: int) -> None:
        if len(self._items) > count:
            del self._items[count:]
            self.changes += 1
            self._resized()

    def _resized(self) -> None:
        self.sized(len(self._items))

    # ---- starting and stopping

    def power_on(self) -> None:
        """After a reset the list is there, and nothing runs."""
        self.state = State.STOPPED
        self.reset()
        if int(self._param("MIS_OPTIONS")) & CLEAR_ON_BOOT:
            self.clear()

    def start(self) -> None:
        """From the first command."""
        self.state = State.RUNNING
        self.reset()
        if not self._advance():
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
            return
        self.nav = self._items[self.nav.seq]
        if self._do_loaded and self._do is not None:
            self.set_current(self._do.seq)
        elif self._nav_loaded:
            self.set_current(self.nav.seq)

    def start_or_resume(self) -> None:
        """As MIS_RESTART says."""
        if int(self._param("MIS_RESTART")) == 1:
            self.start()
        else:
            self.resume()

    def reset(self) -> None:
        self._nav_loaded = self._do_loaded = self._do_all_done = self.landing = False
        self.nav = self._do = None
        self._jumped.clear()

    def update(self) -> None:
        """Ten times a second or more: go on where a command is done."""
        if self.state is not State.RUNNING or not self._items:
            return
        if self._nav_loaded and self.nav is not None:
            if self._verify(self.nav):
                self._nav_loaded = False
                if not self._advance():
                    self._complete()
                    return
        elif not self._advance():
            self._complete()
            return
        if not self._do_loaded:
            self._advance_do()
        elif self._do is not None and self._verify(self._do):
            self._do_loaded = False

    def set_current(self, index: int) -> bool:
        """Go to a command: at once where the mission runs, else with the next resume."""
        self.landing = 0 < index < len(self._items) and self._items[index].command == LAND_START
        if index >= len(self._items) or len(self._items) == 1:
            return False
        self._do = None
        self._do_loaded = self._do_all_done = self._nav_loaded = False
        if index == 0 or self.state is State.COMPLETE:
            self._jumped.clear()
            index = max(index, 1)
        if self.state is State.RUNNING:
            if not self._advance(index):
                self._complete()
                return False
            return True
        return self._stand_by(index)

    def _stand_by(self, index: int) -> bool:
        """The commands to resume with, none of them begun."""
        while not self._nav_loaded:
            item = self._next(index, counting=True)
            if item is None:
                self.nav = None
                return False
            if is_navigation(item):
                self.nav, self._nav_loaded = item, True
            elif not self._do_loaded:
                self._do, self._do_loaded = item, True
            index = item.seq + 1
        self._do_all_done = not self._do_loaded
        self.state = State.STOPPED
        return True

    def restart_current(self) -> bool:
        """Begin the running navigation command again: it may have been changed."""
        running = self.state is State.RUNNING and self.nav is not None and 0 < self.nav.seq < len(self._items)
        return running and self.nav is not None and self.set_current(self.nav.seq)

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

    @property
    def goes_on_after_landing(self) -> bool:
        wanted = int(self._param("MIS_OPTIONS")) & CONTINUE_AFTER_LAND
        return bool(wanted) and self.nav is not None and self.takeoff_next(self.nav.seq + 1)

    @property
    def upcoming(self) -> tuple[Item, ...]:
        """The running navigation command and the two after it, as they are in the list now."""
        found: list[Item] = []
        index = self.current
        while index > 0 and len(found) < 3:
            item = self.next_navigation(index)
            if item is None:
                break
            found.append(item)
            index = item.seq + 1
        return tuple(found)

    # ---- going on

    def _advance(self, start: int = 0) -> bool:
        """Begin the next navigation command, and the first "do" command before it; False: there is none."""
        if self.state is not State.RUNNING or self._nav_loaded:
            return False
        self._do = None
        self._do_loaded = self._do_all_done = False
        index = start or (1 if self.nav is None else self.nav.seq + 1)
        for _ in range(255):
            item = self._next(index, counting=True)
            if item is None:
                return False
            if is_navigation(item):
                self.nav = item
                if self._start(item):
                    self._nav_loaded = True
                    self._do_all_done = not self._do_loaded
                    return True
            elif not self._do_loaded:
                self._do, self._do_loaded = item, True
                self._start(item)
            index = item.seq + 1
        return False

    def _advance_do(self) -> None:
        if self.state is not State.RUNNING or self._do_all_done:
            return
        index = 1 if self._do is None else self._do.seq + 1
        item = self._next(index, counting=False)
        if item is None or is_navigation(item):
            self._do_all_done = True
            return
        self._do, self._do_loaded = item, True
        self._start(item)

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
        if counting and not int(self._param("MIS_OPTIONS")) & KEEP_COUNTER:
            self._jumped.pop(item.seq, None)
        return item.seq + 1

    def _start(self, item: Item) -> bool:
        if item.command in (LAND, LAND_START):
            self.landing = True
        elif item.command == TAKEOFF:
            self.landing = False
        name = NAMES.get(item.command, "?")
        self._say(INFO, f"Mission: {item.seq} {name}")
        return self.performer is not None and self.performer.start(item)

    def _verify(self, item: Item) -> bool:
        return self.performer is None or self.performer.verify(item)

    def _complete(self) -> None:
        self.state = State.COMPLETE
        self.landing = False
        if self.performer is not None:
            self.performer.finished()
