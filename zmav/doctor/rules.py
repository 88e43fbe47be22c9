"""What is not well with a vehicle, in words, and what to do about it: one table of rules, each with its level and its
threshold in sight.

A rule sees the :class:`~zmav.doctor.facts.Facts` of one vehicle and says what is wrong, or nothing. Of a vehicle that
is not heard any more only the rules on its presence speak: the rest of what is known of it is old.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import msgspec

from zmav import wire
from zmav.doctor.facts import Facts
from zmav.doctor.ways import loss_level
from zmav.doctor.words import clean, duration

BATTERY_LOW, BATTERY_EMPTY = 0.25, 0.15
SATELLITES, HDOP = 6, 2.5
RTT = 1.0
"""s of a query to the vehicle and back"""
PART_OLD = 5.0
"""s after which a position is not the present one; other parts come more seldom"""
CLOCK_OFF = 1.0
"""s between the companion's clock and GPS"""
LEASE_END_SHOWN, EVENT_SHOWN = 60.0, 30.0
"""s for which the end of a lease and an error are worth saying"""
CORRECTIONS_OLD = 10.0
"""s from which a receiver loses what it has fixed"""
BASELINE = 30_000.0
"""m to a base up to which receivers with two bands fix"""
CORRECTED = ("DGPS", "RTK_FLOAT", "RTK_FIXED", "STATIC", "PPP")
NO_POSITION = {"NO_GPS": "no GPS", "NO_FIX": "GPS has no fix", "2D_FIX": "GPS 2D"}
LATE = "replayed"
"""why what was signed before the last that came is not believed"""
SEVERE = ("emergency", "alert", "critical", "error")
HURT = ("CRITICAL", "EMERGENCY", "FLIGHT_TERMINATION")
FAILED = ("failed", "error", "lost", "abort", "aborted")
"""states in which an agent says that it came to nothing"""

Level = Literal["ok", "note", "warn", "bad"]
LEVELS: tuple[Level, ...] = ("ok", "note", "warn", "bad")


class Reason(msgspec.Struct, kw_only=True, frozen=True):
    """Something that is not well: the rule that says so, how bad it is, the words, and what to do about it."""

    rule: str
    level: Level
    text: str
    advice: str = ""


Judge = Callable[[Facts], str | None]


@dataclass(frozen=True)
class Rule:
    """``says(facts)``: what is wrong, or None. ``always``: of vehicles that are not heard any more, too."""

    name: str
    level: Level
    says: Judge
    advice: str
    always: bool = False


def reasons(facts: Facts) -> list[Reason]:
    """Whatever is not well, the worst first, in the table's order among equals."""
    found = [
        Reason(rule=rule.name, level=rule.level, text=clean(words), advice=rule.advice)
        for rule in RULES
        if (rule.always or facts.presence == "ok") and (words := rule.says(facts))
    ]
    return sorted(found, key=lambda reason: -LEVELS.index(reason.level))


# Is it there?


def _no_state(f: Facts) -> str | None:
    if f.presence == "silent" and f.disbelieved:
        return f"its states are not believed: {', '.join(f.disbelieved)}"
    if f.presence == "silent":
        return "its token is there, but no state was heard"
    if f.presence == "ok":
        return None
    token = ", and its token is gone" if f.presence == "gone" else ""
    return f"no state for {duration(f.age)}{token}" if f.age is not None else f"no state was heard{token}"


def _disbelieved(f: Facts) -> str | None:
    """Somebody else speaks in its name. What comes late may only have been overtaken on the way."""
    others = [reason for reason in f.disbelieved if reason != LATE]
    return f"somebody else spoke in its name: {', '.join(others)}" if others else None


def _clash(f: Facts) -> str | None:
    if f.state is not None and f.state.clash:
        return f"clash: {f.state.clash}"
    return f"clash of system ids with {', '.join(f.twins)}" if f.twins else None


# Its autopilot.


def _autopilot(f: Facts) -> str | None:
    if f.state is None or f.state.connected:
        return None
    return f"{'no autopilot heard' if f.state.sysid is None else 'autopilot silent'} (link {f.state.link})"


def _status(f: Facts) -> str | None:
    status = f.state.status if f.state else None
    return f"autopilot says {status}" if status in HURT else None


def _not_ready(f: Facts) -> str | None:
    state = f.state
    if state is None or not state.connected or state.armed or (state.ready is not False and not state.not_ready):
        return None
    return f"not ready: {'; '.join(state.not_ready) or 'it does not say why'}"


def _pilot(f: Facts) -> str | None:
    return f"pilot: {f.state.pilot}" if f.state and f.state.pilot else None


# Battery and position.


