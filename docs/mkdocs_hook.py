"""What 'make site' does beyond mkdocs: a page's links lead where they do in the repository.

The README is the site's start page, docs/README.md its list of pages (``contents.md``). What pages link to outside
docs/ becomes a page of the site: texts as they are, sources as a block of code. ``api.md`` is made of docstrings.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
PLACES = {ROOT / "README.md": "index.md", DOCS / "README.md": "contents.md"}
LINK = re.compile(
    r"(?P<code>^```.*?^```|`[^`\n]*`)|\]\((?P<path>[^)\s#:]+)(?P<anchor>#[^)\s]*)?\)", re.DOTALL | re.MULTILINE
)
ROLE = re.compile(r":(?:class|func|meth|mod|data|attr|exc):<code>~?(?:[\w.]+\.(?=\w+</code>))?")
LANGUAGES = {".py": "python", ".sh": "bash", ".mjs": "javascript", ".rs": "rust", ".toml": "toml"}
API = {
    "zmav.client.connect": "zmav.open",
    "zmav.process.run": "zmav.run",
    "zmav.client.Client": "zmav.Client",
    "zmav.subscription.Subscription": "zmav.Subscription",
    "zmav.vehicle.Vehicle": "zmav.Vehicle",
    "zmav.vehicle.Lease": "zmav.Lease",
    "zmav.agent.Agent": "zmav.Agent",
    "agents.controllers.controller.Controller": "agents.controllers.controller.Controller",
    "zmav.wire.Setpoint": "zmav.Setpoint",
    "zmav.wire.VehicleState": "zmav.VehicleState",
    "zmav.errors": "zmav.errors",
}
"""what scripts use (docs/compatibility.md): where it is, and how it is imported"""


def place(path: Path) -> str:
    """Where a file of the repository is in the site, as mkdocs names a source."""
    if path in PLACES:
        return PLACES[path]
    if path.is_relative_to(DOCS):
        return path.relative_to(DOCS).as_posix()
    inside = path.relative_to(ROOT).as_posix()
    return inside if path.suffix == ".md" else f"{inside}.md"


def linked(path: Path) -> set[Path]:
    """The files that a page leads to."""
    found = LINK.finditer(path.read_text(encoding="utf-8"))
    return {(path.parent / each["path"]).resolve() for each in found if each["path"]}


def outside(pages: Iterable[Path]) -> set[Path]:
    """What pages lead to that is not in docs/, by one link or by several."""
    found: set[Path] = set()
    ahead = list(pages)
    while ahead:
        new = {each for each in linked(ahead.pop()) if not each.is_relative_to(DOCS)} - found
        found |= new
        ahead += [each for each in new if each.suffix == ".md"]
    return found


def relinked(text: str, path: Path) -> str:
    """A page's text with its links as they are between the places of the site."""

    def change(found: re.Match[str]) -> str:
        if not found["path"]:
            return found[0]
        target = os.path.relpath(place((path.parent / found["path"]).resolve()), Path(place(path)).parent)
        return f"]({target}{found['anchor'] or ''})"

    return LINK.sub(change, text)


def slug(heading: str, separator: str = "-") -> str:
    """What a forge calls a heading."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", separator)


def as_page(path: Path) -> str:
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        return relinked(text, path)
    return f"# {path.relative_to(ROOT).as_posix()}\n\n```{LANGUAGES.get(path.suffix, 'text')}\n{text}\n```\n"


def api() -> str:
    entries = [f"::: {where}\n    options: {{heading: {name}, toc_label: {name}}}\n" for where, name in API.items()]
    return "\n".join(["# The Python interface\n\nAs the docstrings say it.\n", *entries])


def on_config(config: Any) -> Any:
    config.mdx_configs["toc"]["slugify"] = slug
    config.site_url = os.environ.get("SITE_URL", "")
    return config


def on_files(files: Any, config: Any) -> Any:
    from mkdocs.structure.files import File

    files.remove(files.get_file_from_path("README.md"))
    for path in {*PLACES, *outside([*PLACES, *DOCS.glob("*.md")])}:
        files.append(File.generated(config, place(path), content=as_page(path)))
    files.append(File.generated(config, "api.md", content=api()))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Those of docs/ itself; the others were changed when they were brought in."""
    source = DOCS / page.file.src_uri
    return relinked(markdown, source) if page.file.generated_by is None else markdown


def on_page_content(html: str, **_: Any) -> str:
    return ROLE.sub("<code>", html)
