"""The ``[demo]`` table of a fleet file: what ``zmav demo`` does with that fleet, step by step.

[demo]
title = "Three hops"
needs = ["planner"]                  # extras; 'make demo' installs them
links = "line"                       # ground - first - second ...; or "star"
apart = 1.5                          # m that no two vehicles may come nearer than

[[demo.steps]]
say = "The planner runs on the ground."
start = "zmav swarm planner"         # runs beside the rest, until the demo ends

[[demo.steps]]
run = "zmav swarm takeoff 'quad*' --alt 12"

Each step is a verb as a person types it, a cut of the network, or a wait. ``{sim}``, ``{cameras}``, ``{here}`` and
``{out}`` in a verb are the simulator's control socket, where its pictures are served, the file's folder and the one of
the recording.
"""

from __future__ import annotations

import contextlib
import fnmatch
import importlib.util
import itertools
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from zmav.config import FleetConfig, load_fleet
from zmav.config.table import Positive, Table, reading
from zmav.errors import BadConfig, missing_extra
from zmav.shared import deploy

GROUND = "ground"
MODULES = {"interpreted": "ompl", "planner": "numba", "vision": "cv2"}
"""what is there with an extra alone"""
ACTS = ("run", "start", "stop", "join", "cut", "mend", "wait", "pause")
"""what a step can do"""
LOOSE = "--tracking 1 --margin 1.4"
"""how well a planner counts on real flight stacks: PX4 was up to 0.95 m off its trajectory in a wind of 3 m/s"""
Pair = tuple[str, str]
Seconds = Annotated[float, msgspec.Meta(gt=0.0, le=86_400.0)]


class Wait(Table, frozen=True):
    """Until all of this holds of all ``vehicles`` (patterns), as the ground hears it."""

    vehicles: tuple[str, ...] = ("*",)
    mode: list[str] | None = None
    """one of these, in any spelling"""
    armed: bool | None = None
    pilot: bool | None = None
    """the pilot's switch has it"""
    stale: bool | None = None
    """it is, or is not, out of the ground's hearing"""
    agent: str | None = None
    state: str | None = None
    """of ``agent``: what it says that it does"""


class Step(Table, frozen=True):
    """One of :data:`ACTS`, or words alone."""

    say: str | None = None
    run: str | None = None
    """a verb, to its end; where it fails, the demo has"""
    start: str | None = None
    """a verb that goes on until the demo ends"""
    stop: str | None = None
    """name of what was started: it is killed"""
    join: str | None = None
    """name of what was started and ends by itself: it is waited for"""
    cut: list[Pair] | None = None
    """links through which nothing passes from now on"""
    mend: list[Pair] | None = None
    wait: Wait | None = None
    pause: Seconds | None = None
    on: str = GROUND
    """whose router ``run`` and ``start`` use: the ground's, or that of a vehicle"""
    name: str | None = None
    """what a started verb is called; by default its words"""
    within: Seconds = 180.0
    until: str | None = None
    """words of what is started that are waited for"""
    ends: bool = False
    """what is started may end by itself before the demo does"""
    refused: bool = False
    """``run`` has to fail"""


class Story(Table, frozen=True):
    """The table."""

    title: str
    steps: list[Step]
    needs: tuple[Literal["interpreted", "planner", "vision"], ...] = ()
    """extras without which it cannot be flown"""
    links: Literal["line", "star"] = "star"
    """between routers: in a row from the ground on, or each vehicle's with the ground's"""
    apart: Positive | None = None
    """m between any two vehicles at least, by the simulator's truth"""
    ready: Seconds = 180.0
    """s for everybody to be there and ready"""


class Demo(msgspec.Struct, frozen=True):
    """A fleet file with its story."""

    path: Path
    fleet: FleetConfig
    story: Story

    @property
    def vehicles(self) -> list[str]:
        return list(self.fleet.vehicles)

    def links(self) -> list[Pair]:
        """Between routers, nearest the ground first; the second looks for the first."""
        if self.story.links == "star":
            return [(GROUND, name) for name in self.vehicles]
        return list(itertools.pairwise([GROUND, *self.vehicles]))

    def cuttable(self) -> set[frozenset[str]]:
        """The links that a step cuts."""
        return {frozenset(pair) for step in self.story.steps for pair in step.cut or ()}

    def relays(self, name: str) -> int:
        """How many other vehicles' routers lie between the ground and this one."""
        return 0 if self.story.links == "star" else self.vehicles.index(name)


def folder() -> Path | None:
    """Where the demo fleets are. None: it was installed without any."""
    with contextlib.suppress(BadConfig):
        return deploy() / "demos"
    return None


