"""A bill of materials of what zmav is made of, as CycloneDX 1.6 JSON: ``python deploy/sbom.py [--out sbom.json]``.

Packages are those of requirements.lock, with the hashes that it has of their files, and what they are there for;
licences are what their own metadata says where they are installed here. What is vendored is what the manifests of the
page's libraries and of ROS's interfaces say. Source: https://cyclonedx.org/docs/1.6/json/.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import json
import re
import sys
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))
import needed

ROOT = needed.ROOT
VENDORED = (Path("ground/http/static/vendor"), Path("ground/ros2/interfaces"))
NAMESPACE = uuid.UUID("6ba7b811-9dad-11d1-80b4-00c04fd430c8")
"""RFC 4122's for URLs: the bill of one tree always has the same number"""


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--out", type=Path)
    chosen = options.parse_args()
    text = json.dumps(bill(), indent=1, ensure_ascii=False) + "\n"
    if chosen.out is None:
        print(text, end="")
    else:
        chosen.out.write_text(text, encoding="utf-8")


def bill() -> dict[str, Any]:
    project = needed.tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    lock = (ROOT / "requirements.lock").read_text(encoding="utf-8")
    extras = dict(extras_of(lock, project))
    components = [*packages(lock, extras), *vendored()]
    name, number = project["name"], project["version"]
    licence = [{"license": {"id": project["license"]}}]
    own = {"type": "application", "bom-ref": name, "name": name, "version": number, "licenses": licence}
    serial = uuid.uuid5(NAMESPACE, json.dumps([number, components], sort_keys=True))
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "serialNumber": f"urn:uuid:{serial}",
        "version": 1,
        "metadata": {"component": own},
        "components": components,
        "dependencies": [{"ref": name, "dependsOn": [each["bom-ref"] for each in components]}],
    }


def extras_of(lock: str, project: dict[str, Any]) -> Iterator[tuple[str, set[str]]]:
    """Each package of the lock, and what it is there for: the core, or which extras."""
    table = project["optional-dependencies"]
    sets = {"core": set(map(needed.name_of, project["dependencies"]))}
    sets |= {extra: needed.wished([extra], table) for extra in table}
    everything = list(needed.blocks(lock))
    for name, _, _ in everything:
        yield name, set()
    found: dict[str, set[str]] = {}
    for extra, wanted in sets.items():
        for block in needed.needed(lock, wanted):
            found.setdefault(needed.name_of(block), set()).add(extra)
    yield from found.items()


def packages(lock: str, extras: dict[str, set[str]]) -> Iterator[dict[str, Any]]:
    for name, _, block in needed.blocks(lock):
        pinned = re.match(r"[^=\s]+==([^\s;\\]+)", block)
        if pinned is None:
            continue
        purl = f"pkg:pypi/{name}@{pinned[1]}"
        marker = re.search(r";\s*([^\\\n]+)", block.splitlines()[0])
        yield {
            "type": "library",
            "bom-ref": purl + (f"?{marker[1].strip()}" if marker else ""),
            "name": name,
            "version": pinned[1],
            "purl": purl,
            "scope": "required" if "core" in extras[name] else "optional",
            "hashes": [{"alg": "SHA-256", "content": each} for each in re.findall(r"sha256:([0-9a-f]{64})", block)],
            "licenses": licences(name),
            "properties": [{"name": "zmav:for", "value": ", ".join(sorted(extras[name]))}],
        }


def licences(name: str) -> list[dict[str, Any]]:
    """What an installed package says of its licence; empty where it is not installed, or says nothing."""
    try:
        told = importlib.metadata.metadata(name)
    except importlib.metadata.PackageNotFoundError:
        return []
    if expression := told.get("License-Expression"):
        return [{"expression": expression}]
    classified = [
        each.rpartition(" :: ")[2] for each in told.get_all("Classifier") or () if each.startswith("License ::")
    ]
    named = classified or [line for line in [(told.get("License") or "").strip().partition("\n")[0]] if line]
    return [{"license": {"name": each}} for each in named]


def vendored() -> Iterator[dict[str, Any]]:
    """What is in the tree and others wrote: the page's libraries, its map, and the fields of ROS's interfaces."""
    manifests = [(folder, (ROOT / folder / "manifest.json").read_text(encoding="utf-8")) for folder in VENDORED]
    for folder, each in ((folder, each) for folder, text in manifests for each in json.loads(text)):
        purl = each.get("purl") or f"pkg:npm/{each['name']}@{each['version']}"
        files = [
            {
                "type": "file",
                "bom-ref": f"{purl}:{name}",
                "name": str(folder / name),
                "hashes": [{"alg": "SHA-256", "content": digest}],
            }
            for name, digest in each["files"].items()
        ]
        yield {
            "type": "library",
            "bom-ref": purl,
            "name": each["name"],
            "version": each["version"],
            "purl": purl,
            "licenses": [{"license": {"name": each["licence"]}}],
            "components": files,
        }


if __name__ == "__main__":
    main()
