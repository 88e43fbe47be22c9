"""The site: each page of docs/ is in one place of it, and its links lead where they do in the repository."""

from __future__ import annotations

import importlib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from docs import mkdocs_hook as site
from tests.docs.test_pages import anchors

ROOT, DOCS = site.ROOT, site.DOCS
FIRST = ["Start", "Fly", "Plan", "See", "Secure", "Extend", "Operate", "Measure", "Reference"]


@pytest.fixture(scope="module")
def settings() -> dict[str, Any]:
    found = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    assert isinstance(found, dict)
    return found


def leaves(nav: Any) -> Iterator[str]:
    if isinstance(nav, str):
        yield nav
    elif isinstance(nav, list):
        for each in nav:
            yield from leaves(each)
    else:
        for each in nav.values():
            yield from leaves(each)


def sources() -> dict[str, Path]:
    """The site's pages that are texts of the repository, by their place."""
    pages = {*DOCS.glob("*.md"), ROOT / "README.md"}
    return {site.place(path): path for path in pages | site.outside(pages)}


def test_every_page_is_in_exactly_one_place(settings: dict[str, Any]) -> None:
    assert [next(iter(each)) for each in settings["nav"]] == FIRST
    assert len(FIRST) < 10
    placed = Counter(leaves(settings["nav"]))
    assert max(placed.values()) == 1
    written = {site.place(path) for path in DOCS.glob("*.md")}
    assert written <= set(placed), "mkdocs.yml does not name these"
    assert set(placed) - written == {
        *("index.md", "api.md", "CHANGELOG.md", "CONTRIBUTING.md"),
        *("deploy/wifi/README.md", "deploy/containers/README.md"),
    }


def test_programs_of_the_folder_are_left_out(settings: dict[str, Any]) -> None:
    assert settings["exclude_docs"].split() == ["*.py", "__pycache__/"]


def test_no_two_files_have_one_place() -> None:
    pages = {*DOCS.glob("*.md"), ROOT / "README.md"}
    everything = pages | site.outside(pages)
    assert len({site.place(path) for path in everything}) == len(everything)
    assert site.place(ROOT / "README.md") == "index.md"
    assert site.place(ROOT / "ground/examples/takeoff.py") == "ground/examples/takeoff.py.md"


def test_links_lead_to_the_same_files_in_the_site() -> None:
    pages = sources()
    for place, path in pages.items():
        if path.suffix != ".md":
            continue
        text = site.relinked(path.read_text(encoding="utf-8"), path)
        for found in site.LINK.finditer(text):
            if not found["path"]:
                continue
            target = (Path("/site") / place).parent.joinpath(found["path"]).resolve().relative_to("/site").as_posix()
            assert target in pages or (DOCS / target).is_file(), f"{path}: {found[0]}"
            anchor = (found["anchor"] or "").lstrip("#")
            if anchor and target in pages:
                assert anchor in anchors(pages[target]), f"{path}: {found[0]}"


def test_code_is_left_as_it_is() -> None:
    here = DOCS / "page.md"
    assert site.relinked("[a](README.md#x) `[b](README.md)`", here) == "[a](contents.md#x) `[b](README.md)`"
    assert site.relinked("```\n[a](README.md)\n```\n", here) == "```\n[a](README.md)\n```\n"
    assert (
        site.relinked("![p](docs/a.png) [q](https://x/y.md)", ROOT / "README.md") == "![p](a.png) [q](https://x/y.md)"
    )


def test_a_source_becomes_a_page_with_its_text() -> None:
    text = site.as_page(ROOT / "ground/examples/takeoff.py")
    assert text.startswith("# ground/examples/takeoff.py\n\n```python\n")
    assert (ROOT / "ground/examples/takeoff.py").read_text(encoding="utf-8") in text


@pytest.mark.parametrize(("where", "name"), site.API.items())
def test_the_reference_of_python_names_what_there_is(where: str, name: str) -> None:
    def found(dotted: str) -> Any:
        module, _, last = dotted.rpartition(".")
        return getattr(importlib.import_module(module), last)

    assert found(where) is found(name)
    assert f"::: {where}\n" in site.api()


def test_headings_are_called_what_a_forge_calls_them() -> None:
    assert site.slug("`zmav http`: what it's for") == "zmav-http-what-its-for"
    assert site.slug("A  b") == "a--b"


def test_the_site_asks_nobody_else_for_anything(settings: dict[str, Any]) -> None:
    assert settings["theme"]["font"] is False
    assert not {"analytics", "consent", "social"} & set(settings["extra"])
    assert settings["extra"]["version"] == {"provider": "mike"}
    assert settings["strict"] is True
