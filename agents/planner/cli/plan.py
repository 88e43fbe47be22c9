"""``zmav plan``: from scene files to plan files."""

from __future__ import annotations

import errno
import importlib.util
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from agents.planner.cli.stages import Stages
from agents.planner.model.errors import PlanError
from zmav.cli.common import dump
from zmav.errors import BadConfig, BadInput, ZmavError

if TYPE_CHECKING:
    from agents.planner.cli.summary import Done

PICTURES = (".png", ".svg", ".pdf")


@dataclass(frozen=True)
class Wish:
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
    "--seconds", type=click.FloatRange(min=0.0, min_open=True), help="Search so long at most. [default: by N]"
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of what is drawn by lot.")
@click.option(
    "--margin",
    type=click.FloatRange(min=0.0),
    default=0.0,
    show_default=True,
    help="Metres that two vehicles keep on top of their radii.",
)
@click.option("--picture", type=click.Path(path_type=Path), metavar="FILE.png", help="Draw it from above and aside.")
@click.option("--json", "as_json", is_flag=True, help="Say how it went as JSON, one document a scene.")
def command(
    files: tuple[Path, ...],
    output: Path | None,
    check: bool,
    seconds: float | None,
    seed: int,
    margin: float,
    picture: Path | None,
    as_json: bool,
) -> None:
    """Plan the motion of a whole swarm: 'zmav plan scene.json -o plan.json'.

    Several scenes are planned one after another: 'zmav plan scenes/*.json -o plans'. What cannot be planned gets a plan
    file that says why, and the exit code is 1. docs/planner-files.md describes both kinds of file.
    """
    wish = Wish(seconds, seed, margin, picture, as_json)
    _check_extras(wish)
    if check:
        if len(files) != 2:
            text = "--check takes two files: SCENE.json PLAN.json"
            raise BadConfig(text, field="check", value=[str(f) for f in files], expected="two files")
        if output is not None:
            text = "--check plans nothing: there is nothing to write with -o"
            raise BadConfig(text, field="output", value=str(output), expected="no -o")
        _check_pictures([picture])
        sys.exit(_judge(files[0], files[1], wish))
    targets = targets_of(files, output)
    pictures = targets_of(files, picture, ".png") if picture else [None] * len(files)
    _check_pictures(pictures)
    failed = 0
    with Stages(quiet=as_json) as stages:
        for path, target, drawn in zip(files, targets, pictures, strict=True):
            failed += not _one(path, target, drawn, wish, stages, several=len(files) > 1)
    sys.exit(1 if failed else 0)


def _check_extras(wish: Wish) -> None:
    """Raises :class:`BadConfig` for what is not installed."""
    for module in ("numba", "ompl", "scipy", *(["matplotlib"] if wish.picture else [])):
        try:
            there = importlib.util.find_spec(module) is not None
        except ValueError:  # what the import system says of a module that is blocked
            there = False
        if not there:
            text = f"zmav plan needs {module}: pip install 'zmav[planner]'"
            raise BadConfig(text, field="zmav", value=module, expected="zmav[planner]")


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
        if not output.is_dir():
            try:
                output.mkdir()
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


def _check_pictures(pictures: Sequence[Path | None]) -> None:
    """Raises :class:`BadConfig` for a picture that cannot be written."""
    for picture in pictures:
        if picture is None:
            continue
        if picture.suffix not in PICTURES:
            text = f"a picture's name ends in {', '.join(PICTURES)}: not {picture.name!r}"
            raise BadConfig(text, field="picture", value=str(picture), expected=", ".join(PICTURES))
        _check_writable(picture)


