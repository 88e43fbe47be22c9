"""Who flies: the pilot, the controller while it keeps to the envelope, else the autopilot; on a simulated hexarotor."""

from __future__ import annotations

import asyncio
import contextlib
import math
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.agents.controllers.conftest import HOVER
from zmav import keys, wire
from zmav.client import Answer
from zmav.errors import BadInput, NoSuchVehicle, Refused, TimedOut
from zmav.sim import VehicleSpec
from zmav.sim.autopilots.px4.modes import POSCTL

if TYPE_CHECKING:
    from tests.agents.controllers.conftest import Field

pytestmark = pytest.mark.asyncio(loop_scope="module")
MINE = '''
import os, signal, time
import numpy as np
from agents.controllers import parameter
from agents.controllers.loops import AttitudeLoop

class Mine(AttitudeLoop):
    """Rates for the autopilot; breaks in the way it is told to."""

    fault = parameter(0.0, 0.0, 9.0, "", "how it breaks")
    kept = parameter(0.0, 0.0, 1.0)

    def update(self, state, reference):
        output = super().update(state, reference)
        if self.fault == 1:
            raise ValueError("planted")
        if self.fault == 2:
            time.sleep(600.0)
        if self.fault == 3:
            output.rates = output.rates * np.nan
        if self.fault == 4:
            os.kill(os.getpid(), signal.SIGKILL)
        if self.fault == 5:
            output.rates = output.rates + [8.0, 0.0, 0.0]
        if self.fault == 6:
            return "nothing"
        if self.fault == 7:
            output.rates = output.rates[:2]
        if self.fault == 8:
            raise SystemExit(0)
        self.signal(mine=self.fault)
        return output
'''
ARDUCOPTER = pytest.mark.parametrize("flying", [VehicleSpec(name="hex1")], indirect=True, scope="module")
FAULTS = {
    1: "planted",
    2: "no output for 25 cycles",
    3: "not finite",
    4: "signal 9",
    5: "tilt|turns at",
    6: "RatesThrust",
    7: "2 numbers",
    8: "process is gone",
}


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    path = tmp_path / "mine.py"
    path.write_text(MINE)
    return path


async def asked(field: Field, key: str) -> list[wire.TunableInfo]:
    answers = await field.z.ask(key)
    return [wire.decode(each.payload, wire.TunableInfo, "param") for each in answers if isinstance(each, Answer)]


async def test_it_takes_over_goes_where_it_is_told_and_hands_back(field: Field, mine: Path) -> None:
    supervisor = await field.supervise(mine)
    vehicle = field.vehicle
    with pytest.raises(Refused, match="not engaged"):
        await vehicle.tell("mine", "goto", pos=[3.0, 0.0, -10.0])
    await field.listen("mine")
    await vehicle.tell("mine", "engage")
    assert field.mode == "OFFBOARD"
    answer = await vehicle.tell("mine", "goto", pos=[2.5, -2.0, -11.0], yaw=1.0)
    await field.wait_until(lambda s: s.local is not None and math.dist(s.local, (2.5, -2.0, -11.0)) < 0.5, 30.0)
    assert answer["seconds"] > 2.0
    turned = await field.wait_until(lambda s: s.attitude is not None and abs(s.attitude.yaw - 1.0) < 0.1, 30.0)
    assert turned.lease is not None and turned.lease.holder == "mine"
    names = field.signals[-1].values.keys()
    wanted = {"is.x", "is.roll", "is.p", "ref.x", "ref.yaw", "out.rates.x", "out.thrust", "mine", "inject", "late"}
    assert wanted <= names
    result = await vehicle.tell("mine", "release")
    assert result["state"] == "autopilot"
    assert field.mode == "HOLD"
    await vehicle.wait_until(lambda s: s.lease is None, 10.0)
    assert supervisor.cycles.phase == 0
    # Its parameters are keys, within bounds.
    key = keys.AGENT_PARAM.key("demo", "hex1", agent="mine", param="fault")
    (info,) = await asked(field, key)
    assert (info.value, info.low, info.high) == (0.0, 0.0, 9.0)
    everything = await asked(field, keys.AGENT_PARAM.key("demo", "hex1", agent="mine", param="*"))
    assert len(everything) > 15
    with pytest.raises(BadInput, match="0 to 9"):
        await vehicle.tell("mine", "set", name="fault", value=10.0)
    with pytest.raises(BadInput, match="no parameter"):
        await vehicle.tell("mine", "set", name="nonsense", value=1.0)


