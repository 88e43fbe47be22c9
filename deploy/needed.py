"""Print those lines of requirements.lock that zmav needs with some extras, hashes and all: for pip's --require-hashes.

    python deploy/needed.py [EXTRA...] > needed.txt
    python deploy/needed.py --only build > tools.txt        what an extra needs, and not zmav itself

It runs in an environment that has pip and nothing else, with Python 3.10 or newer. What a package is there for is what
the lock says behind 'via'; of a package that is there twice, for different Pythons, pip chooses by the markers.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

if sys.version_info >= (3, 11):
    import tomllib
else:
    from pip._vendor import tomli as tomllib

ROOT = Path(__file__).resolve().parent.parent
OURS, ONLY = "zmav", "--only"


def name_of(requirement: str) -> str:
    """The package's name, as the lock spells it."""
    return re.sub(r"[-_.]+", "-", re.split(r"[\s\[<>=!~;]", requirement, maxsplit=1)[0]).lower()


def wished(extras: Sequence[str], table: dict[str, list[str]]) -> set[str]:
    """The packages that zmav's extras ask for."""
    found: set[str] = set()
    for requirement in (each for extra in extras for each in table[extra]):
        inner = re.match(rf"{OURS}\[(.*)\]", requirement)
        found |= wished(inner[1].split(","), table) if inner else {name_of(requirement)}
    return found


def blocks(lock: str) -> Iterator[tuple[str, set[str], str]]:
    """Each package of the lock: its name, whom it is there for, and its lines."""
    for block in re.split(r"\n(?=[a-z0-9])", lock[lock.index("\n", lock.rindex("make lock")) :].lstrip("\n")):
        whom = re.findall(r"^    # +(?:via )?(\S+)", block, re.MULTILINE)
        yield name_of(block), {name_of(each) for each in whom} - {"via"}, block


def needed(lock: str, packages: set[str]) -> list[str]:
    """The lines of these packages and of all that they need."""
    found, everything = set(packages), list(blocks(lock))
    while more := {name for name, whom, _ in everything if whom & found} - found:
        found |= more
    return [block for name, _, block in everything if name in found]


def main(arguments: Sequence[str]) -> None:
    project: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    table = project["optional-dependencies"]
    extras = [each for each in arguments if each != ONLY]
    if unknown := set(extras) - set(table):
        sys.exit(f"zmav has no extra {', '.join(sorted(unknown))}; there are {', '.join(table)}")
    packages = wished(extras, table)
    if ONLY not in arguments:
        packages |= set(map(name_of, project["dependencies"]))
    lock = (ROOT / "requirements.lock").read_text(encoding="utf-8")
    print("\n".join(each.strip("\n") for each in needed(lock, packages)))


if __name__ == "__main__":
    main(sys.argv[1:])