def _one(path: Path, target: Path | None, drawn: Path | None, wish: Wish, stages: Stages, *, several: bool) -> bool:
    """Plan for one scene and write all that was asked for; whether there is a plan."""
    from agents.planner.cli.summary import facts, summary
    from agents.planner.model.plans import encode, write_plan

    try:
        done = _plan(path, wish, stages)
    except Exception as e:
        if not several:
            raise
        stages.end()
        text = str(e) if isinstance(e, ZmavError) else f"{path}: the planner failed: {type(e).__name__}: {e}"
        click.echo(f"zmav: {text}", err=True)  # the others are planned
        return False
    if target is None:
        click.echo(encode(done.plan), nl=False)
    else:
        write_plan(target, done.plan)
    ok = done.plan.status == "ok"
    if done.scene is not None and drawn is not None:
        from agents.planner.picture import draw

        draw(done.scene, done.plan, done.report, drawn)
    if wish.as_json:
        click.echo(dump(facts(done, target), pretty=False), err=target is None)
    elif ok:
        click.echo(summary(done), err=target is None)
    if not ok and done.plan.error is not None:
        error = done.plan.error
        who = f" ({', '.join(error.ids)})" if error.ids else ""
        click.echo(f"zmav: {done.name}: {error.code}{who}: {error.message}", err=True)
    return ok


def _plan(path: Path, wish: Wish, stages: Stages) -> Done:
    """Read, validate, solve, and verify what is going to be written once more."""
    from agents.planner.cli.summary import Done
    from agents.planner.model.plans import Plan
    from agents.planner.model.scene import read_scene
    from agents.planner.model.validate import validate

    stages.begin(path.stem)
    begun, scene, report = time.perf_counter(), None, None
    try:
        stages("read", 0.0)
        scene = read_scene(path)
        stages("validate", 0.0)
        validate(scene)
        stages("load", 0.0)
        _make_ready(any(v.type == "plane" for v in scene.vehicles), stages)
        from agents.planner.model.verify import verify
        from agents.planner.solve.pipeline import solve

        found = solve(scene, seconds=wish.seconds, seed=wish.seed, margin=wish.margin, progress=stages)
        plan = Plan.of(found.motions(), found.planning_time_s)
        report = verify(scene, plan.motions(), written=True)
        if not report.ok:
            raise ZmavError(f"{path}: a plan was found that does not keep the scene's rules: {report.faults[0]}")
    except PlanError as e:
        spent = time.perf_counter() - begun
        ready = sum(seconds for name, seconds in stages.end().items() if name in ("load", "warm up"))
        plan = Plan.failed(e, spent - ready)
    return Done(path.stem, scene, plan, report, stages.end())


def _make_ready(planes: bool, stages: Stages) -> None:
    """What a first plan in a process needs, out of its planning time."""
    from agents.planner.solve import jit, warm

    if planes in stages.ready or True in stages.ready:
        return
    if not jit.compiled():
        stages.say("compiling the planner for this machine, once: this takes a minute or so")
    warm.warm(planes, stages)
    stages.ready.add(planes)


def _judge(scene_file: Path, plan_file: Path, wish: Wish) -> int:
    """``--check``: 0 for a plan that keeps every rule."""
    from agents.planner.cli.summary import headline, quality
    from agents.planner.model.plans import read_plan
    from agents.planner.model.scene import read_scene
    from agents.planner.model.verify import verify

    scene, plan = read_scene(scene_file), read_plan(plan_file)
    if plan.status != "ok":
        code = plan.error.code if plan.error else "no reason"
        raise BadInput(f"{plan_file} is no plan but an error: {code}", field="plan", value=code, expected="status ok")
    report = verify(scene, plan.trajectories, written=True)
    if wish.as_json:
        found: dict[str, Any] = {"scene": scene_file.stem, "status": "ok" if report.ok else "faults"}
        found |= {"vehicles": len(scene.vehicles), **quality(scene, report)}
        found["faults"] = [asdict(fault) for fault in report.faults]
        click.echo(dump(found, pretty=False))
    elif report.ok:
        click.echo(f"{headline(scene_file.stem, scene, report)}: every rule is kept")
    else:
        for fault in report.faults:
            click.echo(f"{fault.kind}: {fault}")
        click.echo(f"zmav: {len(report.faults)} faults in {plan_file}", err=True)
    if wish.picture:
        from agents.planner.picture import draw

        draw(scene, plan, report, wish.picture)
    return 0 if report.ok else 1