@pytest.mark.slow
@pytest.mark.parametrize("faults", [tuple(FAULTS)[::2], tuple(FAULTS)[1::2]])
async def test_the_autopilot_has_it_back_whatever_the_controller_does(
    field: Field, mine: Path, faults: tuple[int, ...]
) -> None:
    supervisor = await field.supervise(mine)
    await field.vehicle.tell("mine", "engage")
    for fault in faults:
        supervisor.handed_back_ms, supervisor.why = None, ""
        await field.vehicle.tell("mine", "set", name="fault", value=fault)
        await field.until(lambda: field.mode == "HOLD", f"the autopilot has not got it after fault {fault}")
        await field.until(lambda: supervisor.handed_back_ms is not None, f"no word of fault {fault}")
        assert supervisor.cycles.phase == 0, fault
        assert re.search(FAULTS[fault], supervisor.why), (fault, supervisor.why)
        await field.vehicle.wait_until(lambda s: s.lease is None, 10.0)
        upright = lambda s: s.attitude is not None and abs(s.attitude.roll) + abs(s.attitude.pitch) < 0.2  # noqa: E731
        await field.wait_until(upright, 20.0)
        await field.until(lambda: supervisor.idle, f"fault {fault} is not over")
        # Mended, it can be had again.
        await field.vehicle.tell("mine", "set", name="fault", value=0.0)
        await field.vehicle.tell("mine", "engage")
        assert field.mode == "OFFBOARD", fault


async def test_the_pilots_switch_takes_it_and_so_does_a_mode_and_nobody_takes_it_back(field: Field, mine: Path) -> None:
    supervisor = await field.supervise(mine)
    await field.vehicle.tell("mine", "engage")
    px4 = field.world.vehicles[0].px4
    pilot = px4.pilot
    pilot.flip(7, 1900)
    await field.until(lambda: field.mode == "HOLD", "the autopilot has not got it")
    await field.until(lambda: supervisor.cycles.phase == 0, "outputs still go out")
    await field.until(lambda: supervisor.idle, "it is not over")
    with pytest.raises(Refused, match="pilot has it"):
        await field.vehicle.tell("mine", "engage")
    await field.vehicle.wait_until(lambda s: s.pilot is not None, 10.0)
    pilot.flip(7, 1000)
    await field.vehicle.wait_until(lambda s: s.pilot is None, 10.0)
    assert field.mode == "HOLD"
    supervisor.handed_back_ms = None
    await field.vehicle.tell("mine", "engage")
    assert field.mode == "OFFBOARD"
    assert field.world.call(lambda: px4.set_mode(POSCTL))
    await field.until(lambda: supervisor.cycles.phase == 0, "outputs still go out")
    await field.until(lambda: supervisor.handed_back_ms is not None, "no word of it")
    assert field.mode == "POSCTL", "it was taken from the pilot"


async def test_the_switch_turned_back_is_the_pilots_own_request(field: Field, mine: Path) -> None:
    supervisor = await field.supervise(mine, by_switch=True)
    pilot = field.world.vehicles[0].px4.pilot
    pilot.flip(7, 1900)
    await field.vehicle.wait_until(lambda s: s.pilot is not None, 10.0)
    pilot.flip(7, 1000)
    await field.until(lambda: supervisor.cycles.phase == 1, "it does not take over")
    assert field.mode == "OFFBOARD"


@pytest.mark.alone  # PX4 leaves OFFBOARD where setpoints pause, whatever else runs
async def test_a_saved_file_is_loaded_in_flight_and_a_broken_one_is_not(field: Field, mine: Path) -> None:
    supervisor = await field.supervise(mine)
    await field.listen("mine")
    await field.vehicle.tell("mine", "engage")
    await field.vehicle.tell("mine", "set", name="kept", value=0.5)
    mine.write_text(MINE.replace("mine=self.fault", "second=self.kept"))
    await field.until(lambda: bool(field.signals) and "second" in field.signals[-1].values, "it was not loaded again")
    assert supervisor.cycles.phase == 1
    assert field.mode == "OFFBOARD"
    assert field.signals[-1].values["second"] == 0.5, "its parameter did not go over"
    for text, where in (
        (MINE + "\n    def broken(:\n", "mine.py:34"),
        (MINE.replace("import numpy", "import nunpy"), "mine.py:3"),
    ):
        mine.write_text(text)
        await field.until(lambda: supervisor.reloader.broken != "", "it does not say that the file is broken")
        assert where in supervisor.reloader.broken
        assert supervisor.cycles.phase == 1
        mine.write_text(MINE)
        await field.until(lambda: supervisor.reloader.broken == "", "mended, it was not loaded")
    mine.write_text(MINE.replace("class Mine(AttitudeLoop):", "class Mine(AttitudeLoop):\n    gives = 'torque'"))
    await field.until(lambda: supervisor.reloader.broken != "", "it does not say that the file is broken")
    assert "gives" in supervisor.reloader.broken
    assert field.mode == "OFFBOARD"


