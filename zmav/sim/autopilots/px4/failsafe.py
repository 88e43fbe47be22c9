"""What PX4 does when something fails: links, position, battery, fence. The worst of what is asked for is done.

https://docs.px4.io/v1.16/en/config/safety.html and .../en/config/safety_simulation.html: an action that would take the
vehicle from its pilot waits COM_FAIL_ACT_T in HOLD first; who changes the mode while it acts takes the vehicle over;
some actions end with their cause, others only with a change of the mode. Measured: the stream lost without a radio
shows POSCTL with system status 5 (critical), sinks at MPC_LAND_SPEED and disarms.
"""

from __future__ import annotations

import enum
import math
import struct
from abc import ABC
from collections.abc import Iterator

import msgspec

from zmav.sim.autopilots.px4 import events, modes
from zmav.sim.autopilots.px4.battery import Battery, Warning
from zmav.sim.autopilots.px4.ekf import Ekf2
from zmav.sim.autopilots.px4.items import Fence
from zmav.sim.autopilots.px4.modes import Mode
from zmav.sim.autopilots.px4.navigator import Mission
from zmav.sim.autopilots.px4.offboard import Offboard
from zmav.sim.autopilots.px4.state import Px4State
from zmav.sim.autopilots.px4.sticks import Sticks

DISABLED_STICKS = 4  # COM_RC_IN_MODE
_RETURNS = (1, 3)  # COM_LOW_BAT_ACT


class Action(enum.IntEnum):
    """From the mildest to the worst, as PX4 numbers them."""

    NONE = 0
    WARN = 1
    POSCTL = 2
    ALTCTL = 3
    STABILIZED = 4
    HOLD = 5
    RTL = 6
    LAND = 7
    DESCEND = 8
    DISARM = 9
    TERMINATE = 10


class Cause(enum.IntEnum):
    GENERIC = 0
    PILOT = 1
    GROUND = 2
    BATTERY_LOW = 3
    BATTERY_CRITICAL = 4
    BATTERY_EMERGENCY = 5


class Takeover(enum.IntEnum):
    """Whether the pilot may take the vehicle back while it acts."""

    ALWAYS = 0
    BY_MODE = 1
    NEVER = 2


class Ends(enum.Enum):
    WITH_CAUSE = "with its cause"
    WITH_MODE = "with a change of the mode"
    NEVER = "never"


class Demand(msgspec.Struct, frozen=True):
    """What one failure asks for. ``waits``: the pilot is given time first."""

    key: str
    action: Action
    ends: Ends = Ends.WITH_CAUSE
    takeover: Takeover = Takeover.ALWAYS
    cause: Cause = Cause.GENERIC
    waits: bool = True


_FLYABLE = (modes.POSCTL, modes.ALTCTL, modes.STABILIZED, modes.HOLD, modes.RTL, modes.LAND, modes.DESCEND)
MODE_OF: dict[Action, Mode] = {Action[mode.name]: mode for mode in _FLYABLE}
# Where an action is not possible now, the next one that is takes its place.
_LADDER = tuple(MODE_OF)
_ESCAPABLE = (Action.HOLD, Action.RTL, Action.LAND, Action.DESCEND)
# COM_OBL_RC_ACT, NAV_RCL_ACT and NAV_DLL_ACT, GF_ACTION
OFFBOARD_LOSS = (
    Action.POSCTL,
    Action.ALTCTL,
    Action.STABILIZED,
    Action.RTL,
    Action.LAND,
    Action.HOLD,
    Action.TERMINATE,
    Action.DISARM,
)
LINK_LOSS = {1: Action.HOLD, 2: Action.RTL, 3: Action.LAND, 5: Action.TERMINATE, 6: Action.DISARM}
FENCE_BREACH = {1: Action.WARN, 2: Action.HOLD, 3: Action.RTL, 4: Action.TERMINATE, 5: Action.LAND}
_BATTERY_WARNS = {
    Cause.BATTERY_LOW: events.BATTERY_LOW,
    Cause.BATTERY_CRITICAL: events.BATTERY_CRITICAL,
    Cause.BATTERY_EMERGENCY: events.BATTERY_EMERGENCY,
}


class Px4Parts(Px4State, ABC):
    """A vehicle with the parts that its checks and failsafes look at."""

    sticks: Sticks
    offboard: Offboard
    battery: Battery
    mission: Mission
    geofence: Fence
    filter: Ekf2