def _battery(least: float, most: float) -> Judge:
    """The charge is so much, 0 to 1, or less than ``most``."""

    def says(f: Facts) -> str | None:
        charge = f.state.battery.remaining if f.state and f.state.battery else None
        return f"battery {charge:.0%}" if charge is not None and least <= charge < most else None

    return says


def _gps_fix(f: Facts) -> str | None:
    return NO_POSITION.get(f.state.gps.fix) if f.state and f.state.gps else None


def _gps_weak(f: Facts) -> str | None:
    gps = f.state.gps if f.state else None
    if gps is None or gps.fix in NO_POSITION:
        return None
    if gps.satellites is not None and gps.satellites < SATELLITES:
        return f"GPS {gps.satellites} satellites"
    return f"GPS HDOP {gps.hdop:.1f}" if gps.hdop is not None and gps.hdop > HDOP else None


def _position_old(f: Facts) -> str | None:
    age = f.state.ages.get("position") if f.state and f.state.connected else None
    return f"position {duration(age)} old" if age is not None and age > PART_OLD else None


def _corrections_old(f: Facts) -> str | None:
    found = f.state.corrections if f.state else None
    if found is None or (found.age is not None and found.age <= CORRECTIONS_OLD):
        return None
    if found.age is None:
        return f"corrections of {found.source} come, and its receiver was given none{_why_dropped(found)}"
    return f"corrections {duration(found.age)} old{_why_dropped(found)}"


def _why_dropped(found: wire.CorrectionsInfo) -> str:
    words = ", ".join(f"{count} {why}" for why, count in sorted(found.dropped.items()) if why != "standby")
    return f" (dropped: {words})" if words else ""


def _traffic(close: bool) -> Callable[[Facts], str | None]:
    """An aircraft that is near, or comes near within the time that it is warned of."""

    def look(f: Facts) -> str | None:
        found = f.state.traffic if f.state else None
        return found.words if found is not None and found.close is close else None

    return look


def _corrections_far(f: Facts) -> str | None:
    found = f.state.corrections if f.state else None
    if found is None or found.baseline is None or found.baseline <= BASELINE:
        return None
    return f"its base is {found.baseline / 1e3:.0f} km away"


def _corrections_unused(f: Facts) -> str | None:
    """They come, and its receiver makes nothing of them."""
    found, gps = (f.state.corrections, f.state.gps) if f.state else (None, None)
    if found is None or gps is None or gps.fix in NO_POSITION or gps.fix in CORRECTED:
        return None
    fresh = found.age is not None and found.age <= CORRECTIONS_OLD
    return f"corrections come, and its GPS has {gps.fix}" if fresh else None


# Its links.


def _link_loses(level: Level) -> Judge:
    """The link to its autopilot loses so much."""

    def says(f: Facts) -> str | None:
        loss = f.link.loss if f.link else f.state.link_loss if f.state else None
        return f"MAVLink loss {loss:.0%}" if loss is not None and loss_level(loss) == level else None

    return says


def _way(f: Facts) -> str | None:
    return "the way to it is not known to the end" if f.way is not None and not f.way.complete else None


def _weak_hop(f: Facts) -> str | None:
    hop = f.way.weakest if f.way else None
    if hop is None or hop.grade not in ("poor", "down"):
        return None
    loss = f", {hop.worst_loss:.0%} lost" if hop.worst_loss else ""
    return f"weak hop {hop.a} - {hop.b} ({hop.state}{loss})"


def _slow(f: Facts) -> str | None:
    return f"answers take {duration(f.rtt)}" if f.rtt is not None and f.rtt > RTT else None


# Who commands it.


def _lease_end(f: Facts) -> str | None:
    end = f.state.lease_end if f.state else None
    if end is None or end.reason == "released" or not -EVENT_SHOWN < f.now - end.t < LEASE_END_SHOWN:
        return None
    by = f" by {end.by}" if end.by else ""
    return f"lease of {end.holder} ended {duration(f.now - end.t)} ago: {end.reason}{by}"


PROOF = "proof:"
"""before the reasons of refused proofs among the recent counts"""


def _counted(what: str, *, proofs: bool) -> Judge:
    """What was dropped of late, by its reasons: of refused proofs, or of setpoints."""

    def says(f: Facts) -> str | None:
        chosen = ((why, count) for why, count in sorted(f.recent.items()) if why.startswith(PROOF) == proofs)
        words = ", ".join(f"{count} {why.removeprefix(PROOF)}" for why, count in chosen)
        return f"{what}: {words}" if words else None

    return says


# Its agents, its clock, its words.


def _agent_failed(f: Facts) -> str | None:
    words = [f"{a.name} {a.state}" + (f" ({a.text})" if a.text else "") for a in f.agents if a.state.lower() in FAILED]
    return f"agent {', '.join(words)}" if words else None


