"""The table of faults, what is said of bad words, and ``zmav sim fault`` to a simulator that runs."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from tests.sim.conftest import MakeGcs
from zmav.cli.sim.talk import fault
from zmav.errors import BadInput
from zmav.sim import VehicleSpec, World
from zmav.sim.faults import KINDS, Fault, make_fault
from zmav.sim.faults.body import BatteryCollapse, MotorFailure
from zmav.sim.faults.links import LinkLoss
from zmav.sim.faults.sensors import CompassError, GpsGlitch
from zmav.sim.faults.table import values_from_words
from zmav.sim.listener import Listener
from zmav.sim.remote import Remote, control_path

PATIENCE_S = 30.0


def fault_from_words(kind: str, words: list[str]) -> Fault:
    return make_fault(kind, values_from_words(words))


class TestTable:
    def test_every_kind_can_be_made_without_words(self) -> None:
        for kind in KINDS:
            assert kind == make_fault(kind, {}).KIND

    def test_words(self) -> None:
        assert fault_from_words("gps-glitch", ["north=-20.5", "up=3"]) == GpsGlitch(north=-20.5, up=3.0)
        assert fault_from_words("compass", ["lost=yes"]) == CompassError(lost=True)
        assert fault_from_words("motor", ["number=3", "efficiency=0.5"]) == MotorFailure(number=3, efficiency=0.5)
        assert fault_from_words("battery", ["left-percent=5"]) == BatteryCollapse(left_percent=5.0)
        assert fault_from_words("link-loss", ["percent=5", "direction=up"]) == LinkLoss(percent=5.0, direction="up")

    @pytest.mark.parametrize(
        ("kind", "words", "field", "said"),
        [
            ("gremlins", [], "kind", "no fault 'gremlins'; there are link-cut, link-loss"),
            ("gps-glitch", ["west=5"], "west", "has no parameter 'west'; it has north, east, up"),
            ("gps-glitch", ["north=far"], "north", "north is 'far'; expected -100000 to 100000"),
            ("gps-glitch", ["north=nan"], "north", "expected -100000 to 100000"),
            ("gps-glitch", ["north"], "parameter", "'north' is no parameter; expected NAME=VALUE"),
            ("link-loss", ["percent=101"], "percent", "percent is 101; expected 0 to 100"),
            ("link-loss", ["direction=left"], "direction", "expected both, down, up"),
            ("motor", ["number=1.5"], "number", "expected 1 to 32"),
            ("gps-loss", ["north=1"], "north", "it has none"),
        ],
    )
    def test_bad_words_are_named(self, kind: str, words: list[str], field: str, said: str) -> None:
        with pytest.raises(BadInput) as refused:
            fault_from_words(kind, words)
        assert said in str(refused.value)
        assert refused.value.detail["field"] == field


class TestWorld:
    def test_faults_are_listed_and_end_by_themselves(self, make_gcs: MakeGcs) -> None:
        world = make_gcs(2).world
        world.fault("quad1", "gps-loss", for_s=1.0)
        world.fault("quad2", "compass", degrees=5)
        first, second = world.faults()
        assert (first.vehicle, first.kind, first.until_s) == ("quad1", "gps-loss", 1.0)
        assert second.parameters == {"degrees": 5.0, "lost": False}
        assert [v.faults for v in world.status().vehicles] == [("gps-loss",), ("compass",)]
        world.step(1.1)
        assert [each.kind for each in world.faults()] == ["compass"]
        assert world.vehicles[0].node.seat.fix().fix_type == 3

    def test_all_of_them_and_one_in_the_place_of_another(self, make_gcs: MakeGcs) -> None:
        world = make_gcs(3).world
        assert [each.vehicle for each in world.fault("all", "gps-glitch", north=10.0)] == [
            "quad1",
            "quad2",
            "quad3",
        ]
        world.fault("quad2", "gps-glitch", north=20.0)
        assert world.vehicles[1].node.seat.fix().north == 20.0
        assert world.clear(kind="gps-glitch", vehicle="quad2") == 1
        assert world.vehicles[1].node.seat.fix().north == 0.0
        assert world.clear(kind="motor") == 0
        assert world.clear() == 2
        assert world.faults() == []

    def test_what_cannot_be_is_said(self, make_gcs: MakeGcs) -> None:
        world = make_gcs().world
        with pytest.raises(BadInput, match="no vehicle 'quad9'; there are quad1"):
            world.fault("quad9", "gps-loss")
        with pytest.raises(BadInput, match="expected more than 0"):
            world.fault("quad1", "gps-loss", for_s=0.0)
        with pytest.raises(BadInput, match="has no camera"):
            world.fault("quad1", "camera-blackout")
        with pytest.raises(BadInput, match="no fault 'x'"):
            world.clear("quad1", "x")
        assert world.faults() == []

    def test_what_one_cannot_have_none_gets_and_what_was_on_stays(self, make_gcs: MakeGcs) -> None:
        world = make_gcs([VehicleSpec(), VehicleSpec(autopilot="arduplane")]).world
        world.fault("quad1", "motor", number=4)
        with pytest.raises(BadInput, match="plane1 has no motor 2; expected 1 to 1"):
            world.fault("all", "motor", number=2)
        with pytest.raises(BadInput, match="quad1 has no motor 5"):
            world.fault("quad1", "motor", number=5)
        assert [(f.vehicle, f.parameters["number"]) for f in world.faults()] == [("quad1", 4)]
        assert world.vehicles[0].node.seat.fleet.efficiency[:, 0].tolist() == [1.0, 1.0, 1.0, 0.0]


@pytest.fixture
def running(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[World]:
    """Two copters that run as ``zmav sim`` has them."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    world = World([VehicleSpec(endpoints=()), VehicleSpec(endpoints=())], ready_s=0.5, speed=10.0)
    listener = Listener(control_path("faults"), world)
    thread = threading.Thread(target=world.run)
    thread.start()
    yield world
    world.stop()
    thread.join(PATIENCE_S)
    listener.close()
    world.close()


