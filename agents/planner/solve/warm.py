"""Make the planner ready: compile its kernels (once on a machine) and load them (once in a process).

A first plan would otherwise pay for that, part of a second each time and half a minute of a core the first time. The
kernels are compiled in parts, each by one process: two work side by side where there are two cores, and a third that
wants to plan meanwhile takes a share. Run as a program this is the second of them. A fleet's planner waits for all
parts (:func:`warm`), a plan from a file for those that nearly every plan needs (:func:`begin`): the second process goes
on with the rest.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from types import ModuleType
from typing import cast

import numpy as np

from agents.planner.execute.commit import Entry, Order, Part, Reserved
from agents.planner.execute.offset import Offset
from agents.planner.execute.track import Profile, Track
from agents.planner.model.deadline import Deadline
from agents.planner.model.geometry import world_of
from agents.planner.model.plans import Plan
from agents.planner.model.problem import PLANE, Motion, Path, Problem, problem_of
from agents.planner.model.scene import Bounds, Box, Cylinder, Fence, NoFly, Obstacle, Point, Scene, Vehicle
from agents.planner.model.staticmap import StaticMap
from agents.planner.model.verify import verify
from agents.planner.solve import jit
from agents.planner.solve.pipeline import ROOM, solve
from agents.planner.solve.planes import plan_planes
from agents.planner.solve.refine.flyable import refine_paths
from agents.planner.solve.spacetime import deconflict
from agents.planner.solve.spacetime.turns import stopping, turns_of

PATIENCE = 600.0
"""s, for a slow machine that compiles"""
EVERY = 2.0
"""s between two words on how far it is, where it has come further"""
_begun: dict[Sequence[str], subprocess.Popen[bytes]] = {}
"""processes that compile, by what they compile first"""
Tell = Callable[[int, int], None]
"""so many kernels are compiled, of so many"""


def warm(planes: bool = True, tell: Tell | None = None) -> Plan:
    """Plan small scenes that use the kernels; gives the plan of the first.

    ``planes``: those of planes, too. Where they are not all compiled yet, all of them are, also what few scenes need;
    ``tell`` hears of that, from another thread.
    """
    if not jit.compiled() and jit.folder() is not None:
        with _second(), _told(tell):
            compile_parts(PARTS, wait=False)
            compile_parts(PARTS, wait=True)
        jit.complete()
    plan = solve(example(planes=False), seconds=PATIENCE)
    _discrete()  # for scenes that are tighter than any that is small
    if planes:
        solve(example(planes=True), seconds=PATIENCE)
    return plan


def begin(planes: bool, tell: Tell | None = None) -> None:
    """Compile and load what a plan from a file needs at first; ``planes``, ``tell``: as in :func:`warm`.

    The rest is compiled in the background, also after this process has ended.
    """
    load_numba()
    if jit.folder() is None:  # what is needed later would be compiled in a plan's own time
        warm(planes)
        return
    if not jit.compiled():
        needed = _first(planes)
        many = (os.cpu_count() or 1) > 1
        with _told(tell):
            if many:
                _other(needed)
            compile_parts(needed, wait=False)
            compile_parts(needed, wait=True)
            if not many:
                _other(needed)
    solve(example(planes), seconds=PATIENCE)


def compile_beside(planes: bool, over: Callable[[], bool], tell: Tell | None = None) -> None:
    """Have another process compile what :func:`begin` does, until all of it is or it is ``over``, and load none of it
    here. It goes on in the background.
    """
    needed = _first(planes)
    _other(needed)
    with _told(tell):
        while not over() and not all(map(jit.done, needed)):
            time.sleep(0.05)


def load_numba() -> None:
    """Without SciPy's linear algebra and cffi's parser of C, which no kernel uses, and which it would load in a seventh
    and a twentieth of a second.
    """
    hidden = [name for name in ("scipy.linalg", "cffi") if name not in sys.modules]
    for name in hidden:
        sys.modules[name] = cast(ModuleType, None)  # what cannot be imported is done without
    try:
        importlib.import_module("numba.np.arraymath")
        importlib.import_module("numba.core.typing.cffi_utils")
    finally:
        for name in hidden:
            del sys.modules[name]


def compile_parts(names: Iterable[str], wait: bool) -> None:
    """Compile what no other process does; or (``wait``) wait until all of it is compiled."""
    for name in names:
        with jit.compiling(name, wait) as ours:
            if ours:
                PARTS[name]()


@contextlib.contextmanager
def _second() -> Iterator[None]:
    """A second process that takes its share. What it cannot do is done here."""
    if (os.cpu_count() or 1) < 2:
        yield
        return
    other = _other(FIRST)
    try:
        yield
    finally:
        other.kill()  # it has nothing left to do
        other.wait()


def _other(first: Sequence[str]) -> subprocess.Popen[bytes]:
    """A process that compiles what nobody else does until all is compiled, whatever becomes of this one."""
    if (before := _begun.get(first)) is not None and before.poll() is None:
        return before
    kept = jit.folder()
    assert kept is not None
    # Its folders are ours, wherever it is started.
    where = os.environ | {"NUMBA_CACHE_DIR": str(kept.parent.resolve())}
    command = [sys.executable, "-m", __spec__.name, *first]
    nothing, root = subprocess.DEVNULL, jit.PACKAGE.parents[1]
    _begun[first] = other = subprocess.Popen(
        command, cwd=root, env=where, stdin=nothing, stdout=nothing, stderr=nothing, start_new_session=True
    )
    return other


@contextlib.contextmanager
def _told(tell: Tell | None) -> Iterator[None]:
    if tell is None:
        yield
        return
    over = threading.Event()

    def go_on() -> None:
        before = (-1, -1)
        while not over.wait(EVERY):
            if (now := jit.progress()) != before:
                tell(*now)
            before = now

    thread = threading.Thread(target=go_on, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


# The parts, none of which calls another's kernels.


def _ways() -> None:
    problem, static = _known(example(planes=False))
    static.paths_for(problem, ROOM)


def _refined() -> None:
    problem, static = _known(example(planes=False))
    refine_paths(problem, static.world, _straight(problem), Deadline.after(PATIENCE))


def _discrete() -> None:
    problem, static = _known(lane())
    ways, until = _straight(problem), Deadline.after(PATIENCE)
    deconflict.find(problem, static.world, ways, until, np.random.default_rng(0))
    turns_of(problem, [stopping(problem, i, way) for i, way in enumerate(ways)], until)


def _judged() -> None:
    scene = example(planes=False)
    motions: dict[str, Motion] = {
        v.id: np.array([[0.0, *v.start], [60.0, *(v.goal or v.start)]], dtype=np.float64) for v in scene.vehicles
    }
    verify(scene, motions)


def _flown() -> None:
    flown({v.id: np.array([[0.0, *v.start], [60.0, *(v.goal or v.start)]]) for v in example(planes=False).vehicles})


def _shaped() -> None:
    from agents.planner.goals import moving, timing  # with them comes Shapely, which 'zmav plan' does without

    world = world_of(example(planes=False))
    moving.roomy(world, np.zeros((1, 1, 3)), np.ones(1))
    timing.paces(np.ones(2), np.ones((1, 1)), np.ones((1, 1)), np.ones((1, 1)), np.ones(1))


def _winged() -> None:
    problem, static = _known(example(planes=True))
    plan_planes(problem, static.world, np.flatnonzero(problem.kind == PLANE).tolist(), np.random.default_rng(0))


PARTS: Mapping[str, Callable[[], None]] = {
    "ways": _ways,
    "refined": _refined,
    "judged": _judged,
    "discrete": _discrete,
    "winged": _winged,
    "flown": _flown,
    "shaped": _shaped,
}
FIRST = ("ways", "refined", "judged")


def _first(planes: bool) -> Sequence[str]:
    return (*FIRST, "winged") if planes else FIRST


def _known(scene: Scene) -> tuple[Problem, StaticMap]:
    return problem_of(scene), StaticMap(world_of(scene))


def _straight(problem: Problem) -> list[Path]:
    return [np.array(ends, dtype=np.float64) for ends in zip(problem.start, problem.goal, strict=True)]


def flown(motions: Mapping[str, Motion]) -> None:
    """What the agent's own process calls when a plan is flown: it must not stop to compile then."""
    parts = []
    for name, motion in motions.items():
        part = Part(name, Track(motion), 1.0, 2.5, 0.3, Offset())
        row = np.array([0.0, *motion[0, 1:], 0.0, 0.0, 0.0])
        part.entries.append(Entry(Profile.resting(0.0, 1.0), np.array([row, row + np.eye(7)[0]]), 1.0, 1.0))
        parts.append(part)
    Order(parts, 1.5)
    for part in parts:
        Reserved(parts, 1.5).blocker(part, part.known, 0.0)


