"""The last stage: does what is on the vehicle now match what was flown? It arms nothing and sets nothing."""

from __future__ import annotations

import fnmatch
import shlex
import time
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path

import click

import zmav
from agents.hil.beside import begun, beside, check_device, tell
from agents.hil.checkflight import CheckFlight
from agents.hil.proof import HIL_FLAG, HITL
from agents.hil.report import Check, Identity, Report, Stage, find, hash_of, place
from zmav.children import Children
from zmav.config import load_fleet
from zmav.doctor.survey import look
from zmav.doctor.vehicles import examine
from zmav.errors import ZmavError
from zmav.mavlink.paramvalue import Value
from zmav.vehicle.params import differences, own_params

DAY_S = 86_400.0
MOST_DAYS = 30.0
"""how old a report may be"""
DOCTOR_S = 3.0
MOST_TOLD = 40
"""differing parameters that are named"""
SIMULATED = ("SIM_*", HITL)
COUNTED = ("MIS_TOTAL", "FENCE_TOTAL", "RALLY_TOTAL", "COMPASS_DEC")
"""what an ArduPilot writes by itself of its plans and its place"""
SENSORS: Mapping[str, tuple[str, ...]] = {
    "ardupilot": (
        "INS_*OFFS_*",
        "INS_*SCAL_*",
        "INS_*CALTEMP",
        "INS_TCAL*",
        "AHRS_TRIM_*",
        "COMPASS_OFS*",
        "COMPASS_DIA*",
        "COMPASS_ODI*",
        "COMPASS_MOT*",
        "COMPASS_SCALE*",
        "COMPASS_PRIO*",
        "COMPASS_EXTERN*",
        "COMPASS_ORIENT*",
    ),
    "px4": ("CAL_*",),
}
"""what calibrates the sensors: simulated ones had other values"""


async def gate(path: Path, name: str, reports: Path, device: str | None, accept: Sequence[str]) -> int:
    """Look, and say each thing; 0 where it may fly, and the command that flies it."""
    file = load_fleet(path)
    link = device or file.vehicle(name).link
    check_device(link)
    found: list[Check] = []

    def say(check: Check) -> None:
        found.append(check)
        tell(check)

    click.echo(f"flight: {file.fleet}/{name} from {path}, the autopilot at {link}")
    flown: dict[Stage, Report | None] = {"sil": find(reports, name, "sil"), "bench": find(reports, name, "bench")}
    now = begun("bench", file, name, link)
    for stage, report in flown.items():
        say(judge_report(report, stage, hash_of(file, name), time.time(), place(reports, name, stage)))
    with Children() as children:
        async with beside(children, path, file, name, link) as (client, router):
            try:
                flight = CheckFlight(client, file, name, router, children, now, say)
                await flight.meet()
                assert now.identity is not None
                base_mode = str((await flight.vehicle.message("HEARTBEAT")).fields["base_mode"])
                for check in judge_identity(flown, now.identity):
                    say(check)
                say(judge_real(now.identity.autopilot, now.params, base_mode))
                if flown["bench"] is not None:
                    for check in judge_params(now.identity.autopilot, flown["bench"].params, now.params, accept):
                        say(check)
                for check in await ask_doctor(client):
                    say(check)
            except ZmavError as e:
                say(Check("stage", "BAD", e.message))
    wrong = sum(check.status == "BAD" for check in found)
    if wrong:
        click.echo(f"NOT TO BE FLOWN: {wrong} of {len(found)} need attention")
        return 1
    words = ["zmav", "up", "--file", str(path), "--name", name, *(["--link", device] if device else [])]
    click.echo(f"ready: propellers on, then:\n    {shlex.join(words)}")
    return 0


def judge_report(report: Report | None, stage: Stage, fleet_hash: str, now: float, where: Path) -> Check:
    """There, green, of this fleet file, by this zmav, and not too old."""
    if report is None:
        return Check(stage, "BAD", f"no report {where}: run 'zmav hil {stage}'")
    again = f"run 'zmav hil {stage}' again"
    if not report.passed:
        bad = ", ".join(check.name for check in report.checks if check.status == "BAD")
        return Check(stage, "BAD", f"it did not pass ({bad}): {again}")
    if report.fleet_hash != fleet_hash:
        text = f"it flew with {report.fleet_hash[:12]} of the fleet file, which is now {fleet_hash[:12]}: {again}"
        return Check(stage, "BAD", text)
    if report.zmav != version("zmav"):
        return Check(stage, "BAD", f"it flew with zmav {report.zmav}, and this is {version('zmav')}: {again}")
    age = (now - report.t) / DAY_S
    if not -0.01 <= age <= MOST_DAYS:
        return Check(stage, "BAD", f"it is {age:.1f} days old, and {MOST_DAYS:g} are allowed: {again}")
    left = [check.name for check in report.checks if check.status == "left out"]
    out = f"; left out: {', '.join(left)}" if left else ""
    return Check(stage, "ok", f"passed {24 * age:.1f} h ago with this fleet file, by {report.flown_by}{out}")


