"""The health and arming checks: what stands against arming and against each mode, and the report of it.

A report is a summary of modes and components, an event for every check that fails, and a summary of what there is. It
is sent when something has changed, not more often than every other second. Protocol:
https://mavlink.io/en/services/events.html, with PX4's "health and arming checks" of libevents.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

import msgspec

from zmav.mavlink.event import event_id
from zmav.sim.autopilots.px4.battery import Warning
from zmav.sim.autopilots.px4.events import ARMING_SUMMARY, HEALTH_SUMMARY, Event
from zmav.sim.autopilots.px4.failsafe import Failsafe, Px4Parts
from zmav.sim.autopilots.px4.modes import MISSION, MODES, OFFBOARD, RTL

REPORT_S = 2.0
EVERY_MODE = 0xFFFFFFFF
# Of a multicopter: those that there are beside the ones that need sticks or a mission.
_POSSIBLE = 0x807F7BB0
_MANUAL = sum(mode.bit for mode in MODES if mode.manual)
_BY_POSITION = sum(mode.bit for mode in MODES if mode.position)
# Health components, as numbers of bits.
_GPS, _REMOTE, _BATTERY, _LINKS, _LOCAL, _SYSTEM, _GLOBAL = 3, 7, 11, 12, 17, 20, 24
_PRESENT, _LOGGING = 0x3802080A, 10
_EMERGENCY, _CRITICAL, _ERROR, _WARNING, _INFO = 0x00, 0x22, 0x33, 0x44, 0x66


class Check(msgspec.Struct, frozen=True):
    """One that fails: it stands against ``modes``; ``arms``: it only stands against arming in them."""

    name: str
    component: int
    levels: int
    modes: int = 0
    arms: bool = False
    text: str = ""

    @property
    def event(self) -> Event:
        return Event(event_id(self.name), self.levels)


class Health:
    """The checks of one vehicle."""

    def __init__(self, copter: Px4Parts, failsafe: Failsafe) -> None:
        self._copter, self._failsafe = copter, failsafe
        self._reported: tuple[Check, ...] | None = None
        self._reported_at = copter.now

    def ready_for(self, bit: int) -> bool:
        """Nothing stands against arming in the mode of that bit."""
        return not any(check.modes & bit for check in self.failing())

    def update(self) -> None:
        """Twice a second: send a report where it has changed."""
        copter = self._copter
        found = tuple(self.failing())
        if self._reported is None:
            self._reported = found  # before anybody listens
        elif found != self._reported and copter.now - self._reported_at >= REPORT_S:
            self._tell_new(found, self._reported)
            self._reported = found
            self.tell()

    def tell(self) -> None:
        """Send a report now: RUN_PREARM_CHECKS asks for one."""
        self._reported_at = self._copter.now
        for event, arguments in self.report(tuple(self.failing())):
            self._copter.event(event, arguments)

    def _tell_new(self, found: tuple[Check, ...], before: tuple[Check, ...]) -> None:
        for check in found:
            if check.text and check not in before:
                self._copter.say(2, check.text)

    # ---- the checks

    def failing(self) -> Iterator[Check]:
        copter, p = self._copter, self._copter.params
        if not copter.booted:
            yield Check("check_estimator_missing_data", _LOCAL, _INFO, EVERY_MODE)
        if not copter.armed and not copter.wanted.arms:
            yield Check("check_modes_cannot_takeoff", _SYSTEM, _INFO, copter.wanted.bit, True)
        if not copter.position_ok:
            yield Check("check_modes_local_pos", _LOCAL, _ERROR, _BY_POSITION)
            yield Check("check_modes_global_pos", _GLOBAL, _ERROR, _BY_POSITION)
        if not copter.mission.able:
            modes = EVERY_MODE if p["COM_ARM_MIS_REQ"] else MISSION.bit
            yield Check("check_modes_mission", _SYSTEM, _INFO, modes)
        if not copter.has_home:
            yield Check("check_modes_home_position", _SYSTEM, _INFO, RTL.bit)
        if not copter.offboard.alive:
            yield Check("check_modes_offboard_signal", _SYSTEM, _ERROR, OFFBOARD.bit)
        if not copter.sticks.alive:
            yield Check("check_modes_manual_control", _REMOTE, _WARNING, _MANUAL)
        yield from self._links()
        yield from self._gps()
        yield from self._battery()
        yield from self._fence()

    def _links(self) -> Iterator[Check]:
        copter = self._copter
        if self._failsafe.ground_lost:
            needed = int(copter.params["NAV_DLL_ACT"]) > 0
            text = "Preflight Fail: No connection to the GCS" if needed and not copter.armed else ""
            yield Check(
                "check_rc_dl_no_dllink", _LINKS, _ERROR if needed else _INFO, EVERY_MODE if needed else 0, True, text
            )

    def _gps(self) -> Iterator[Check]:
        copter = self._copter
        if copter.armed or copter.filter.has_fix or not copter.booted:
            return
        rule = int(copter.params["COM_ARM_WO_GPS"])
        if rule == 0:
            text = "Preflight Fail: GPS fix too low"
            yield Check("check_estimator_gps_fix_too_low", _GPS, _ERROR, EVERY_MODE, True, text)
        elif rule == 1:
            yield Check("check_estimator_gps_fix_too_low", _GPS, _WARNING, text="Preflight: GPS fix too low")

    def _battery(self) -> Iterator[Check]:
        copter = self._copter
        warning, least = copter.battery.warning, copter.params["COM_ARM_BAT_MIN"]
        below = not copter.armed and copter.battery.remaining < least
        if warning is Warning.NONE and not below:
            return
        modes = EVERY_MODE if below or (copter.armed and warning >= Warning.CRITICAL) else 0
        if warning is Warning.EMERGENCY:
            text = "Emergency battery level\t"
            yield Check("check_battery_emergency", _BATTERY, _EMERGENCY, modes, True, text)
        elif warning is Warning.CRITICAL:
            yield Check("check_battery_critical", _BATTERY, _CRITICAL, modes, True, "Critical battery\t")
        else:
            yield Check("check_battery_low", _BATTERY, _CRITICAL, modes, True, "Low battery\t")

    def _fence(self) -> Iterator[Check]:
        fence = self._copter.geofence
        if not fence.acts:
            return
        for breached, name, what in (
            (fence.breach.distance, "check_gf_violation_max_hor_dist", "exceeding maximum distance to Home"),
            (fence.breach.height, "check_gf_violation_max_alt", "exceeding maximum altitude above Home"),
            (fence.breach.area, "check_gf_violation_custom_gf", "approaching or outside geofence"),
        ):
            if breached:
                yield Check(name, _SYSTEM, _ERROR, EVERY_MODE, True, f"Geofence: {what}")

    # ---- the report

    def report(self, found: tuple[Check, ...]) -> list[tuple[Event, bytes]]:
        """Events with their arguments, in the order in which PX4 sends them."""
        error = warning = 0
        can_arm = can_run = _POSSIBLE | _MANUAL | MISSION.bit
        copter = self._copter
        present = _PRESENT | copter.armed << _LOGGING | copter.sticks.alive << _REMOTE
        present |= (not self._failsafe.ground_lost) << _LINKS
        checks = []
        for check in found:
            severity = check.levels & 0xF
            error |= (severity <= 3) << check.component
            warning |= (severity == 4) << check.component
            can_arm &= ~check.modes
            can_run &= EVERY_MODE if check.arms else ~check.modes
            # A check that stands against no mode, or warns of sticks that only some need, names them all.
            told = EVERY_MODE if not check.modes or severity == 4 else check.modes
            checks.append((check.event, struct.pack("<IB", told, check.component)))
        head = struct.pack("<BIIII", 0, error, warning, can_arm, can_run)
        foot = struct.pack("<BIII", 0, present, 0, 0)
        return [(ARMING_SUMMARY, head), *checks, (HEALTH_SUMMARY, foot)]
