"""Every rule by itself: what makes it speak, in which words, and what just does not."""

from __future__ import annotations

import collections
from typing import Any

import msgspec
import pytest

from zmav import wire
from zmav.doctor.facts import AgentReport, Facts, Happening
from zmav.doctor.rules import PROOF, RULES, reasons
from zmav.doctor.ways import Link, Way

NOW = 1_800_000_000.0


def state(**more: Any) -> wire.VehicleState:
    """A vehicle that is well."""
    well: dict[str, Any] = {
        "connected": True,
        "sysid": 1,
        "autopilot": "ardupilot",
        "mode": "GUIDED",
        "armed": True,
        "status": "ACTIVE",
        "battery": wire.Battery(remaining=0.9),
        "gps": wire.Gps(fix="3D_FIX", satellites=12, hdop=0.8),
        "link": "up",
        "ages": {"position": 0.1},
    }
    return wire.VehicleState(t=NOW, fleet="demo", name="quad1", instance="a", **(well | more))


def facts(**more: Any) -> Facts:
    usual: dict[str, Any] = {"state": state(), "age": 0.2}
    return Facts(name="quad1", **(usual | more))


def link(loss: float) -> wire.LinkQuality:
    return wire.LinkQuality(
        t=NOW, name="autopilot", url="tcp:1", state="up", age=0.0, rx_rate=50.0, rx_bytes_rate=1e3, loss=loss
    )


def agent(**more: Any) -> AgentReport:
    well: dict[str, Any] = {"state": "track", "text": "", "age": 0.5, "stale": False}
    return AgentReport(name="follower", fleet="demo", host="quad1", **(well | more))


def end(reason: Any, ago: float, by: str | None = None) -> wire.LeaseEnd:
    return wire.LeaseEnd(t=NOW + 0.2 - ago, number=1, holder="planner", reason=reason, text="", by=by)


def event(severity: str, age: float) -> Happening:
    return Happening(age=age, kind="statustext", severity=severity, text="Crash: disarming")


def hop(loss: float, cost: int = 100) -> Way:
    said = wire.NeighbourQuality(
        t=NOW, name="quad2", router="a", peer="b", url="", state="up", loss_in=loss, loss_out=loss, cost=cost
    )
    return Way(("quad1", "quad2"), (Link("quad1", "quad2", by_a=said, by_b=said),))


def gps(**more: Any) -> wire.VehicleState:
    well: dict[str, Any] = {"fix": "3D_FIX", "satellites": 12, "hdop": 0.8}
    return state(gps=wire.Gps(**(well | more)))


def corrected(fix: str = "RTK_FIXED", **more: Any) -> Facts:
    well: dict[str, Any] = {"age": 1.2, "source": "gs", "station": 1, "baseline": 900.0, "rate": 600.0}
    return facts(state=msgspec.structs.replace(gps(fix=fix), corrections=wire.CorrectionsInfo(**(well | more))))


def traffic(**more: Any) -> Facts:
    known: dict[str, Any] = {"distance": 400.0, "height": 30.0, "nearest": 50.0, "time": 8.2, **more}
    return facts(state=state(traffic=wire.TrafficInfo(icao="3c4b12", callsign="DEABC", **known)))