class Failsafe:
    """Decides which mode flies instead of the one that was asked for. :meth:`update` is called ten times a second."""

    def __init__(self, copter: Px4Parts) -> None:
        self._copter = copter
        self._ground_heard: float | None = None
        self._ground_told = False
        self.reset()

    def reset(self) -> None:
        """Nothing acts, and the pilot is not missed yet."""
        self.action = Action.NONE
        self._demands: dict[str, Demand] = {}
        self._failing: set[str] = set()
        self._wait = 0.0
        self._taken_over = False
        self._pilot_missed = False
        self._battery_at_arming = Warning.NONE
        self._intents = self._copter.intents

    @property
    def active(self) -> bool:
        return self.action > Action.WARN

    def armed(self) -> None:
        """The pilot's sticks count only where they were there at arming, or since; so does the battery."""
        self.reset()
        self._pilot_missed = self._copter.sticks.alive
        self._battery_at_arming = self._copter.battery.warning

    # ---- the ground station

    def ground_spoke(self) -> None:
        """A heartbeat of a ground station (MAV_TYPE_GCS)."""
        if self._ground_told:
            self._ground_told = False
            self._copter.tell(events.GCS_REGAINED)
        self._ground_heard = self._copter.now

    @property
    def ground_lost(self) -> bool:
        copter = self._copter
        heard = -math.inf if self._ground_heard is None else self._ground_heard
        return copter.now - heard > float(copter.params["COM_DL_LOSS_T"])

    def watch_ground(self) -> None:
        """Say once that it is gone."""
        if self._ground_heard is not None and self.ground_lost and not self._ground_told:
            self._ground_told = True
            self._copter.tell(events.GCS_LOST)

    # ---- what can fly

    def can_run(self, mode: Mode) -> bool:
        """All that the mode needs is there; sticks are another matter."""
        copter = self._copter
        if mode is modes.OFFBOARD:
            return copter.offboard.alive
        if mode is modes.MISSION and not copter.mission.able:
            return False
        if mode is modes.RTL and not copter.has_home:
            return False
        return (copter.position_ok or not mode.position) and (copter.booted or not mode.height)

    # ---- ten times a second

    def update(self, dt: float) -> None:
        """Find the action to take now."""
        copter = self._copter
        asked, self._intents = copter.intents != self._intents, copter.intents
        if asked or self._taken_over:
            self._drop(Ends.WITH_MODE)
        self._wait = max(self._wait - dt, 0.0)
        self._collect()
        if self.action > Action.HOLD or not self.can_run(modes.HOLD) or self._taken_over:
            self._wait = 0.0
        self._select(asked)

    @property
    def mode(self) -> Mode | None:
        """The mode to fly; None: disarm at once."""
        if self.action is Action.DISARM:
            return None
        if self.action is Action.TERMINATE:
            return modes.TERMINATION
        return MODE_OF.get(self.action, self._copter.wanted)

    def _drop(self, ends: Ends) -> None:
        kept = {k: d for k, d in self._demands.items() if d.ends is not ends or k in self._failing}
        self._demands = kept

    def _collect(self) -> None:
        """Take what fails now, and let go what does not any more."""
        found = {demand.key: demand for demand in self._wanted()}
        self._failing = set(found)
        for key in [k for k, d in self._demands.items() if k not in found and d.ends is Ends.WITH_CAUSE]:
            del self._demands[key]
        patience = float(self._copter.params["COM_FAIL_ACT_T"])
        for key, demand in found.items():
            known = self._demands.get(key)
            if known is not None:
                # The action may change, the rest stays.
                self._demands[key] = msgspec.structs.replace(known, action=demand.action, cause=demand.cause)
                if demand.action is Action.WARN and known.cause is not demand.cause:
                    self._notify(demand, Action.WARN)
                continue
            if demand.waits and patience > 0.1 and demand.action is not Action.WARN and self._wait == 0.0:
                self._wait = patience
            elif demand.waits and patience <= 0.1 and demand.takeover is Takeover.ALWAYS:
                demand = msgspec.structs.replace(demand, takeover=Takeover.BY_MODE)
            self._demands[key] = demand
            if demand.action is Action.WARN:
                self._notify(demand, Action.WARN)
            if demand.action >= Action.HOLD:
                self._taken_over = False

    def _select(self, asked: bool) -> None:
        if self.action is Action.TERMINATE:
            return  # that never ends
        worst = max(self._demands.values(), key=lambda d: d.action, default=Demand("", Action.NONE))
        takeover = max((d.takeover for d in self._demands.values()), default=Takeover.ALWAYS)
        action, delayed = worst.action, Action.NONE
        waiting = self._wait > 0.0 and not self._taken_over and takeover <= Takeover.BY_MODE
        if waiting and action not in (Action.DISARM, Action.TERMINATE):
            delayed, action, takeover = action, Action.HOLD, Takeover.BY_MODE
        takes = asked and self.action == action
        if action in _ESCAPABLE and takeover < Takeover.NEVER and (self._taken_over or takes):
            action, delayed, self._taken_over = self._fallback() or Action.WARN, Action.NONE, True
        else:
            self._taken_over = False
        action = self._possible(action)
        if self._copter.wanted is modes.LAND and Action.RTL in (action, delayed) and self.can_run(modes.LAND):
            action, delayed = Action.WARN, Action.NONE
        if action > max(self.action, Action.WARN):
            self._notify(worst, action, delayed)
        self.action = action

    def _possible(self, action: Action) -> Action:
        if action not in MODE_OF:
            return action
        for each in _LADDER[_LADDER.index(action) :]:
            if self.can_run(MODE_OF[each]):
                return each
        return Action.TERMINATE

    # ---- what fails, and what that asks for

    def _wanted(self) -> Iterator[Demand]:
        copter, p, wanted = self._copter, self._copter.params, self._copter.wanted
        self._pilot_missed |= copter.sticks.alive
        missed = self._pilot_missed and int(p["COM_RC_IN_MODE"]) != DISABLED_STICKS
        if missed and not copter.sticks.alive and not _excepted(wanted, p["COM_RCL_EXCEPT"]):
            yield from _link("pilot", int(p["NAV_RCL_ACT"]), Cause.PILOT)
        ground_known = self._ground_heard is not None  # who never had one does not miss it
        if (
            ground_known
            and self.ground_lost
            and wanted is not modes.LAND
            and not _excepted(wanted, p["COM_DLL_EXCEPT"])
        ):
            yield from _link("ground", int(p["NAV_DLL_ACT"]), Cause.GROUND)
        if copter.geofence.acts:
            yield _fence(int(p["GF_ACTION"]))
        battery = self._battery()
        if battery is not None:
            yield battery
        fallback = self._fallback()
        if fallback is not None:
            yield Demand("mode", fallback, waits=False)

    def _battery(self) -> Demand | None:
        copter, warning = self._copter, self._copter.battery.warning
        if warning is Warning.NONE:
            return None
        rule = int(copter.params["COM_LOW_BAT_ACT"]) if warning > self._battery_at_arming else 0
        action, cause = Action.WARN, Cause.BATTERY_LOW
        if warning is Warning.CRITICAL:
            cause = Cause.BATTERY_CRITICAL
            action = Action.RTL if rule in _RETURNS else Action.LAND if rule == 2 else Action.WARN
        elif warning is Warning.EMERGENCY:
            cause = Cause.BATTERY_EMERGENCY
            action = Action.LAND if rule in (2, 3) else Action.RTL if rule == 1 else Action.WARN
        return Demand(f"battery {warning.name}", action, cause=cause)

    def _fallback(self) -> Action | None:
        """What flies where the mode asked for cannot; None where it can."""
        copter, mode = self._copter, self._copter.wanted
        action: Action | None = None
        if mode is modes.OFFBOARD and not copter.offboard.alive:
            rule = int(copter.params["COM_OBL_RC_ACT"])
            action = OFFBOARD_LOSS[rule] if 0 <= rule < len(OFFBOARD_LOSS) else Action.POSCTL
            mode = MODE_OF.get(action, modes.TERMINATION)
        if mode is modes.POSCTL and not self.can_run(mode):
            action, mode = Action.ALTCTL, modes.ALTCTL
        if mode is modes.ALTCTL and not self.can_run(mode):
            action, mode = Action.STABILIZED, modes.STABILIZED
        return Action.RTL if not self.can_run(mode) else action

    # ---- words

    def _notify(self, demand: Demand, action: Action, delayed: Action = Action.NONE) -> None:
        copter, cause = self._copter, demand.cause
        mode = struct.pack("<I", copter.wanted.custom)
        told, why = struct.pack("<B", delayed or action), b"" if cause is Cause.GENERIC else struct.pack("<B", cause)
        if action is Action.HOLD and delayed is not Action.NONE:
            seconds = round(self._wait)
            event = events.FAILSAFE_HOLD_CAUSED if why else events.FAILSAFE_HOLD
            copter.tell(event, mode + told + struct.pack("<H", seconds) + why)
            copter.say(2, f"Failsafe activated, entering Hold for {seconds} seconds\t")
        elif action is Action.WARN:
            if cause in _BATTERY_WARNS:
                copter.tell(_BATTERY_WARNS[cause])
            else:
                copter.tell(events.FAILSAFE_WARNS_CAUSED if why else events.FAILSAFE_WARNS, mode + why)
        else:
            copter.tell(events.FAILSAFE_CAUSED if why else events.FAILSAFE, mode + told + why)


