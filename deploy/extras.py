"""Try each extra of the wheel by itself: ``python deploy/extras.py dist/zmav-0.2.0-py3-none-any.whl [EXTRA...]``.

It takes minutes, and needs the network. Each gets an empty environment with the packages that requirements.lock has for
it, the wheel with that extra, for which pip may look nowhere else, and does what it promises: all modules of its
packages load, and something small is done.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parent))
import dist
import needed

SCENE = """{"format": "swarm-scene/1", "name": "two", "bounds": {"min": [-30, -30, 0], "max": [30, 30, 40]},
 "downwash": 1.5, "goal_tolerance": 0.5, "vehicles": [
 {"id": "a", "type": "copter", "radius": 1, "vmax": 5, "amax": 2.5, "start": [-20, 0, 10], "goal": [20, 0, 10]},
 {"id": "b", "type": "copter", "radius": 1, "vmax": 5, "amax": 2.5, "start": [20, 0, 10], "goal": [-20, 0, 10]}]}"""
LOAD = """
import importlib, pkgutil, sys
for name in sys.argv[1:]:
    package = importlib.import_module(name)
    for each in pkgutil.walk_packages(getattr(package, "__path__", []), name + "."):
        if not each.name.endswith("__main__"):
            importlib.import_module(each.name)
"""
SEE = """
import numpy
from agents.helipad.detector import Detector
from zmav.vision.opencv import decode, encode
assert decode(encode(numpy.zeros((48, 64, 3), numpy.uint8), 80)).shape == (48, 64, 3)
Detector(numpy.array([[500.0, 0, 32], [0, 500, 24], [0, 0, 1]]))
"""
DRAW = """
import pathlib, rerun
rerun.init("try")
rerun.save("try.rrd")
rerun.log("try", rerun.Points3D([[0, 0, 0]]))
rerun.disconnect()
assert pathlib.Path("try.rrd").stat().st_size
"""
LAY = """
import numpy, pathlib, rasterio
from ground.http.geotiff import lay
from zmav.errors import BadConfig
with rasterio.open("try.tif", "w", driver="GTiff", width=4, height=4, count=1, dtype="uint8") as made:
    made.write(numpy.zeros((1, 4, 4), dtype="uint8"))
try:
    lay(pathlib.Path("try.tif"))
except BadConfig as e:  # it was read, and says no place
    assert e.detail["field"] == "picture", e
"""
HEIGHTS = """
import numpy, pathlib, rasterio
from zmav.formats.tiles import Raster
form = dict(driver="GTiff", width=9, height=9, count=1, dtype="float32", crs="EPSG:4326")
with rasterio.open("try.tif", "w", transform=rasterio.transform.from_origin(8.0, 48.0, 0.1, 0.1), **form) as made:
    made.write(numpy.full((9, 9), 400.0, "float32"), 1)
assert Raster(pathlib.Path("try.tif")).piece("N47E008-30-30") is not None
"""
BUILD = """
import pathlib, subprocess, sys
lines = ["[build-system]", 'requires = ["hatchling"]', 'build-backend = "hatchling.build"']
lines += ["[project]", 'name = "tried"', 'version = "1"']
pathlib.Path("pyproject.toml").write_text(chr(10).join(lines))
pathlib.Path("tried.py").write_text("")
subprocess.run([sys.executable, "-m", "hatchling", "build", "-t", "wheel"], check=True)
"""


class Promise(NamedTuple):
    """What an extra is for: the packages of zmav that load with it, what it does, by which program, and where."""

    packages: tuple[str, ...] = ()
    code: str = ""
    command: tuple[str, ...] = ()
    environment: tuple[tuple[str, str], ...] = ()


PROMISES = {
    "planner": Promise(
        ("agents.planner",), command=("zmav", "plan", "scene.json", "--picture", "a.png", "-o", "a.json")
    ),
    "vision": Promise(("agents.helipad", "agents.camera", "zmav.vision", "zmav.sim.camera"), SEE),
    "viz": Promise(("ground.view",), DRAW),
    "ground": Promise(("ground.http", "ground.record")),
    "geotiff": Promise(("ground.http.geotiff",), LAY),
    "terrain": Promise(("zmav.formats.tiles",), HEIGHTS),
    "ros2": Promise(("ground.ros2",)),
    "video": Promise(("agents.camera",), "import av, aiortc; av.CodecContext.create('h264', 'r')"),
    "rtk": Promise(("ground.rtk",)),
    "traffic": Promise(("ground.traffic", "ground.tak"), "import pytak"),
    "interpreted": Promise(("agents.planner",), environment=(("NUMBA_DISABLE_JIT", "1"),)),  # as --interpret has it
    "build": Promise(code=BUILD),
    "site": Promise(command=("mkdocs", "--version")),
    "all": Promise(("zmav", "mesh", "agents", "ground")),
    "dev": Promise(("zmav", "mesh", "agents", "ground"), command=("pytest", "--version")),
}
"""by the extras of pyproject.toml, in their order"""


def attempt(wheel: Path, extra: str, folder: Path) -> None:
    """Ends this where it does not do what it promises."""
    promise = PROMISES[extra]
    inside = folder / "bin" / "python"
    dist.run(sys.executable, "-m", "venv", folder)
    pip = (inside, "-m", "pip", "--disable-pip-version-check", "--quiet", "install", "--no-compile")
    lines = subprocess.run([sys.executable, needed.__file__, extra], check=True, capture_output=True, text=True).stdout
    (folder / "needed.txt").write_text(lines, encoding="utf-8")
    (folder / "scene.json").write_text(SCENE, encoding="utf-8")
    dist.run(*pip, "--require-hashes", "--only-binary", ":all:", "-r", folder / "needed.txt")
    dist.run(*pip, "--no-index", f"{wheel}[{extra}]")
    dist.run(inside, "-I", "-m", "pip", "--disable-pip-version-check", "check")
    own = {"XDG_CACHE_HOME": str(folder / "cache"), **dict(promise.environment)}
    dist.run(inside, "-I", "-c", LOAD, *promise.packages, cwd=folder, environment=own)
    dist.run(inside, "-I", "-c", promise.code, cwd=folder, environment=own)
    if promise.command:
        dist.run(folder / "bin" / promise.command[0], *promise.command[1:], cwd=folder, environment=own)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("wheel", type=Path)
    options.add_argument("extra", nargs="*")
    chosen = options.parse_args()
    if unknown := set(chosen.extra) - set(PROMISES):
        options.error(f"no extra {', '.join(sorted(unknown))}; there are {', '.join(PROMISES)}")
    for extra in chosen.extra or PROMISES:
        begun = time.monotonic()
        with tempfile.TemporaryDirectory(prefix=f"zmav-{extra}-") as folder:
            attempt(chosen.wheel.resolve(), extra, Path(folder))
            used = subprocess.run(["du", "-sm", folder], check=True, capture_output=True, text=True).stdout.split()[0]
        print(f"{extra:12} {used:>5} MB  {time.monotonic() - begun:4.0f} s  does what it promises", flush=True)


if __name__ == "__main__":
    main()