async def test_the_class_in_the_documents_flies(field: Field, tmp_path: Path) -> None:
    page = (Path(__file__).parents[3] / "docs" / "controllers.md").read_text()
    path = tmp_path / "my_controller.py"
    path.write_text(page.partition("```python\n")[2].partition("```")[0])
    await field.supervise(path)
    await field.vehicle.tell("my_controller", "engage")
    await field.vehicle.tell("my_controller", "goto", pos=[2.0, 1.0, -10.5])
    await field.wait_until(lambda s: s.local is not None and math.dist(s.local, (2.0, 1.0, -10.5)) < 0.5, 30.0)
    assert field.mode == "OFFBOARD"


async def test_what_cannot_be_done_is_refused_with_the_reason(field: Field, tmp_path: Path) -> None:
    acro = tmp_path / "acro.py"
    acro.write_text("from agents.controllers.loops import PositionLoop\nclass P(PositionLoop):\n    'p'\n")
    await field.supervise(acro)
    vehicle = field.vehicle
    await vehicle.tell("acro", "engage")
    with pytest.raises(Refused, match="cannot follow attitude"):
        await vehicle.tell("acro", "sticks", level="attitude")
    with pytest.raises(BadInput, match="speed"):
        await vehicle.tell("acro", "goto", pos=[0.0, 0.0, -10.0], speed=-1.0)
    with pytest.raises(BadInput):
        await vehicle.tell("acro", "follow", segment=[{"t": 1.0, "pos": [0.0, 0.0, 0.0]}])
    with pytest.raises(BadInput):
        await vehicle.tell("acro", "inject", kind="step", channel="p", amplitude=1.0, seconds=1.0)
    assert field.mode == "OFFBOARD"


async def test_each_level_flies_alone(field: Field) -> None:
    for controller in ("ev1-rates", "ev1-attitude", "ev1-altitude", "ev1-velocity", "ev1-position", "ev1", "ev2"):
        await field.supervise(controller)
        await field.vehicle.tell(controller, "engage")
        assert field.mode == "OFFBOARD", controller
        await field.vehicle.tell(controller, "release")
        assert field.mode == "HOLD", controller
        await field.dismiss()


async def test_a_supervisor_that_dies_leaves_the_vehicle_holding(field: Field, mine: Path) -> None:
    """Its process is another one here: killed, it says nothing to anybody."""
    command = [sys.executable, "-m", "zmav", "agent", "run", str(mine), "--vehicle", "hex1", "-o", "rate_hz=100"]
    process = await asyncio.create_subprocess_exec(*command, "-e", field.endpoint)
    try:
        deadline = asyncio.get_running_loop().time() + 60.0
        while True:
            try:
                await field.vehicle.tell("mine", "engage")
                break
            except (NoSuchVehicle, Refused, TimedOut):
                assert asyncio.get_running_loop().time() < deadline, "it does not take over"
        assert field.mode == "OFFBOARD"
        process.kill()
        await field.until(lambda: field.mode == "HOLD", "the vehicle does not hold")
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        await process.wait()


@ARDUCOPTER
@pytest.mark.slow
async def test_arducopter_takes_attitudes_rates_and_velocities(field: Field) -> None:
    await field.vehicle.params.set("GUID_OPTIONS", 8.0)
    away = (2.0, 1.0, -10.5)
    for controller, place in (("ev1-velocity", away), ("ev1-attitude", HOVER), ("ev1-position", away)):
        await field.supervise(controller)
        await field.vehicle.tell(controller, "engage")
        await field.vehicle.tell(controller, "goto", pos=place)
        there = lambda s, place=place: s.local is not None and math.dist(s.local, place) < 0.7  # noqa: E731
        await field.wait_until(there, 40.0)
        await field.dismiss()


@ARDUCOPTER
@pytest.mark.parametrize(("controller", "why"), [("ev1", "takes no torques"), ("ev1-attitude", "GUID_OPTIONS")])
async def test_what_an_autopilot_cannot_take_is_refused_before_anything_flies(
    field: Field, controller: str, why: str
) -> None:
    await field.vehicle.params.set("GUID_OPTIONS", 0.0)
    supervisor = await field.supervise(controller)
    with pytest.raises(Refused, match=why):
        await field.vehicle.tell(controller, "engage")
    assert supervisor.cycles.phase == 0
    await field.vehicle.wait_until(lambda s: s.lease is None, 10.0)


@pytest.mark.parametrize("flying", [VehicleSpec(name="hex1", autopilot="px4", airframe="hexa")], indirect=True)
async def test_a_newer_px4_takes_rates_and_no_torques(field: Field) -> None:
    await field.supervise("ev1")
    with pytest.raises(Refused, match="takes no torques over MAVLink"):
        await field.vehicle.tell("ev1", "engage")
    await field.supervise("ev1-attitude")
    await field.vehicle.tell("ev1-attitude", "engage")
    assert field.mode == "OFFBOARD"
