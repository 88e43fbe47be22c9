"""``zmav agent inject`` on a simulated hexarotor that EV1 flies."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from agents.controllers.cli.inject import respond
from agents.controllers.inject import Inject
from agents.controllers.response import StepResponse, picture
from zmav import wire
from zmav.errors import ZmavError

if TYPE_CHECKING:
    from pathlib import Path

    from tests.agents.controllers.conftest import Field

pytestmark = pytest.mark.asyncio(loop_scope="module")


@pytest.mark.alone  # of its 50 samples a second four in five must come
@pytest.mark.slow
async def test_a_step_up_is_flown_and_examined(field: Field, tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text("from agents.controllers.ev1 import Ev1\n\nclass Mine(Ev1):\n    pass\n")
    await field.supervise(file)
    args = Inject(kind="step", channel="z", amplitude=-1.0, seconds=6.0)
    with pytest.raises(ZmavError, match="engage"):
        await respond(field.z, "hex1", "mine", args)
    await field.vehicle.tell("mine", "engage")
    await field.vehicle.tell("mine", "goto", pos=[0.0, 0.0, -10.0])

    def rests(state: wire.VehicleState) -> bool:
        there, speed = state.local, state.velocity
        return there is not None and speed is not None and abs(there[2] + 10.0) < 0.1 and abs(speed[2]) < 0.05

    await field.wait_until(rests, 60.0)
    report = await respond(field.z, "hex1", "mine", args)
    found = report.found
    assert isinstance(found, StepResponse), report.notes
    assert found.final == pytest.approx(-1.0, abs=0.2), report.text()
    assert found.rise is not None and 0.1 < found.rise < 4.0, report.text()
    assert {"torque.x", "thrust"} <= report.outputs.keys()
    picture(report, tmp_path / "step.png")
