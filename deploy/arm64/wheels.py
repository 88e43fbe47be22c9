"""Print a table of the wheels that there are for ARM, of what requirements.lock says zmav and its agents need.

    python deploy/arm64/wheels.py [EXTRA...]     (default: planner vision ground)

It asks pip, which asks the index that it is set to: nothing is installed, and of each package only the file's name and
metadata are fetched. A file counts only where the lock has its hash, as 'make' and deploy/install.sh take no other.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from pip._vendor.packaging.markers import Marker, default_environment
from pip._vendor.packaging.utils import parse_wheel_filename

FOLDER = Path(__file__).resolve().parent
EXTRAS = ("planner", "vision", "ground")
PYTHONS = ("3.11", "3.13")
"""Debian 12's and 13's, which Raspberry Pi OS has, too"""
GLIBC = range(17, 37)
"""2.17 (manylinux2014) to Debian 12's 2.36"""
MACHINES = ("aarch64", "armv7l")
NONE = "**none**"


def lines(*arguments: str) -> dict[str, str]:
    """The lock's block of each package that zmav needs with these extras."""
    command = [sys.executable, str(FOLDER.parent / "needed.py"), *arguments]
    text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    blocks = re.split(r"\n(?=[a-z0-9])", text.strip())
    return {block.split(" \\\n", 1)[0]: block for block in blocks}


def is_for(head: str, python: str, machine: str) -> bool:
    """Whether a line's marker holds there; pip would ask it of the Python that it runs in."""
    marker = head.partition(" ; ")[2]
    there = {"python_version": python, "python_full_version": f"{python}.0", "platform_machine": machine}
    return not marker or Marker(marker).evaluate({**default_environment(), **there})


def found(blocks: dict[str, str], python: str, machine: str) -> dict[str, str]:
    """The wheel of each package that has one there: its file's name."""
    left = {re.split("[=;]", head)[0]: block for head, block in blocks.items() if is_for(head, python, machine)}
    platforms = [f"--platform=manylinux_2_{minor}_{machine}" for minor in reversed(GLIBC)]
    platforms += [f"--platform=manylinux2014_{machine}", f"--platform=linux_{machine}"]
    with tempfile.TemporaryDirectory() as folder:
        asked = Path(folder) / "asked.txt"
        pip = [sys.executable, "-m", "pip", "--quiet", "--no-input", "install", "--dry-run", "--ignore-installed"]
        pip += [
            "--ignore-requires-python",
            "--no-deps",
            "--only-binary=:all:",
            "--require-hashes",
            "--target",
            folder,
            "--report=-",
        ]
        pip += [f"--python-version={python}", "--implementation=cp", *platforms, "-r", str(asked)]
        while True:
            # Without the marker, which was asked above; nor may pip ask whether the packages are for its own Python.
            asked.write_text("\n".join(re.sub(r" ; .*(?= \\)", "", each, count=1) for each in left.values()))
            done = subprocess.run(pip, capture_output=True, text=True, check=False)
            if done.returncode == 0:
                break
            missing = re.search(r"No matching distribution found for ([\w.-]+)==", done.stderr)
            if missing is None or left.pop(missing[1], None) is None:
                sys.exit(f"pip, for Python {python} on {machine}: {done.stderr}")
    files = [Path(each["download_info"]["url"]).name for each in json.loads(done.stdout)["install"]]
    return {parse_wheel_filename(file)[0]: file for file in files}


def tell(file: str | None, wanted: bool) -> str:
    """A table's cell: for which Python and from which C library on it is, or that it is for any machine."""
    if file is None or not wanted:
        return NONE if wanted else "–"
    minors = [int(each) for each in re.findall(r"manylinux_2_(\d+)", file)]
    tags = file.removesuffix(".whl").split("-")[-3:]
    if tags[-1] == "any":
        return "any"
    return f"{tags[0]}{'-abi3' if 'abi3' in tags[1] else ''}, glibc 2.{min(minors) if minors else 17}"


def main(arguments: Sequence[str]) -> None:
    extras = arguments or EXTRAS
    core = lines()
    by_extra = {extra: set(lines(extra)) - set(core) for extra in extras}
    blocks = lines(*extras)
    places = [(python, machine) for machine in MACHINES for python in PYTHONS]
    wheels = {place: found(blocks, *place) for place in places}
    rows: dict[str, list[str]] = {}
    whom: dict[str, str] = {}
    for head in sorted(blocks):
        name, version = re.split("[=; ]+", head)[:2]
        cells = [tell(wheels[place].get(name), is_for(head, *place)) for place in places]
        if all(cell == "–" for cell in cells):
            continue
        rows[f"{name} {version}"] = cells
        whom[f"{name} {version}"] = ", ".join(each for each in extras if head in by_extra[each]) or "core"
    plain = [name for name, cells in rows.items() if set(cells) <= {"any", "–"}]
    print(f"| package | for | {' | '.join(f'{machine}, {python}' for python, machine in places)} |")
    print("|---|---|" + "---|" * len(places))
    for name in [each for each in rows if each not in plain]:
        print(f"| {name} | {whom[name]} | {' | '.join(rows[name])} |")
    print(f"\nFor any machine ({len(plain)}): {', '.join(plain)}.")


if __name__ == "__main__":
    main(sys.argv[1:])
