"""The recorded flight of a real ArduPlane, flown by the simulated one: the same messages, rates, words and figures."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from statistics import median
from typing import Any

import pytest

from tests.sim.plane.conftest import GUIDED, TAKEOFF
from tests.sim.yardstick.compare import CLOCKS, TOLERANCE
from tests.sim.yardstick.compare import gap as angle_between
from tests.sim.yardstick.flights import plane
from tests.sim.yardstick.measure import only_what_is_explained_differs
from tests.sim.yardstick.reading import Message, from_tlog, rates, states
from zmav.mavlink import Dialect, load_dialect

# message.field -> why it is not the same
KNOWN = {
    "AHRS2.altitude": "the real one's second filter is some metres off",
    "ESC_TELEMETRY_1_TO_4": "the real one's simulated motor always says the same",
    "GPS_RAW_INT.cog": "without motion it is noise",
    "RAW_IMU.temperature": "the real one's sensor warms up",
    "SCALED_IMU2.temperature": "the real one's sensor warms up",
    "SCALED_PRESSURE.temperature": "the real one's sensor warms up",
    "SCALED_PRESSURE2.temperature": "the real one's sensor warms up",
    "AIRSPEED.raw_press": "the real one's ratio of the pitot tube is one of its parameters",
    "AIRSPEED.temperature": "the same",
    "WIND.direction": "of no wind",
    "NAV_CONTROLLER_OUTPUT.aspd_error": "100 of it are 1 m/s",
    "BATTERY_STATUS.voltages": "an ideal source",
    "PARAM_VALUE": "what the real one learns and saves",
    "standing: HEARTBEAT.custom_mode": "two modes, each for about half of it: the steps are compared one by one",
    "WIND.speed": "the real filter believes in a little wind that is not there",
    "standing: AIRSPEED.airspeed": "the noise of a pitot tube at rest",
    "standing: VFR_HUD.airspeed": "the same",
    "circling: NAV_CONTROLLER_OUTPUT.alt_error": "the real one settles half a metre off, slowly",
}
# The climb lasts three seconds, in which the plane comes back to its course after the run: these change all the time.
PASSING = {"yaw", "rollspeed", "pitchspeed", "xgyro", "ygyro", "yacc", "vy", "y", "xtrack_error"}
NOT_SENT = {
    "TERRAIN_REQUEST": "the simulated ground is flat, and nobody is asked for it",
    "TERRAIN_REPORT": "nobody on the link reads it",
    "AOA_SSA": "the same",
    "SIMSTATE": "the same",
    "PARAM_VALUE": "what the real one learns and saves in flight",
}
NOT_SAID = {
    "EKF2 IMU0 is using GPS": "the second filter is only spoken of while it wakes up",
    "EKF2 IMU1 is using GPS": "the same",
}
PHASES = ("standing", "climbing", "circling")


def phase_of(name: str, fields: dict[str, Any], state: dict[str, float]) -> str:
    """Standing until it is armed; climbing fast in TAKEOFF; and on its circle, in GUIDED, at the end."""
    if name == "HEARTBEAT":
        state["armed"], state["mode"] = fields["base_mode"] & 128, fields["custom_mode"]
    if name == "VFR_HUD":
        state["climb"] = fields["climb"]
    if name == "NAV_CONTROLLER_OUTPUT":
        near = abs(fields["xtrack_error"]) < 20 and abs(fields["alt_error"]) < 1.5 and fields["wp_dist"] < 110
        state["steady"] = state.get("steady", 0) + 1 if near and state.get("mode") == GUIDED else 0
    if state.get("mode") == GUIDED:
        return "circling" if state.get("steady", 0) > 30 else ""
    if state.get("armed"):
        return "climbing" if state.get("mode") == TAKEOFF and state.get("climb", 0.0) > 7.0 else ""
    return "standing" if state.get("gps") else ""


def by_phase(messages: list[Message]) -> dict[tuple[str, str, str], list[float]]:
    found: dict[tuple[str, str, str], list[float]] = defaultdict(list)
    state: dict[str, float] = {}
    for _, name, fields in messages:
        if name == "EKF_STATUS_REPORT" and fields["flags"] == 831:
            state["gps"] = 1.0
        phase = phase_of(name, fields, state)
        for field, value in fields.items():
            if phase and field not in CLOCKS and isinstance(value, int | float):
                found[phase, name, field].append(float(value))
    return found


@pytest.fixture(scope="module")
def dialect() -> Dialect:
    return load_dialect("ardupilotmega")


def test_the_flight_looks_the_same(shared_data: Path, dialect: Dialect) -> None:
    real = list(from_tlog(shared_data / "plane.tlog", dialect))
    ours = plane()
    same_messages_at_the_same_rates(real, ours)
    same_words_and_stages(real, ours)
    same_fields(real, ours, dialect)
    only_what_is_explained_differs("plane", real, ours)


def same_messages_at_the_same_rates(real: list[Message], ours: list[Message]) -> None:
    expected, found = rates(real), rates(ours)
    assert expected.keys() - found.keys() == NOT_SENT.keys()
    assert found.keys() <= expected.keys()
    # The servos are told of once more for every override that a failsafe looks at.
    steady = [name for name in found if name not in ("STATUSTEXT", "SERVO_OUTPUT_RAW", "HEARTBEAT")]
    assert {name: found[name] for name in steady} == pytest.approx({name: expected[name] for name in steady}, rel=0.06)


def same_words_and_stages(real: list[Message], ours: list[Message]) -> None:
    assert states(ours, "EKF_STATUS_REPORT", "flags") == states(real, "EKF_STATUS_REPORT", "flags")
    for name, fields in {
        "HEARTBEAT": ("base_mode", "custom_mode", "system_status"),
        "SYS_STATUS": tuple(f"onboard_control_sensors_{part}" for part in ("present", "enabled", "health")),
    }.items():
        # Two things that come within one interval may show as one step or as two.
        assert set(states(ours, name, *fields)) <= set(states(real, name, *fields)), name
        assert states(ours, name, *fields)[-1] == states(real, name, *fields)[-1], name

    def words(messages: list[Message]) -> set[str]:
        texts = {f["text"] for _, name, f in messages if name == "STATUSTEXT"}
        ends = ("Takeoff to 50m", "Takeoff level-off", "Autoland direction", "SIM Hit ground")
        return {next((end for end in ends if text.startswith(end)), text.replace("-0.0", "0.0")) for text in texts}

    assert words(real) - words(ours) == NOT_SAID.keys()
    assert words(ours) <= words(real)


def same_fields(real: list[Message], ours: list[Message], dialect: Dialect) -> None:
    expected, found = by_phase(real), by_phase(ours)
    assert {key[0] for key in expected} == {key[0] for key in found} == set(PHASES)
    compared = sorted(expected.keys() & found.keys())
    assert len(compared) > 500
    differences = []
    for key in compared:
        phase, name, field = key
        if KNOWN.keys() & {name, f"{name}.{field}", f"{phase}: {name}.{field}"}:
            continue
        if (phase == "circling" and turning(name, field)) or (phase == "climbing" and field in PASSING):
            continue
        a, b = median(expected[key]), median(found[key])
        units = dialect.by_name[name].by_name[field].units
        gap = angle_between(a, b, units)
        if gap > max(TOLERANCE.get(units, 3.0), max(abs(a), abs(b)) / 3):
            differences.append(f"{phase}: {name}.{field} is {b:g}, was {a:g} {units}")
    assert differences == []


def turning(name: str, field: str) -> bool:
    """On a circle these go all the way round: their medians say nothing."""
    return field in {
        "yaw",
        "hdg",
        "heading",
        "lat",
        "lon",
        "lng",
        "lat_int",
        "lon_int",
        "x",
        "y",
        "vx",
        "vy",
        "cog",
        "nav_bearing",
        "target_bearing",
        "xmag",
        "ymag",
        "zmag",
        "seq",
    }
