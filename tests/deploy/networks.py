"""The folders of ``deploy/wifi`` as a host gets them: which files, and which addresses result."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
WIFI = ROOT / "deploy" / "wifi"
LAYOUTS = sorted(path.parent.name for path in WIFI.glob("*/README.md"))
_ROW = re.compile(r"^\| ([\w ]+) \| (\w+) \| ([\d./]+) \| ([\w./ -]+) \|$", re.MULTILINE)

Entries = list[tuple[str, str, str]]
"""(section, key, value), in order"""


@dataclass(frozen=True)
class Row:
    """One line of a README's table of hosts."""

    host: str
    interface: str
    address: str
    folders: tuple[str, ...]


def rows(layout: str) -> list[Row]:
    """Who has which address and takes which folders, as the layout's README says."""
    text = (WIFI / layout / "README.md").read_text(encoding="utf-8")
    return [Row(host, interface, address, tuple(copy.split())) for host, interface, address, copy in _ROW.findall(text)]


def fleet_file(layout: str) -> Path:
    """The fleet file that the layout's README names."""
    text = (WIFI / layout / "README.md").read_text(encoding="utf-8")
    found = re.search(r"^Fleet file: \[[^]]*\]\(([^)]+)\)", text, re.MULTILINE)
    assert found, f"{layout}/README.md names no fleet file"
    return (WIFI / layout / found[1]).resolve()


def files(layout: str, folders: tuple[str, ...]) -> dict[str, Path]:
    """What a host has below /etc after it took the folders, one after the other: path there -> file here."""
    found: dict[str, Path] = {}
    for folder in folders:
        place = (WIFI / layout / folder).resolve()
        assert place.is_dir(), f"{layout}: no folder {folder}"
        found.update({str(path.relative_to(place)): path for path in sorted(place.rglob("*")) if path.is_file()})
    return found


def entries(path: Path) -> Entries:
    """A file of systemd's kind. Sections may come again, which :mod:`configparser` cannot say."""
    section, found = "", []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        if not line or line.startswith("#"):
            continue
        if header := re.fullmatch(r"\[(\w+)\]", line):
            section = header[1]
            continue
        key, equals, value = line.partition("=")
        assert section and equals and re.fullmatch(r"\w+", key), f"{path}:{number}: {line}"
        found.append((section, key, value))
    return found


def networkd(layout: str, folders: tuple[str, ...]) -> dict[str, Entries]:
    """What systemd-networkd makes of them: name of the main file -> its entries and those of its drop-ins."""
    found: dict[str, Entries] = {}
    for place, path in sorted(files(layout, folders).items()):
        if not place.startswith("systemd/network/"):
            continue
        name = place.removeprefix("systemd/network/").partition("/")[0]
        if name.endswith(".d"):
            name = name.removesuffix(".d")
            assert name in found, f"{layout}: {place} adds to no file"
        found.setdefault(name, []).extend(entries(path))
    return found


def values(of: Entries, section: str, key: str) -> list[str]:
    """All values of a key."""
    return [value for where, name, value in of if (where, name) == (section, key)]


def addresses(layout: str, folders: tuple[str, ...]) -> Iterator[tuple[str, str]]:
    """(interface, address) as networkd would set them; the first file that matches an interface has it."""
    for of in networkd(layout, folders).values():
        for address in values(of, "Network", "Address"):
            (names,) = values(of, "Match", "Name")
            (name,) = names.split()
            yield name, address