def copter(name: str, start: Point, goal: Point) -> Vehicle:
    return Vehicle(id=name, type="copter", start=start, goal=goal, radius=1.0, vmax=5.0, amax=2.5)


def lane() -> Scene:
    """Two that change places where there is room to pass only in one spot."""
    vehicles = [copter("a", (-20.0, 0.0, 5.0), (20.0, 0.0, 5.0)), copter("b", (20.0, 0.0, 5.0), (-20.0, 0.0, 5.0))]
    walls: list[Obstacle] = [
        Box(min=(x, y, 0.0), max=(x + 17.0, y + 8.0, 10.0)) for x in (-20.0, 3.0) for y in (-9.5, 1.5)
    ]
    bounds = Bounds(min=(-26.0, -8.0, 4.0), max=(26.0, 8.0, 6.0))
    return Scene(vehicles=vehicles, obstacles=walls, bounds=bounds, downwash=1.5)


def example(planes: bool) -> Scene:
    """Four copters among one of everything; or one, a rover, and two planes with a tower in their way."""
    vehicles = [
        copter(f"v{i}{k}", (20.0 * i, y, 10.0), (20.0 * i, -y, 10.0))
        for i in range(2)
        for k, y in enumerate((-15.0, 15.0))
    ]
    obstacles: list[Obstacle] = [
        Box(min=(-3.0, -2.0, 0.0), max=(3.0, 2.0, 30.0)),
        Cylinder(center=(20.0, 0.0), radius=3.0, floor=0.0, ceiling=30.0),
        NoFly(polygon=[(30.0, -5.0), (35.0, -5.0), (35.0, 5.0)], floor=0.0, ceiling=30.0),
    ]
    if planes:
        rover = Vehicle(
            id="r", type="rover", start=(-20.0, -20.0, 1.0), goal=(-20.0, 20.0, 1.0), radius=0.7, vmax=3.0, amax=1.5
        )
        wings = [
            Vehicle(
                id=f"p{k}",
                type="plane",
                start=(-150.0 * way, 0.0, 60.0),
                goal=(150.0 * way, 0.0, 60.0),
                radius=3.0,
                vmax=22.0,
                amax=5.0,
                vmin=12.0,
                start_heading_deg=20.0 + 180.0 * k,
            )
            for k, way in enumerate((1.0, -1.0))
        ]
        vehicles = [vehicles[0], rover, *wings]
        obstacles.append(Box(min=(-40.0, -90.0, 40.0), max=(40.0, 90.0, 90.0)))
    room = 200.0 if planes else 60.0
    fence = Fence(polygon=[(-room, -room), (room, -room), (room, room), (-room, room)], floor=0.5, ceiling=90.0)
    bounds = Bounds(min=(-room, -room, 0.0), max=(room, room, 90.0))
    return Scene(vehicles=vehicles, obstacles=obstacles, bounds=bounds, geofence=fence, downwash=1.5)


if __name__ == "__main__":
    compile_parts(sys.argv[1:], wait=False)
    with contextlib.suppress(OSError):
        os.nice(10)  # somebody plans already
    compile_parts(PARTS, wait=False)
    compile_parts(PARTS, wait=True)
    jit.complete()
