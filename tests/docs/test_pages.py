"""Links and pictures in README.md and docs/*.md lead somewhere, and what they show of Python can be."""

from __future__ import annotations

import ast
import importlib
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.docs.commands import PAGES, ROOT


def prose(text: str) -> str:
    """A page without its code."""
    text = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    return re.sub(r"`[^`\n]*`", "`", text)


def anchors(path: Path) -> set[str]:
    """What a forge calls each heading: lower case, no punctuation, hyphens for spaces, numbered where it is double."""
    found: list[str] = []
    text = re.sub(r"^```.*?^```", "", path.read_text("utf-8"), flags=re.DOTALL | re.MULTILINE)
    for heading in re.findall(r"^#+ +(.*?) *$", text, re.MULTILINE):
        heading = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading)
        name = re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
        found.append(f"{name}-{found.count(name)}" if name in found else name)
    return set(found)


def links(page: Path) -> Iterator[tuple[str, str]]:
    """The page's links into the tree: the file and the anchor, each may be empty."""
    for target in re.findall(r"\]\(([^)\s]+)\)", prose(page.read_text("utf-8"))):
        if not re.match(r"[a-z]+:", target):
            path, _, anchor = target.partition("#")
            yield path, anchor


def dead(page: Path) -> Iterator[str]:
    for path, anchor in links(page):
        target = (page.parent / path).resolve() if path else page
        if not target.exists():
            yield f"{page.relative_to(ROOT)}: ({path}) is not there"
        elif anchor and target.suffix == ".md" and anchor not in anchors(target):
            yield f"{page.relative_to(ROOT)}: {path} has no heading #{anchor}"


def test_every_link_and_picture_leads_somewhere() -> None:
    found = [fault for page in (*PAGES, ROOT / "CONTRIBUTING.md") for fault in dead(page)]
    assert not found, "\n" + "\n".join(found)


def test_the_index_has_every_page() -> None:
    index = ROOT / "docs" / "README.md"
    named = {path for path, _ in links(index)}
    missing = [page.name for page in PAGES if page.parent == index.parent and page.name not in named | {"README.md"}]
    assert not missing, f"docs/README.md, the index, does not name {missing}"


def python_blocks() -> list[tuple[str, str]]:
    """Each block of Python: its page and number, and its text."""
    return [
        (f"{page.relative_to(ROOT)}:{number}", body)
        for page in PAGES
        for number, body in enumerate(re.findall(r"^```python\n(.*?)^```", page.read_text("utf-8"), re.M | re.S), 1)
    ]


def strange(tree: ast.AST) -> Iterator[str]:
    """What a block takes from the project that is not there: modules, names, attributes of modules."""
    known: dict[str, str] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                if ours(alias.name):
                    importlib.import_module(alias.name)
                    known[alias.asname or alias.name.partition(".")[0]] = alias.name if alias.asname else "zmav"
        elif isinstance(node, ast.ImportFrom) and node.module and ours(node.module):
            for alias in node.names:
                if not there(node.module, alias.name):
                    yield f"{node.module}.{alias.name}"
                elif is_module(f"{node.module}.{alias.name}"):
                    known[alias.asname or alias.name] = f"{node.module}.{alias.name}"
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in known:
            module = known[node.value.id]
            if not there(module, node.attr):
                yield f"{module}.{node.attr}"


def ours(module: str) -> bool:
    return module.partition(".")[0] in ("zmav", "agents", "mesh", "ground", "tests")


def is_module(name: str) -> bool:
    return (ROOT / name.replace(".", "/")).is_dir() or (ROOT / f"{name.replace('.', '/')}.py").is_file()


def there(module: str, name: str) -> bool:
    return hasattr(importlib.import_module(module), name) or is_module(f"{module}.{name}")


@pytest.mark.parametrize(("where", "body"), python_blocks(), ids=lambda value: value if ":" in value[:60] else "")
def test_a_block_of_python_can_be(where: str, body: str) -> None:
    tree = compile(body, where, "exec", flags=ast.PyCF_ONLY_AST | ast.PyCF_ALLOW_TOP_LEVEL_AWAIT)
    assert isinstance(tree, ast.AST)
    assert list(strange(tree)) == [], where


def test_what_is_not_there_is_found() -> None:
    block = "import zmav\nfrom zmav import keys, nosuch\nzmav.nothing\nkeys.NOSUCH\nzmav.open"
    assert list(strange(ast.parse(block))) == ["zmav.nosuch", "zmav.nothing", "zmav.keys.NOSUCH"]


def test_a_dead_link_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.docs.test_pages.ROOT", tmp_path)
    page = tmp_path / "page.md"
    page.write_text(
        "# One thing: a test\n[a](nosuch.md) [b](#one-thing-a-test) ![c](x.png) [d](page.md#two) `[e](f)`\n"
    )
    assert [fault.partition(": ")[2] for fault in dead(page)] == [
        "(nosuch.md) is not there",
        "(x.png) is not there",
        "page.md has no heading #two",
    ]