def _excepted(mode: Mode, mask: float) -> bool:
    """COM_RCL_EXCEPT and COM_DLL_EXCEPT: modes that go on without the link."""
    bit = 1 if mode is modes.MISSION else 2 if mode.auto else 4 if mode is modes.OFFBOARD else 0
    return bool(int(mask) & bit)


def _link(key: str, rule: int, cause: Cause) -> Iterator[Demand]:
    action = LINK_LOSS.get(rule)
    if action in (Action.DISARM, Action.TERMINATE):
        ends = Ends.NEVER if action is Action.TERMINATE else Ends.WITH_CAUSE
        yield Demand(key, action, ends, Takeover.NEVER, cause)
    elif action is not None:
        yield Demand(key, action, Ends.WITH_MODE, cause=cause)


def _fence(rule: int) -> Demand:
    action = FENCE_BREACH.get(rule, Action.WARN)
    if action is Action.TERMINATE:
        return Demand("fence", action, Ends.NEVER, Takeover.NEVER)
    if action is Action.WARN:
        return Demand("fence", action)
    # HOLD acts at once, so that the pilot can get out again by a change of the mode.
    holds = action is Action.HOLD
    return Demand("fence", action, Ends.WITH_MODE, Takeover.BY_MODE if holds else Takeover.ALWAYS, waits=not holds)
