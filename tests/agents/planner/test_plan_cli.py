"""``zmav plan``: what it writes, says and refuses."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from click.testing import CliRunner, Result

from agents.planner.cli.agent import planner
from agents.planner.cli.plan import command, targets_of
from agents.planner.model import verify
from agents.planner.model.plans import Plan, read_plan
from agents.planner.model.scene import Scene, read_scene
from agents.planner.solve import jit, warm
from tests.agents.planner import checker
from tests.agents.planner.broken import CLOSED, broken
from tests.agents.planner.flights import straight_plan
from tests.agents.planner.generate import as_json, formation, swap_circle
from zmav.errors import BadConfig, BadInput


def zmav_plan(*args: object, ok: bool = True) -> Result:
    """Run it in this process; errors that the shell would print are raised."""
    result = CliRunner().invoke(command, [str(each) for each in args])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert (result.exit_code == 0) is ok, result.output
    return result


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    return write(tmp_path / "swap.json", as_json(swap_circle(6)))


def write(path: Path, body: dict[str, Any]) -> Path:
    path.write_text(json.dumps(body), encoding="utf-8")
    return path


@pytest.mark.parametrize("option", ["--margin", "--tracking", "--downwash", "--patience"])
@pytest.mark.parametrize("value", ["nan", "inf", "-1"])
def test_a_planner_is_set_up_by_numbers_in_their_ranges(option: str, value: str) -> None:
    done = CliRunner().invoke(planner, [option, value])
    assert (done.exit_code, f"Invalid value for '{option}'" in done.output) == (2, True), done.output


@pytest.mark.parametrize("option", ["--margin", "--seconds"])
@pytest.mark.parametrize("value", ["nan", "inf"])
def test_a_plan_is_asked_for_by_numbers(scene: Path, option: str, value: str) -> None:
    assert f"Invalid value for '{option}'" in zmav_plan(scene, option, value, ok=False).output


def test_a_plan_without_end_is_not_read_for_ever() -> None:
    with pytest.raises(BadInput, match="more than 1 MB"):
        read_plan("/dev/zero", largest=1 << 20)


def test_a_plan_is_written_shown_and_told(scene: Path, tmp_path: Path) -> None:
    plan, picture = tmp_path / "out.json", tmp_path / "out.png"
    done = zmav_plan(scene, "-o", plan, "--picture", picture)
    body = json.loads(plan.read_bytes())
    assert body["status"] == "ok"
    assert 0.0 < body["planning_time_s"] < 60.0
    assert checker.check(json.loads(scene.read_bytes()), body) == set()
    assert "swap: 6 vehicles, makespan " in done.stdout
    assert "× the bound" in done.stdout
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert {path.name for path in tmp_path.iterdir()} == {"swap.json", "out.json", "out.png"}
    assert "every rule is kept" in zmav_plan("--check", scene, plan).stdout


@pytest.mark.skipif(
    jit.interpreted() or jit.folder() is None or (os.cpu_count() or 1) < 2, reason="nothing is compiled beside"
)
def test_a_first_plan_does_not_wait_for_the_compiler(tmp_path: Path) -> None:
    """Here nothing is ever compiled: what would be is locked, and told to be there at the end."""
    kept, plans = tmp_path / cast(Path, jit.folder()).name, tmp_path / "plans"
    kept.mkdir()
    small = {"swap.json": swap_circle(3), "ring.json": formation(2)}
    scenes = [write(tmp_path / name, as_json(scene)) for name, scene in small.items()]
    command = [sys.executable, "-m", "zmav", "plan", *map(str, scenes), "-o", str(plans), "--json"]
    command += ["--picture", str(plans)]
    with contextlib.ExitStack() as held:
        for part in warm.PARTS:
            fcntl.flock(held.enter_context((kept / f"{part}.lock").open("w")), fcntl.LOCK_EX)
            held.callback((kept / f"{part}.done").touch)
        where = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
        done = subprocess.run(command, env=where, capture_output=True, text=True, timeout=100.0)
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("planned without compiled kernels") == len(scenes)
    assert [json.loads(line)["status"] for line in done.stdout.splitlines()] == ["ok", "ok"]
    for path in scenes:
        body = json.loads((plans / path.name).read_bytes())
        assert checker.check(json.loads(path.read_bytes()), body) == set()
        assert (plans / path.name).with_suffix(".png").exists()


def test_without_a_file_the_plan_goes_to_standard_output(scene: Path, tmp_path: Path) -> None:
    picture = tmp_path / "plan.png"
    done = zmav_plan(scene, "--picture", picture)
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert checker.check(json.loads(scene.read_bytes()), json.loads(done.stdout)) == set()
    assert "swap: 6 vehicles" in done.stderr
    again = zmav_plan(scene, "-o", "-", "--json", "--seed", 0)
    assert json.loads(again.stdout)["trajectories"] == json.loads(done.stdout)["trajectories"]
    assert json.loads(again.stderr)["vehicles"] == 6


def test_several_are_planned_and_the_broken_one_is_named(scene: Path, tmp_path: Path) -> None:
    bad = write(tmp_path / "bad.json", broken("goal in a box")[0])
    ring = write(tmp_path / "ring.json", as_json(formation(9)))
    plans, pictures = tmp_path / "plans", tmp_path / "pictures"
    done = zmav_plan(scene, bad, ring, "-o", plans, "--json", "--picture", pictures, ok=False)
    facts = [json.loads(line) for line in done.stdout.splitlines()]
    assert [(each["scene"], each["status"]) for each in facts] == [("swap", "ok"), ("bad", "error"), ("ring", "ok")]
    assert facts[0]["over_bound"] == pytest.approx(facts[0]["makespan"] / 9.9, rel=1e-3)
    assert facts[0]["clearance"] >= -0.01
    assert "zmav: bad: goal_in_obstacle (v002): the goal of v002 is inside box 0" in done.stderr
    body = json.loads((plans / "bad.json").read_bytes())
    assert body["status"] == "error"
    assert body["error"]["code"] == "goal_in_obstacle"
    assert body["error"]["ids"] == ["v002"]
    for path in (scene, ring):
        assert checker.check(json.loads(path.read_bytes()), json.loads((plans / path.name).read_bytes())) == set()
    assert sorted(path.name for path in pictures.iterdir()) == ["bad.png", "ring.png", "swap.png"]


@pytest.mark.usefixtures("hasty")
def test_walled_in_vehicles_are_all_named(tmp_path: Path) -> None:
    cases = {name.replace(" ", "_"): broken(name) for name in CLOSED}
    paths = [write(tmp_path / f"{name}.json", scene) for name, (scene, _, _) in cases.items()]
    zmav_plan(*paths, "-o", tmp_path / "plans", ok=False)
    for name, (_, code, ids) in cases.items():
        error = json.loads((tmp_path / "plans" / f"{name}.json").read_bytes())["error"]
        assert (error["code"], error["ids"]) == (code, ids)


def test_a_pipe_is_not_ended_before_the_plan_is_in_it(scene: Path, tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    assert targets_of((scene,), pipe) == [pipe]  # and does not wait for anyone to read


def test_one_that_fails_does_not_keep_others_from_being_planned(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, calls = verify.verify, []

    def first_fails(scene: Scene, *args: Any, **options: Any) -> verify.Report:
        calls.append(scene)
        report = real(scene, *args, **options)
        fault = verify.Fault("late", ("v000",), 0.0, 1.0, "v000 is late")
        return replace(report, faults=(fault,)) if len(calls) == 1 else report

    monkeypatch.setattr(verify, "verify", first_fails)
    monkeypatch.setattr("agents.planner.solve.pipeline.verify", real)
    again = write(tmp_path / "again.json", json.loads(scene.read_bytes()))
    done = zmav_plan(scene, again, "-o", tmp_path / "plans", ok=False)
    assert "does not keep the scene's rules: v000 is late" in done.stderr
    assert [path.name for path in (tmp_path / "plans").iterdir()] == ["again.json"]


def test_who_stays_has_a_piece_of_trajectory() -> None:
    made = Plan.of({"a": np.array([[0.0, 1.0, 2.0, 3.0]])})
    assert made.trajectories == {"a": [(0.0, 1.0, 2.0, 3.0), (0.1, 1.0, 2.0, 3.0)]}


def test_a_scene_without_a_plan_says_so(tmp_path: Path) -> None:
    done = zmav_plan(tmp_path / "none.json", ok=False)
    body = json.loads(done.stdout)
    assert (body["status"], body["error"]["code"]) == ("error", "invalid_scene")
    assert "cannot read" in body["error"]["message"]
    assert "zmav: none: invalid_scene: cannot read" in done.stderr


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["SCENE", "-o", "DIR/none/plan.json"], "cannot write .*No such file"),
        (["SCENE", "-o", "SCENE"], "is a scene: its plan must go elsewhere"),
        (["SCENE", "-o", "DIR"], "is a scene: its plan must go elsewhere"),
        (["SCENE", "SCENE"], "2 scenes need a folder"),
        (["SCENE", "SCENE", "-o", "DIR/plans"], "two scenes would both be planned into"),
        (["SCENE", "SCENE", "-o", "SCENE"], "cannot make the folder"),
        (["SCENE", "SCENE", "-o", "DIR/a/b/c"], "cannot make the folder"),
        (["SCENE", "--picture", "DIR/x.bmp"], "a picture's name ends in .png"),
        (["SCENE", "--picture", "DIR/none/x.png"], "cannot write"),
        (["SCENE", "--check"], "two files"),
        (["SCENE", "SCENE", "--check", "-o", "DIR/plan.json"], "nothing to write with -o"),
    ],
)
def test_what_cannot_be_written_is_refused_before_planning(
    args: list[str], words: str, scene: Path, tmp_path: Path
) -> None:
    before = scene.read_bytes()
    with pytest.raises(BadConfig, match=words):
        zmav_plan(*(each.replace("SCENE", str(scene)).replace("DIR", str(tmp_path)) for each in args))
    assert scene.read_bytes() == before


def test_plans_of_anyone_are_judged(scene: Path, tmp_path: Path) -> None:
    body = json.loads(scene.read_bytes())
    made = straight_plan(read_scene(scene))
    plan = write(tmp_path / "plan.json", {**made, "by": "somebody"})
    done = zmav_plan("--check", scene, plan, "--json", ok=False)
    facts = json.loads(done.stdout)
    assert facts["status"] == "faults"
    assert {fault["kind"] for fault in facts["faults"]} == {"separation"}
    named = {name for fault in facts["faults"] for name in fault["ids"]}
    assert named == {name for _, name in checker.check(body, made)} == {v["id"] for v in body["vehicles"]}
    assert "separation: v000 and v001 are 0.000 m apart" in zmav_plan("--check", scene, plan, ok=False).stdout

    write(plan, {"status": "error", "error": {"code": "timeout", "ids": [], "message": "late"}})
    with pytest.raises(BadInput, match="no plan but an error: timeout"):
        zmav_plan("--check", scene, plan)
    for text in ("", "{}", '{"status":"ok","trajectories":{"v000":[[0,1,2]]}}', '{"status":"ok","trajectories":[]}'):
        plan.write_text(text)
        with pytest.raises(BadInput, match="is no plan"):
            zmav_plan("--check", scene, plan)
    with pytest.raises(BadInput, match="cannot read"):
        zmav_plan("--check", scene, tmp_path / "none.json")


def test_a_missing_extra_is_named(scene: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "numba", None)
    with pytest.raises(BadConfig, match=r"needs numba: pip install 'zmav\[planner\]'"):
        zmav_plan(scene)


def test_a_broken_scene_waits_for_nothing_heavy(root: Path, tmp_path: Path) -> None:
    bad = write(tmp_path / "bad.json", broken("starts overlap")[0])
    code = (
        "import sys\nfrom agents.planner.cli.plan import command\n"
        f"try: command([{str(bad)!r}])\n"
        "except SystemExit as e: code = e.code\n"
        "heavy = {'numba', 'scipy', 'ompl', 'matplotlib', 'rerun', 'shapely'} & set(sys.modules)\n"
        "print(code, sorted(heavy), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True)
    assert done.stderr.splitlines()[-1] == "1 []", done.stderr
    assert json.loads(done.stdout)["error"]["ids"] == ["v000", "v001"]