CASES: list[tuple[str, Facts, str]] = [
    ("state", facts(presence="stale", age=12.2), "bad: no state for 12s"),
    ("state", facts(presence="gone", age=125.0), "bad: no state for 2m05, and its token is gone"),
    ("state", facts(presence="silent", age=None, state=None), "bad: its token is there, but no state was heard"),
    (
        "state",
        facts(presence="silent", age=None, state=None, disbelieved=("unknown",)),
        "bad: its states are not believed: unknown",
    ),
    ("disbelieved", facts(disbelieved=("name", "replayed")), "warn: somebody else spoke in its name: name"),
    (
        "clash",
        facts(state=state(clash="quad2 and quad1 both have system id 1")),
        "bad: clash: quad2 and quad1 both have system id 1",
    ),
    ("clash", facts(twins=("quad2",)), "bad: clash of system ids with quad2"),
    ("autopilot", facts(state=state(connected=False, link="up")), "bad: autopilot silent (link up)"),
    ("autopilot", facts(state=state(connected=False, sysid=None, link="down")), "bad: no autopilot heard (link down)"),
    ("status", facts(state=state(status="EMERGENCY")), "bad: autopilot says EMERGENCY"),
    ("battery-empty", facts(state=state(battery=wire.Battery(remaining=0.12))), "bad: battery 12%"),
    ("gps-fix", facts(state=gps(fix="2D_FIX")), "bad: GPS 2D"),
    ("gps-fix", facts(state=gps(fix="NO_FIX", satellites=0)), "bad: GPS has no fix"),
    ("link-poor", facts(link=link(0.2)), "bad: MAVLink loss 20%"),
    ("agent-failed", facts(agents=(agent(state="failed", text="no pad"),)), "bad: agent follower failed (no pad)"),
    ("agent-failed", facts(agents=(agent(state="Failed", age=9.0, stale=True),)), "bad: agent follower Failed"),
    ("battery-low", facts(state=state(battery=wire.Battery(remaining=0.24))), "warn: battery 24%"),
    ("battery-low", facts(state=state(battery=wire.Battery(remaining=0.15))), "warn: battery 15%"),
    ("gps-weak", facts(state=gps(satellites=5)), "warn: GPS 5 satellites"),
    ("gps-weak", facts(state=gps(hdop=2.6)), "warn: GPS HDOP 2.6"),
    ("corrections-old", corrected(age=31.0, dropped={"old": 3}), "warn: corrections 31s old (dropped: 3 old)"),
    (
        "corrections-old",
        corrected(age=None, dropped={"ahead": 4, "standby": 2}),
        "warn: corrections of gs come, and its receiver was given none (dropped: 4 ahead)",
    ),
    ("corrections-far", corrected(baseline=31_000.0), "warn: its base is 31 km away"),
    ("corrections-unused", corrected(fix="3D_FIX"), "warn: corrections come, and its GPS has 3D_FIX"),
    ("traffic-close", traffic(close=True), "bad: traffic: DEABC 400 m away, 30 m above, 50 m in 8 s"),
    ("traffic-coming", traffic(height=None), "warn: traffic: DEABC 400 m away, height unknown, 50 m in 8 s"),
    ("position-old", facts(state=state(ages={"position": 5.4})), "warn: position 5.4s old"),
    ("link-loss", facts(link=link(0.05)), "warn: MAVLink loss 5%"),
    ("link-loss", facts(state=state(link_loss=0.1)), "warn: MAVLink loss 10%"),
    ("way", facts(way=Way(("quad1",), (), complete=False)), "warn: the way to it is not known to the end"),
    ("weak-hop", facts(way=hop(0.3)), "warn: weak hop quad1 - quad2 (up, 30% lost)"),
    ("slow", facts(rtt=1.2), "warn: answers take 1.2s"),
    ("lease-end", facts(state=state(lease_end=end("gone", 12.0))), "warn: lease of planner ended 12s ago: gone"),
    (
        "lease-end",
        facts(state=state(lease_end=end("preempted", 5.0, "boss"))),
        "warn: lease of planner ended 5.0s ago: preempted by boss",
    ),
    ("dropped", facts(recent=collections.Counter(late=3, order=1)), "warn: setpoints dropped: 3 late, 1 order"),
    (
        "refused",
        facts(recent=collections.Counter({PROOF + "missing": 2})),
        "warn: orders without proof refused: 2 missing",
    ),
    ("agent-silent", facts(agents=(agent(age=8.0, stale=True),)), "warn: agent follower silent for 8.0s"),
    (
        "clock",
        facts(state=state(clock=wire.ClockInfo(boot_t=0.0, error_s=0.01, gps_offset_s=-3.2))),
        "warn: companion's clock 3.2 s off GPS",
    ),
    ("error", facts(events=(event("info", 1.0), event("critical", 2.0))), "warn: Crash: disarming (2.0s ago)"),
    ("pilot", facts(state=state(pilot="the switch says so")), "note: pilot: the switch says so"),
    ("not-ready", facts(state=state(armed=False, not_ready=["no GPS", "EKF"])), "note: not ready: no GPS; EKF"),
    ("not-ready", facts(state=state(armed=False, ready=False)), "note: not ready: it does not say why"),
    ("recording", facts(state=state(replayed=True)), "note: a recording: it takes no orders"),
]