def demos() -> list[Demo]:
    """All those that come along, by name."""
    place = folder()
    paths = sorted(place.glob("*.toml")) if place else []
    return [load(path) for path in paths if load_fleet(path).demo]


def find(name: str) -> Demo:
    """By name or by the file's path. Raises :class:`BadConfig`, which names those there are."""
    if name.endswith(".toml"):
        return load(Path(name))
    place = folder()
    if place is not None and (place / f"{name}.toml").is_file():
        return load(place / f"{name}.toml")
    known = ", ".join(demo.path.stem for demo in demos()) or "none: give the path of a fleet file with a [demo] table"
    raise BadConfig(f"no demo is called {name!r}; there are {known}", field="name", value=name, expected=known)


def load(path: Path) -> Demo:
    """Raises :class:`BadConfig` that names the file, the field and what was expected."""
    fleet = load_fleet(path)
    with reading(path, "the demo"):
        if not fleet.demo:
            raise BadConfig("it has no table [demo]", field="demo", expected="a title and steps")
        try:
            story = msgspec.convert(fleet.demo, Story)
        except msgspec.ValidationError as e:
            text, _, where = str(e).partition(" - at `$")
            field = "demo" + where.strip("`")
            raise BadConfig(f"{text} (at {field})", field=field, expected=text) from None
        demo = Demo(path, fleet, story)
        _check(demo)
    return demo


def on_stacks(demo: Demo) -> Demo:
    """The same for real flight stacks: they boot for longer, follow their targets later and hold them less well in wind
    (docs/stacks.md), so that a planner gives them more room, and every step may take twice as long.
    """
    steps = [
        msgspec.structs.replace(
            step,
            within=2.0 * step.within,
            start=f"{step.start} {LOOSE}" if (step.start or "").startswith("zmav swarm planner") else step.start,
        )
        for step in demo.story.steps
    ]
    story = msgspec.structs.replace(demo.story, steps=steps, ready=2.0 * demo.story.ready)
    return msgspec.structs.replace(demo, story=story)


def check_extras(demo: Demo) -> None:
    """Raises :class:`BadConfig` that names the extra to install: before anything is started."""
    for need in demo.story.needs:
        if importlib.util.find_spec(MODULES[need]) is None:
            raise missing_extra(f"the demo {demo.path.stem}", MODULES[need], need)


def words(command: str) -> list[str]:
    """What stands behind ``zmav`` in a step's verb."""
    return shlex.split(command)[1:]


def matching(demo: Demo, patterns: Sequence[str]) -> list[str]:
    return [name for name in demo.vehicles if any(fnmatch.fnmatch(name, pattern) for pattern in patterns)]


def _check(demo: Demo) -> None:
    known = {GROUND, *demo.vehicles}
    linked = {frozenset(pair) for pair in demo.links()}
    started: set[str] = set()
    for i, step in enumerate(demo.story.steps):
        where = f"demo.steps[{i}]"
        acts = [act for act in ACTS if getattr(step, act) is not None]
        if len(acts) > 1 or not (acts or step.say):
            raise _bad(where, " and ".join(acts) or "nothing", f"one of {', '.join(ACTS)}, or words")
        for command in filter(None, (step.run, step.start)):
            if not command.startswith("zmav "):
                raise _bad(f"{where}.{acts[0]}", command, "zmav and a verb")
        if step.on not in known:
            raise _bad(f"{where}.on", step.on, f"one of {', '.join(sorted(known))}")
        for pair in (*(step.cut or ()), *(step.mend or ())):
            if frozenset(pair) not in linked:
                raise _bad(f"{where}.{acts[0]}", " - ".join(pair), "two names that are linked")
        if step.until is not None and step.start is None:
            raise _bad(f"{where}.until", step.until, "a step with start")
        if step.wait is not None and not matching(demo, step.wait.vehicles):
            raise _bad(f"{where}.wait.vehicles", step.wait.vehicles, f"some of {', '.join(demo.vehicles)}")
        if step.start is not None:
            started.add(called(step))
        for name in filter(None, (step.stop, step.join)):
            if name not in started:
                raise _bad(f"{where}.{acts[0]}", name, f"what was started: {', '.join(sorted(started)) or 'nothing'}")


def called(step: Step) -> str:
    """What a started verb's process is called."""
    return step.name or " ".join(words(step.start or "")[:3])


def _bad(field: str, value: object, expected: str) -> BadConfig:
    return BadConfig.wrong(field, value, expected, f"{field} is {value!r}")
