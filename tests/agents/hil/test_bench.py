"""The bench: a PX4 on a pseudo-terminal (see :mod:`.board` for what that proves), and an ArduPilot that simulates."""

from __future__ import annotations

import functools
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from agents.hil import checkflight
from agents.hil.bench import bench, judge_loop
from agents.hil.flight import HOVERS
from agents.hil.report import Report, find
from tests.agents.hil.conftest import FLEET, HOME, MakeBoard
from zmav.errors import BadConfig
from zmav.sim import VehicleSpec, World
from zmav.sim.status import HilLoop

PATIENCE_S = 60.0


def kept(folder: Path, name: str = "px1") -> Report:
    found = find(folder, name, "bench")
    assert found is not None
    return found


@pytest.mark.alone
@pytest.mark.slow
async def test_a_px4_flies_every_check_through_its_line(fleet: Path, tmp_path: Path, make_board: MakeBoard) -> None:
    board = make_board(speed=3.0)
    assert await bench(fleet, "px1", tmp_path, str(board.link)) == 0
    report = kept(tmp_path)
    assert report.passed and len(report.proof) == 2 and report.identity is not None
    assert {*HOVERS, "SYS_HITL", "loop", "link"} <= {check.name for check in report.checks}
    assert board.readings > 1000
    assert not board.world.status().vehicles[0].armed


async def test_a_px4_that_is_not_in_hitl_is_told_how(fleet: Path, tmp_path: Path, make_board: MakeBoard) -> None:
    board = make_board(hitl=0)
    assert await bench(fleet, "px1", tmp_path, str(board.link)) == 1
    assert "SYS_HITL is 0: set it to 1" in kept(tmp_path).checks[-1].found
    assert board.readings == 0


async def test_a_px4_whose_flag_does_not_follow_is_not_armed(
    fleet: Path, tmp_path: Path, make_board: MakeBoard, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SYS_HITL is 1, but its HEARTBEAT never says HIL: it was not rebooted since that was set."""
    monkeypatch.setattr("agents.hil.bench.HIL_S", 3.0)
    board = make_board(hitl=0, SYS_HITL=1.0)
    assert await bench(fleet, "px1", tmp_path, str(board.link)) == 1
    checks = kept(tmp_path).checks
    assert "did not go to HIL" in checks[-1].found
    assert board.readings == 0 and not board.world.status().vehicles[0].armed


@contextmanager
def ardupilot(path: Path, **params: float) -> Iterator[World]:
    """An ArduCopter on a pseudo-terminal, which simulates on board as far as its parameters show."""
    spec = VehicleSpec(endpoints=(f"pty:{path}",), params=params)
    with World([spec], home=HOME, speed=1.0) as world:
        yield world


async def test_an_ardupilot_that_drives_outputs_is_not_armed(fleet: Path, tmp_path: Path) -> None:
    device = tmp_path / "ttyACM0"
    with ardupilot(device, SIM_OH_MASK=15.0) as world:
        assert await bench(fleet, "quad1", tmp_path, str(device)) == 1
        assert "it drives real outputs" in kept(tmp_path, "quad1").checks[-1].found
        assert not world.status().vehicles[0].armed


async def test_another_autopilot_than_the_fleet_file_s_is_not_found(
    fleet: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checkflight, "FOUND_S", 3.0)
    fleet.write_text(FLEET.replace("sysid = 1", "sysid = 7"), encoding="utf-8")
    device = tmp_path / "ttyACM0"
    with ardupilot(device):
        assert await bench(fleet, "quad1", tmp_path, str(device)) == 1
    assert "not heard: an autopilot with system id 7" in kept(tmp_path, "quad1").checks[-1].found


async def test_a_device_that_cannot_be_is_said_before_anything_runs(fleet: Path, tmp_path: Path) -> None:
    with pytest.raises(BadConfig, match="is not there: is it plugged in"):
        await bench(fleet, "px1", tmp_path, str(tmp_path / "ttyACM7"))
    (tmp_path / "file").touch()
    with pytest.raises(BadConfig, match="is not a serial port"):
        await bench(fleet, "px1", tmp_path, str(tmp_path / "file"))


@contextmanager
def running(fleet: Path, folder: Path, device: Path, name: str) -> Iterator[subprocess.Popen[str]]:
    """``zmav hil bench`` as the process it is, until it says that the vehicle is armed."""
    code = "from agents.hil.cli import hil; hil()"
    words = ["--file", str(fleet), "--name", name, "--device", str(device), "--reports", str(folder), "--props-off"]
    process = subprocess.Popen(
        [sys.executable, "-c", code, "bench", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    try:
        assert process.stdout is not None
        said = []
        for line in process.stdout:
            said.append(line)
            if " arm:" in line:
                break
        else:
            raise AssertionError("".join(said))
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


def children(pid: int) -> list[str]:
    path = Path(f"/proc/{pid}/task/{pid}/children")
    if not path.exists():
        pytest.skip("this system does not tell a process's children")
    return path.read_text().split()


def test_ctrl_c_in_flight_disarms_it_and_leaves_nobody_behind(fleet: Path, tmp_path: Path) -> None:
    device = tmp_path / "ttyACM0"
    with ardupilot(device) as world, running(fleet, tmp_path, device, "quad1") as process:
        assert world.status().vehicles[0].armed
        others = children(process.pid)
        assert others
        process.send_signal(signal.SIGINT)
        process.send_signal(signal.SIGINT)  # an impatient one ends nothing sooner
        said, _ = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 130, said
        assert not world.status().vehicles[0].armed
        assert not [pid for pid in others if Path(f"/proc/{pid}").exists()]
    checks = kept(tmp_path, "quad1").checks
    assert [check.name for check in checks[-2:]] == ["disarmed", "stage"]
    assert checks[-1].found == "it was interrupted"


def test_unplugged_in_flight_it_says_that_it_may_be_armed(fleet: Path, tmp_path: Path, make_board: MakeBoard) -> None:
    board = make_board()
    with running(fleet, tmp_path, board.link, "px1") as process:
        board.unplug()
        said, _ = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 1, said
    assert "cannot be reached (was it unplugged?): take its power off before you touch it" in said


def test_the_loop_is_judged_by_its_figures() -> None:
    start, judge = HilLoop(0, 0, 0, 0, 0.0), functools.partial(judge_loop, least_share=0.5, least_speed=0.98)
    good = judge(start, HilLoop(2500, 2490, 0, 0, 0.02), 10.0, 1.0)
    assert good.status == "ok" and good.found.startswith("250.0 readings/s sent, 249.0 controls/s heard")
    for last, speed in (
        (HilLoop(2500, 1000, 0, 0, 0.02), 1.0),
        (HilLoop(2500, 2490, 100, 0, 0.02), 1.0),
        (HilLoop(2500, 2490, 0, 0, 0.02), 0.9),
        (HilLoop(0, 0, 0, 0, 0.0), 1.0),
    ):
        assert judge(start, last, 10.0, speed).status == "BAD"