WELL: dict[str, Facts] = {
    "all is well": facts(),
    "a battery that tells no charge": facts(state=state(battery=wire.Battery(voltage=12.0))),
    "a quarter of the battery": facts(state=state(battery=wire.Battery(remaining=0.25))),
    "six satellites": facts(state=gps(satellites=6, hdop=2.5)),
    "corrections that are used": corrected(),
    "corrections that are used as floats, and others that are dropped": corrected("RTK_FLOAT", dropped={"standby": 9}),
    "an old position": facts(state=state(ages={"position": 5.0})),
    "a little loss": facts(link=link(0.049)),
    "a lossless link, whatever its last state said": facts(link=link(0.0), state=state(link_loss=0.5)),
    "a lease given back": facts(state=state(lease_end=end("released", 1.0))),
    "a lease that ended long ago": facts(state=state(lease_end=end("gone", 61.0))),
    "an error long ago": facts(events=(event("critical", 31.0),)),
    "a warning": facts(events=(event("warning", 1.0),)),
    "a good hop": facts(way=hop(0.01)),
    "a quick answer": facts(rtt=0.9),
    "a clock that GPS agrees with": facts(
        state=state(clock=wire.ClockInfo(boot_t=0.0, error_s=0.01, gps_offset_s=0.9))
    ),
    "a state that was overtaken": facts(disbelieved=("replayed",)),
    "an agent at work": facts(agents=(agent(),)),
    "not ready, but in the air": facts(state=state(armed=True, not_ready=["pre-arm checks fail"])),
}


def said(found: Facts) -> list[str]:
    return [f"{reason.level}: {reason.text}" for reason in reasons(found)]


@pytest.mark.parametrize(("rule", "found", "words"), CASES, ids=[f"{c[0]}-{i}" for i, c in enumerate(CASES)])
def test_a_rule_speaks_alone(rule: str, found: Facts, words: str) -> None:
    assert said(found) == [words]
    assert [reason.rule for reason in reasons(found)] == [rule]


def test_advice_is_whole() -> None:
    assert not [rule.name for rule in RULES if not rule.advice or "{" in rule.advice]


@pytest.mark.parametrize(("loss", "grade"), [(0.5, "poor"), (0.1, "fair"), (0.0, "unknown")])
def test_a_link_that_loses_is_no_good_whatever_it_costs(loss: float, grade: str) -> None:
    said = wire.NeighbourQuality(t=NOW, name="b", router="1", peer="2", url="udp/b:1", state="up", loss_in=loss)
    assert Link("a", "b", by_a=said).grade == grade


def test_every_rule_has_its_case() -> None:
    assert {case[0] for case in CASES} == {rule.name for rule in RULES}


@pytest.mark.parametrize("found", WELL.values(), ids=WELL.keys())
def test_no_rule_speaks_without_need(found: Facts) -> None:
    assert said(found) == []


def test_the_worst_comes_first() -> None:
    found = facts(state=state(armed=False, not_ready=["EKF"], battery=wire.Battery(remaining=0.05)), rtt=2.0)
    assert said(found) == ["bad: battery 5%", "warn: answers take 2.0s", "note: not ready: EKF"]


def test_of_a_vehicle_that_is_gone_old_news_is_not_told() -> None:
    found = facts(presence="gone", age=4.0, state=state(battery=wire.Battery(remaining=0.05)), rtt=2.0)
    assert said(found) == ["bad: no state for 4.0s, and its token is gone"]


def test_the_end_of_a_lease_is_told_by_the_vehicle_s_own_clock() -> None:
    """A vehicle whose clock is a day off says what it says at the same moment."""
    late = state(lease_end=end("gone", 12.0))
    late.t -= 86400.0
    assert late.lease_end is not None
    late.lease_end.t -= 86400.0
    assert said(facts(state=late)) == ["warn: lease of planner ended 12s ago: gone"]


def test_words_of_vehicles_are_cleaned() -> None:
    found = facts(state=state(clash="\x1b[2Jquad2\r\n\u202eevil"))
    assert said(found) == ["bad: clash: ?[2Jquad2  ?evil"]