def judge_identity(flown: Mapping[Stage, Report | None], now: Identity) -> list[Check]:
    """The very autopilot that was on the bench, and the kind that flew in the simulator."""
    checks = []
    sil, bench = flown["sil"], flown["bench"]
    if sil is not None and sil.identity is not None:
        before, here = (sil.identity.autopilot, sil.identity.kind), (now.autopilot, now.kind)
        if before != here:
            text = f"a {before[1]} by {before[0]} flew in the simulator, and this is a {here[1]} by {here[0]}"
            checks.append(Check("kind", "BAD", text))
    if bench is not None and bench.identity is not None:
        for what in ("uid", "firmware", "sysid"):
            was, is_now = getattr(bench.identity, what), getattr(now, what)
            if was != is_now:
                checks.append(Check(what, "BAD", f"{was} flew on the bench, and this is {is_now}"))
        if not checks:
            checks.append(Check("same autopilot", "ok", f"uid {now.uid}, firmware {now.firmware}"))
    return checks


def judge_real(autopilot: str, params: Mapping[str, Value], base_mode: str) -> Check:
    """Simulation is off: a vehicle that flies a simulation does not see the world."""
    simulation = [name for name in params if name.startswith("SIM_")]
    if params.get(HITL):
        text = f"{HITL} is {params[HITL]}: set it to 0 and reboot, or it sees no sensors and turns no motors"
        return Check("simulation", "BAD", text)
    if HIL_FLAG in base_mode:
        return Check("simulation", "BAD", "its HEARTBEAT says that it is in HIL: reboot it")
    if simulation and autopilot == "ardupilot":  # a PX4 has some without simulating
        text = f"its firmware simulates on board ({len(simulation)} SIM_ parameters): load the vehicle's own"
        return Check("simulation", "BAD", text)
    return Check("simulation", "ok", "off")


def judge_params(
    autopilot: str, flown: Mapping[str, Value], now: Mapping[str, Value], accept: Sequence[str]
) -> list[Check]:
    """What differs from what flew on the bench, by name; what is each one's own, or the sensors', is only counted."""
    own = own_params(autopilot, {*flown, *now})
    quiet = (*SIMULATED, *COUNTED, *SENSORS.get(autopilot, ()))
    told, counted = [], 0
    for each in differences({"bench": flown, "now": now}):
        if each.name in own or any(fnmatch.fnmatchcase(each.name, pattern) for pattern in quiet):
            counted += 1
            continue
        was, is_now = (
            f"{each.values[column]:g}" if each.values.get(column) is not None else "not there"
            for column in ("bench", "now")
        )
        ok = any(fnmatch.fnmatchcase(each.name, pattern) for pattern in accept)
        told.append(
            Check(
                f"parameter {each.name}",
                "ok" if ok else "BAD",
                f"{was} on the bench, {is_now} now{' (accepted)' if ok else ''}",
            )
        )
    told.sort(key=lambda check: check.status == "ok")  # what was accepted may be left untold
    told, rest = told[:MOST_TOLD], told[MOST_TOLD:]
    if rest:
        told.append(Check("parameters", rest[0].status, f"{len(rest)} more differ: see 'zmav param diff'"))
    if not told:
        told = [Check("parameters", "ok", f"{len(now)} as they flew on the bench")]
    if counted:
        told.append(Check("parameters not compared", "ok", f"{counted} of simulation, sensors and counters differ"))
    return told


async def ask_doctor(client: zmav.Client, seconds: float = DOCTOR_S) -> list[Check]:
    """What 'zmav doctor' finds wrong with the vehicle."""
    findings = list(examine(await look(client, seconds)))
    if not findings:
        return [Check("doctor", "BAD", "it found nothing to look at")]
    wrong = [
        Check(f"doctor: {each.subject}", "BAD", f"{each.found}; {each.advice}") for each in findings if not each.ok
    ]
    return wrong or [Check("doctor", "ok", f"{len(findings)} findings, all well")]
