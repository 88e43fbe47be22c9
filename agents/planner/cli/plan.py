"""``zmav plan``: from scene files to plan files."""

from __future__ import annotations

import contextlib
import errno
import functools
import importlib.util
import math
import os
import pickle
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click
import msgspec

from agents.planner.model.errors import PlanError
from agents.planner.model.plans import Plan, encode, read_plan, write_plan
from agents.planner.model.scene import Scene, read_scene
from agents.planner.model.validate import validate
from agents.planner.solve.bound import least_makespan
from zmav.cli.common import Between, dump
from zmav.errors import BadConfig, BadInput, ZmavError, missing_extra

if TYPE_CHECKING:
    from agents.planner.model.verify import Report  # with it comes numba, which a refusal need not wait for

PICTURES = (".png", ".svg", ".pdf")
INTERPRETS_S = 10.0
"""s that a first plan on a machine may take without compiled kernels, before these are waited for"""


@dataclass(frozen=True)
class Request:
    """What is asked for beside the plans."""

    seconds: float | None = None
    seed: int = 0
    margin: float = 0.0
    picture: Path | None = None
    """a file, or a folder where there are several scenes"""
    as_json: bool = False


@click.command("plan")
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="SCENE.json...")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, allow_dash=True),
    metavar="PLAN.json",
    help="Where the plan goes: a file, a folder, or - (standard output, the default).",
)
@click.option("--check", is_flag=True, help="Plan nothing: judge a plan, with SCENE.json PLAN.json.")
@click.option(
    "--seconds",
    type=Between(min=0.0, min_open=True),
    help="Of the processor, to search at most; by the clock four times as long. [default: by N]",
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of what is drawn by lot.")
@click.option(
    "--margin",
    type=Between(min=0.0),
    default=0.0,
    show_default=True,
    help="Metres that two vehicles keep on top of their radii.",
)
@click.option("--picture", type=click.Path(path_type=Path), metavar="FILE.png", help="Draw it from above and aside.")
@click.option("--json", "as_json", is_flag=True, help="Say how it went as JSON, one document a scene.")
def command(files: tuple[Path, ...], output: Path | None, check: bool, **asked: Any) -> None:
    """Plan the motion of a whole swarm: 'zmav plan scene.json -o plan.json'.

    Several scenes are planned one after another: 'zmav plan scenes/*.json -o plans'. What cannot be planned gets a plan
    file that says why, and the exit code is 1. docs/planner-files.md describes both kinds of file.
    """
    request = Request(**asked)
    _check_extras(request)
    if check:
        if len(files) != 2:
            text = "--check takes two files: SCENE.json PLAN.json"
            raise BadConfig(text, field="check", value=[str(f) for f in files], expected="two files")
        if output is not None:
            text = "--check plans nothing: there is nothing to write with -o"
            raise BadConfig(text, field="output", value=str(output), expected="no -o")
        _check_picture(request.picture)
        sys.exit(_judge(files[0], files[1], request))
    targets = targets_of(files, output)
    pictures = targets_of(files, request.picture, ".png") if request.picture else [None] * len(files)
    for picture in pictures:
        _check_picture(picture)
    several = len(files) > 1
    done = [_one(*each, request, several) for each in zip(files, targets, pictures, strict=True)]
    sys.exit(0 if all(done) else 1)


def _check_extras(request: Request) -> None:
    """Raises :class:`BadConfig` for what is not installed."""
    for module in ("numba", "ompl", "scipy", *(["matplotlib"] if request.picture else [])):
        try:
            there = importlib.util.find_spec(module) is not None
        except ValueError:  # what the import system says of a module that is blocked
            there = False
        if not there:
            raise missing_extra("zmav plan", module, "planner")


def targets_of(files: tuple[Path, ...], output: Path | None, suffix: str = ".json") -> list[Path | None]:
    """Where each scene's plan goes (None: standard output), all of it writable.

    Raises :class:`BadConfig` before anything is planned for what cannot be written, and for what would be
    overwritten: a scene, or another scene's plan.
    """
    if output is None or str(output) == "-":
        if len(files) > 1:
            text = f"{len(files)} scenes need a folder for their plans: -o DIR"
            raise BadConfig(text, field="output", value=len(files), expected="-o DIR")
        return [None]
    found: list[Path] = [output]
    if len(files) > 1 or output.is_dir():
        try:
            output.mkdir(exist_ok=True)
        except OSError as e:
            text = f"cannot make the folder {output} for {len(files)} plans: {e.strerror}"
            raise BadConfig(text, field="output", value=str(output), expected="a folder") from e
        found = [output / f"{path.stem}{suffix}" for path in files]
    for target in found:
        _check_writable(target)
        if any(target.exists() and path.exists() and target.samefile(path) for path in files):
            text = f"{target} is a scene: its plan must go elsewhere"
            raise BadConfig(text, field="output", value=str(target), expected="another file or folder")
        if found.count(target) > 1:
            text = f"two scenes would both be planned into {target}"
            raise BadConfig(text, field="output", value=str(target), expected="scenes of different names")
    return list(found)


def _check_writable(target: Path) -> None:
    try:
        if target.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        if target.exists() and not target.is_file():  # a device, or a pipe: opened to try, it would end for its reader
            if not os.access(target, os.W_OK):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        else:
            with tempfile.TemporaryFile(dir=target.parent):
                pass
    except OSError as e:
        text = f"cannot write {target}: {e.strerror}"
        raise BadConfig(text, field="output", value=str(target), expected="a file that can be written") from e


def _check_picture(picture: Path | None) -> None:
    """Raises :class:`BadConfig` for a picture that cannot be written."""
    if picture is not None:
        if picture.suffix not in PICTURES:
            text = f"a picture's name ends in {', '.join(PICTURES)}: not {picture.name!r}"
            raise BadConfig(text, field="picture", value=str(picture), expected=", ".join(PICTURES))
        _check_writable(picture)


def _one(path: Path, target: Path | None, drawn: Path | None, request: Request, several: bool) -> bool:
    """Plan for one scene and write all that was asked for; whether there is a plan."""
    try:
        scene, plan, report = _plan(path, request)
    except Exception as e:
        if not several:
            raise
        text = str(e) if isinstance(e, ZmavError) else f"{path}: the planner failed: {type(e).__name__}: {e}"
        click.echo(f"zmav: {text}", err=True)  # the others are planned
        return False
    if target is None:
        click.echo(encode(plan), nl=False)
    else:
        write_plan(target, plan)
    if scene is not None and drawn is not None:
        from agents.planner.picture import draw

        draw(scene, plan, report, drawn)
    if request.as_json:
        click.echo(dump(_facts(path.stem, scene, plan, report, target), pretty=False), err=target is None)
    elif scene is not None and report is not None:
        words = f"{_headline(path.stem, scene, report)}, planned in {plan.planning_time_s or 0.0:.2f} s"
        click.echo(words, err=target is None)
    if plan.error is not None:
        who = f" ({', '.join(plan.error.ids)})" if plan.error.ids else ""
        click.echo(f"zmav: {path.stem}: {plan.error.code}{who}: {plan.error.message}", err=True)
    return plan.status == "ok"


def _plan(path: Path, request: Request) -> tuple[Scene | None, Plan, Report | None]:
    """Read, validate, solve, and verify what is going to be written once more."""
    begun, scene = time.perf_counter(), None
    try:
        scene = read_scene(path)
        validate(scene)
        if (found := _interpreted(scene, request)) is None:
            _make_ready(_has_planes(scene))
            begun = time.perf_counter()
            found = _solved(scene, request)
        plan, report = found
        if not report.ok:
            raise ZmavError(f"{path}: a plan was found that does not keep the scene's rules: {report.faults[0]}")
    except PlanError as e:
        return scene, Plan.failed(e, time.perf_counter() - begun), None
    return scene, plan, report


def _solved(scene: Scene, request: Request) -> tuple[Plan, Report]:
    from agents.planner.model.verify import verify
    from agents.planner.solve.pipeline import solve

    plan = solve(scene, seconds=request.seconds, seed=request.seed, margin=request.margin)
    return plan, verify(scene, plan.motions(), written=True)


def _has_planes(scene: Scene) -> bool:
    return any(vehicle.type == "plane" for vehicle in scene.vehicles)


def _interpreted(scene: Scene, request: Request) -> tuple[Plan, Report] | None:
    """Where the kernels are not compiled yet: the plan of a process that interprets them, while another one compiles
    them. None: it had none within :data:`INTERPRETS_S`, and compiled kernels are to be waited for.
    """
    from agents.planner.solve import jit, warm
    from zmav import guard

    if _make_ready.cache_info().currsize or jit.compiled() or jit.folder() is None or (os.cpu_count() or 1) < 2:
        return None
    root, environment = jit.PACKAGE.parents[1], os.environ | {"NUMBA_DISABLE_JIT": "1"}
    keep = [sys.executable, "-I", "-S", guard.__file__, str(os.getpid())]
    command, nothing = [*keep, sys.executable, "-m", __name__], subprocess.DEVNULL
    with contextlib.suppress(OSError), tempfile.TemporaryFile() as answer:  # no room, or it died
        child = subprocess.Popen(
            command, cwd=root, env=environment, stdin=subprocess.PIPE, stdout=answer, stderr=nothing
        )
        try:
            assert child.stdin is not None
            pickle.dump((scene, request), child.stdin)
            child.stdin.flush()
            until = time.monotonic() + INTERPRETS_S
            warm.compile_beside(_has_planes(scene), lambda: child.poll() is not None or time.monotonic() > until, _tell)
            if child.poll() == 0:
                click.echo("planned without compiled kernels; they are compiled in the background", err=True)
                answer.seek(0)
                return cast(tuple[Plan, "Report"], pickle.load(answer))
        finally:
            child.kill()
            child.wait()
    return None


def _interpret() -> None:
    """The child of :func:`_interpreted`: a scene in by standard input, its plan out by standard output. Where there is
    none it ends with the error.
    """
    with os.fdopen(os.dup(1), "wb") as answer:
        os.dup2(2, 1)  # for what libraries print
        pickle.dump(_solved(*pickle.load(sys.stdin.buffer)), answer)


@functools.cache
def _make_ready(planes: bool) -> None:
    """What a first plan in a process needs, out of its planning time."""
    from agents.planner.solve import jit, warm

    if not jit.compiled() and jit.folder() is None:
        click.echo(f"compiling the planner {jit.NOT_KEPT}", err=True)
    elif not jit.compiled():
        _tell(*jit.progress())
    if not jit.interpreted():
        warm.begin(planes, _tell)


def _tell(done: int, of: int) -> None:
    click.echo(f"compiling the planner for this machine, once: {done} of {of} kernels", err=True)


def _judge(scene_file: Path, plan_file: Path, request: Request) -> int:
    """``--check``: 0 for a plan that keeps every rule."""
    from agents.planner.model.verify import verify

    scene, plan = read_scene(scene_file), read_plan(plan_file)
    if plan.status != "ok":
        code = plan.error.code if plan.error else "no reason"
        raise BadInput(f"{plan_file} is no plan but an error: {code}", field="plan", value=code, expected="status ok")
    report = verify(scene, plan.trajectories, written=True)
    if request.as_json:
        found: dict[str, Any] = {"scene": scene_file.stem, "status": "ok" if report.ok else "faults"}
        found |= {"vehicles": len(scene.vehicles), **_quality(scene, report)}
        found["faults"] = [asdict(fault) for fault in report.faults]
        click.echo(dump(found, pretty=False))
    elif report.ok:
        click.echo(f"{_headline(scene_file.stem, scene, report)}: every rule is kept")
    else:
        for fault in report.faults:
            click.echo(f"{fault.kind}: {fault}")
        click.echo(f"zmav: {len(report.faults)} faults in {plan_file}", err=True)
    if request.picture:
        from agents.planner.picture import draw

        draw(scene, plan, report, request.picture)
    return 0 if report.ok else 1


def _quality(scene: Scene, report: Report) -> dict[str, Any]:
    """How good a plan is: s, m and shares; None where there is nothing to measure."""
    bound, closest, near = least_makespan(scene), report.closest, report.obstacle_clearance
    return {
        "makespan": report.makespan,
        "over_bound": round(report.makespan / bound, 4) if bound else None,
        "clearance": None if closest is None else round(closest.clearance, 4),
        "closest": None if closest is None else [*closest.ids, round(closest.time, 3)],
        "obstacle_clearance": round(near, 4) if math.isfinite(near) else None,
    }


def _facts(name: str, scene: Scene | None, plan: Plan, report: Report | None, target: Path | None) -> dict[str, Any]:
    """How planning went, for a script."""
    found: dict[str, Any] = {"scene": name, "status": plan.status, "vehicles": len(scene.vehicles) if scene else None}
    if scene is not None and report is not None:
        found |= _quality(scene, report)
    found["planning_time_s"] = None if plan.planning_time_s is None else round(plan.planning_time_s, 4)
    if plan.error is not None:
        found["error"] = msgspec.to_builtins(plan.error)
    return found | {"output": None if target is None else str(target)}


def _headline(name: str, scene: Scene, report: Report) -> str:
    """What a plan is worth, for a person."""
    found = _quality(scene, report)
    over = f" ({found['over_bound']:.2f} × the bound)" if found["over_bound"] else ""
    words = [f"{name}: {len(scene.vehicles)} vehicles, makespan {found['makespan']:.1f} s{over}"]
    if found["closest"]:
        one, other, when = found["closest"]
        words.append(f"clearance {found['clearance']:.2f} m ({one}, {other} at {when:.1f} s)")
    if found["obstacle_clearance"] is not None:
        words.append(f"{found['obstacle_clearance']:.2f} m from obstacles")
    return ", ".join(words)


if __name__ == "__main__":
    _interpret()