def _agent_silent(f: Facts) -> str | None:
    silent = [a for a in f.agents if a.stale and a.state.lower() not in FAILED]
    words = [f"{a.name} silent for {duration(a.age)}" for a in silent]
    return f"agent {', '.join(words)}" if words else None


def _clock(f: Facts) -> str | None:
    clock: wire.ClockInfo | None = f.state.clock if f.state else None
    off = clock.gps_offset_s if clock else None
    return f"companion's clock {abs(off):.1f} s off GPS" if off is not None and abs(off) > CLOCK_OFF else None


def _error(f: Facts) -> str | None:
    """The newest of the last errors."""
    found = next((e for e in f.events if e.severity in SEVERE and e.age < EVENT_SHOWN), None)
    return f"{found.text} ({duration(found.age)} ago)" if found else None


def _recording(f: Facts) -> str | None:
    return "a recording: it takes no orders" if f.state and f.state.replayed else None


CHARGE = "charge or change it before the next flight"
SKY = "wait for GPS and EKF under open sky"
LINE = "ask for fewer messages, or a higher baud rate with flow control; on a radio, look at the antennas"
LOG = "its terminal or 'journalctl -u zmav-agent@NAME' says why"
RULES: tuple[Rule, ...] = (
    Rule("state", "bad", _no_state, "is its computer on, and its router linked to this one?", always=True),
    Rule("clash", "bad", _clash, "give one another --name, or another MAV_SYSID (SYSID_THISMAV, MAV_SYS_ID)"),
    Rule(
        "autopilot",
        "bad",
        _autopilot,
        "on the vehicle, look at power, cable, port and baud rate; "
        "'zmav doctor --file FILE --name NAME' or '--link URL' tells more there",
    ),
    Rule("status", "bad", _status, "its own words say why: zmav echo NAME/event"),
    Rule("battery-empty", "bad", _battery(-1.0, BATTERY_EMPTY), f"land it; {CHARGE}"),
    Rule("traffic-close", "bad", _traffic(True), "land it, or fly it away and down"),
    Rule("gps-fix", "bad", _gps_fix, SKY),
    Rule("link-poor", "bad", _link_loses("bad"), LINE),
    Rule("agent-failed", "bad", _agent_failed, LOG),
    Rule("disbelieved", "warn", _disbelieved, "do not believe what a stranger says: zmav mesh ca"),
    Rule("traffic-coming", "warn", _traffic(False), "watch it: zmav traffic; be ready to land or to fly away and down"),
    Rule("battery-low", "warn", _battery(BATTERY_EMPTY, BATTERY_LOW), CHARGE),
    Rule("gps-weak", "warn", _gps_weak, SKY),
    Rule(
        "corrections-old",
        "warn",
        _corrections_old,
        "look at 'zmav rtk' and the way from it; zmav echo 'HOST/agent/rtk/status'",
    ),
    Rule("corrections-far", "warn", _corrections_far, "take a base or a mountpoint nearby: it is another place's"),
    Rule(
        "corrections-unused",
        "warn",
        _corrections_unused,
        "can its receiver do RTK, does it see what the base sees, and is the base within 30 km?",
    ),
    Rule("position-old", "warn", _position_old, "look at its link and at the rate of GLOBAL_POSITION_INT: zmav rate"),
    Rule("link-loss", "warn", _link_loses("warn"), LINE),
    Rule("way", "warn", _way, "zmav mesh graph shows which router says nothing"),
    Rule("weak-hop", "warn", _weak_hop, "antennas, distance, channel and power; watch zmav mesh graph"),
    Rule("slow", "warn", _slow, "zmav mesh graph shows the slow link"),
    Rule("lease-end", "warn", _lease_end, "the one who flew it says why it ended"),
    Rule(
        "dropped",
        "warn",
        _counted("setpoints dropped", proofs=False),
        "synchronise the clocks (chrony, GPS, PTP), and look at the way between",
    ),
    Rule(
        "refused",
        "warn",
        _counted("orders without proof refused", proofs=True),
        "who orders needs credentials of this fleet: zmav mesh ca",
    ),
    Rule("agent-silent", "warn", _agent_silent, f"{LOG}; start it again"),
    Rule("clock", "warn", _clock, "set its computer's clock: chrony"),
    Rule("error", "warn", _error, "zmav echo NAME/event shows what came before"),
    Rule("pilot", "note", _pilot, "the pilot's switch gives it back"),
    Rule("not-ready", "note", _not_ready, f"{SKY}; its reasons as they come: zmav echo NAME/event"),
    Rule("recording", "note", _recording, "nothing: look at it as long as you like"),
)


def of_state(state: wire.VehicleState) -> list[Reason]:
    """What a vehicle's state alone tells, as it comes."""
    return reasons(Facts(name=state.name, state=state))