def run(*words: str) -> Any:
    return CliRunner().invoke(fault, list(words))


class TestCommandLine:
    def test_from_putting_it_on_to_clearing_it(self, running: World) -> None:
        assert run().output == "no faults\n"
        put = run("quad2", "gps-glitch", "north=12", "--for", "1000")
        assert put.exit_code == 0, put.output
        assert put.output.startswith("quad2: gps-glitch north=12.0 east=0.0 up=0.0, since ")
        (found,) = json.loads(run("--json").output)
        assert (found["vehicle"], found["parameters"]["north"]) == ("quad2", 12.0)
        assert found["until_s"] - found["since_s"] == pytest.approx(1000.0)
        assert run("quad2", "--clear").output == "1 cleared\n"
        assert run("all", "gps-loss").exit_code == 0
        assert run("--clear").output == "2 cleared\n"
        with Remote() as sim:
            assert sim.faults() == []
            assert [each.kind for each in sim.fault("quad1", "motor", number=2, for_s=5.0)] == ["motor"]
            assert sim.clear("quad1", "motor") == 1

    @pytest.mark.parametrize(
        ("words", "said"),
        [
            (["quad7", "gps-loss"], "no vehicle 'quad7'; there are quad1, quad2"),
            (["quad1", "gps"], "no fault 'gps'"),
            (["quad1"], "which fault? There are link-cut, "),
            (["quad1", "motor", "number=9"], "no motor 9; expected 1 to 4"),
            (["quad1", "gps-loss", "--for", "-1"], "expected more than 0"),
            (["quad1", "gps-loss", "x=1", "--clear"], "takes no parameters"),
        ],
    )
    def test_what_is_wrong_is_said(self, running: World, words: list[str], said: str) -> None:
        result = run(*words)
        assert result.exit_code != 0
        assert said in str(result.exception)
        assert run().output == "no faults\n"
