"""What the tests of external flight stacks share: plants, worlds, and programs that stand in for SITL."""

from __future__ import annotations

import stat
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from zmav.hil.craft import craft
from zmav.hil.externals import Externals
from zmav.hil.plant import Plant
from zmav.sim import VehicleSpec, World
from zmav.sim.environment import Environment
from zmav.sim.fleets.base import Surroundings

HERE = Path(__file__).resolve().parent


def plant(
    name: str = "quad",
    *,
    start: tuple[float, float, float] = (0.0, 0.0, 0.0),
    yaw: float = 0.0,
    wind: tuple[float, float, float] = (0.0, 0.0, 0.0),
    noise: str = "none",
) -> Plant:
    """One vehicle's body, with ideal sensors unless told otherwise."""
    around = Surroundings(environment=Environment(wind), seed=(1,), noise=noise)
    return Plant(craft(name), start, yaw, 1.0 / 400.0, around)


def hil_world(vehicles: Sequence[VehicleSpec], **options: Any) -> World:
    """A world that lets stacks outside the simulator fly."""
    return World(vehicles, externals=Externals, **options)


MakeWorld = Callable[..., World]


@pytest.fixture
def make_world() -> Iterator[MakeWorld]:
    """A world of these vehicles that runs in its thread; as fast as it goes unless told otherwise."""
    worlds = []

    def make(*vehicles: VehicleSpec, **options: Any) -> World:
        world = hil_world(vehicles, **{"speed": float("inf"), "epoch_s": 0.0, **options})
        worlds.append(world)
        world.start()
        return world

    yield make
    for world in worlds:
        world.close()


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A source tree whose SITL programs are the protocol peer of :mod:`tests.hil.json_peer`."""
    folder = tmp_path / "tree"
    for program in ("arducopter", "ardurover"):
        path = folder / "build/sitl/bin" / program
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f'#!/bin/sh\nexec {sys.executable} {HERE / "json_peer.py"} "$@"\n', encoding="utf-8")
        path.chmod(path.stat().st_mode | stat.S_IXUSR)
    (folder / "Tools/autotest/default_params").mkdir(parents=True)
    return folder


def peer_params(tree: Path, **values: float) -> None:
    """What the programs of ``tree`` find in their defaults file."""
    text = "".join(f"{name} {value}\n" for name, value in values.items())
    (tree / "Tools/autotest/default_params/copter.parm").write_text(text, encoding="ascii")
