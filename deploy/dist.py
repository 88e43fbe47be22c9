"""Build the wheel and the sdist, twice to the same bytes, and try the wheel in empty environments: ``make dist``.

    python deploy/dist.py [--out dist] [--python python3.12]...    else every Python from 3.10 to 3.13 here

Then dist/ has both, their sums, and a bill of materials (deploy/sbom.py). What is tried: zmav's verbs and entry points
load, its data files are there, and the tree that 'zmav install' lays out builds the very same wheel. Packages come by
the hashes of requirements.lock.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PYTHONS = ("python3.10", "python3.11", "python3.12", "python3.13")
DATA = (
    "ground/http/static/index.html",
    "ground/http/static/vendor/leaflet.js",
    "ground/http/static/vendor/leaflet.LICENSE",
    "ground/matlab/zmav_open.m",
    "ground/matlab/private",
    "zmav/py.typed",
    "share/zmav/deploy/install.sh",
    "share/zmav/deploy/demos/line.toml",
    "share/zmav/requirements.lock",
    "licenses/LICENSE",
)
"""parts of names that a wheel has"""
TRY = """
import importlib.metadata, subprocess, sys
from zmav.errors import ZmavError
loaded = needed = 0
for group in ("zmav.verbs", "zmav.agents", "zmav.agent.verbs", "zmav.controllers"):
    for point in importlib.metadata.entry_points(group=group):
        try:
            point.load()
            loaded += 1
        except ModuleNotFoundError as e:
            assert not (e.name or "").startswith(("zmav", "agents", "mesh", "ground")), (point, e)
            needed += 1
from agents.demo.story import demos
assert demos(), "no demo fleets"
print(f"{loaded} entry points load, {needed} need an extra's package; {len(demos())} demo fleets")
"""


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--out", type=Path, default=ROOT / "dist")
    options.add_argument("--python", action="append", default=[])
    chosen = options.parse_args()
    with tempfile.TemporaryDirectory(prefix="zmav-dist-") as scratch:
        made = build_twice(ROOT, Path(scratch))
        wheel = next(path for path in made if path.suffix == ".whl")
        check_contents(wheel)
        pythons = chosen.python or [each for each in PYTHONS if runs(each)]
        for python in pythons:
            try_wheel(wheel, python, Path(scratch) / python.replace("/", "_"))
        chosen.out.mkdir(exist_ok=True)
        for path in made:
            shutil.copy2(path, chosen.out / path.name)
    run(sys.executable, ROOT / "deploy" / "sbom.py", "--out", chosen.out / "sbom.json")
    names = [*(path.name for path in made), "sbom.json"]
    sums = [f"{digest(chosen.out / name)}  {name}\n" for name in names]
    (chosen.out / "SHA256SUMS").write_text("".join(sums), encoding="utf-8")
    print("".join(sums), end="")


def build_twice(tree: Path, scratch: Path) -> list[Path]:
    """The sdist, and the wheel that it builds; ends where the tree, built again or by the sdist, gives other bytes."""
    first, second = (build(tree, scratch / name, "sdist", "wheel") for name in ("first", "second"))
    for one, other in zip(first, second, strict=True):
        same(one, other, "built twice")
    sdist, wheel = sorted(first, key=lambda path: path.suffix == ".whl")
    run(sys.executable, "-m", "tarfile", "-e", sdist, scratch / "unpacked")
    (unpacked,) = (scratch / "unpacked").iterdir()
    (again,) = build(unpacked, scratch / "third", "wheel")
    same(wheel, again, "built from the sdist")
    return [sdist, wheel]


def build(tree: Path, out: Path, *targets: str) -> list[Path]:
    """By hatchling itself, whose dates are fixed: what is here changes none of it, nor does the time."""
    how = [f"--target={target}" for target in targets]
    epoch = {"SOURCE_DATE_EPOCH": "1577836800"}  # 2020-01-01, as hatchling's own
    run(sys.executable, "-m", "hatchling", "build", *how, "--directory", out, cwd=tree, environment=epoch)
    return sorted(out.iterdir())


def check_contents(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    for part in DATA:
        if not any(part in name for name in names):
            sys.exit(f"{wheel.name} lacks {part}")
    if odd := [name for name in names if "__pycache__" in name or name.startswith(("tests/", "deploy/"))]:
        sys.exit(f"{wheel.name} should not have {odd[:3]}")


def try_wheel(wheel: Path, python: str, folder: Path) -> None:
    """In an environment of that Python with the core's packages and nothing else."""
    print(f"==> {wheel.name} with {python}", flush=True)
    run(python, "-m", "venv", folder)
    inside, pip = (
        folder / "bin" / "python",
        ("-m", "pip", "--disable-pip-version-check", "--quiet", "install", "--no-compile"),
    )
    lines = subprocess.run([python, ROOT / "deploy" / "needed.py"], check=True, capture_output=True, text=True).stdout
    needed = folder / "needed.txt"
    needed.write_text(lines, encoding="utf-8")
    run(inside, *pip, "--require-hashes", "--only-binary", ":all:", "-r", needed)
    run(inside, *pip, "--no-deps", "--no-index", wheel)
    run(inside, "-I", "-m", "pip", "--disable-pip-version-check", "check")
    for arguments in (("--version", "--json"), ("--help",), ("demo", "--list"), ("up", "--help"), ("sim", "--help")):
        run(folder / "bin" / "zmav", *arguments, cwd=Path("/"))
    run(inside, "-I", "-c", TRY, cwd=folder)
    tree = folder / "tree"
    run(
        inside,
        "-I",
        "-c",
        "import sys, pathlib; from zmav.cli.install import lay_out; lay_out(pathlib.Path(sys.argv[1]))",
        tree,
    )
    (again,) = build(tree, folder / "made", "wheel")
    same(wheel, again, "built as 'zmav install' does")


def same(one: Path, other: Path, how: str) -> None:
    if digest(one) != digest(other):
        sys.exit(f"{one.name}: {how}, it has other bytes ({one} and {other})")


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def runs(python: str) -> bool:
    found = shutil.which(python)
    return found is not None and subprocess.run([found, "-c", ""], capture_output=True, check=False).returncode == 0


def run(*command: str | Path, cwd: Path | None = None, environment: dict[str, str] | None = None) -> None:
    """Ends this where it does not succeed; what it said is seen then."""
    plain = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "PYTHONHOME")}
    done = subprocess.run(
        command, cwd=cwd, env=plain | (environment or {}), check=False, capture_output=True, text=True
    )
    if done.returncode != 0:
        sys.exit(f"{' '.join(map(str, command))}\n{done.stdout}{done.stderr}")


if __name__ == "__main__":
    main()
