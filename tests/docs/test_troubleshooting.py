"""docs/troubleshooting.md: the words that it says the program says are in the program."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
PAGE = ROOT / "docs" / "troubleshooting.md"
GAP = "\0"
"""stands for what an f-string puts in"""
END = "\x01"


def quoted() -> list[str]:
    """The code spans under "what is said", and those of running text that hold a gap and read as a sentence."""
    found: list[str] = []
    column: int | None = None
    for line in PAGE.read_text().splitlines():
        if not line.startswith("|"):
            column = None
            continue
        cells = [cell.strip() for cell in line.strip("|").split(" | ")]
        if "what is said" in (heads := [cell.strip("| ") for cell in cells]):
            column = heads.index("what is said")
        elif column is not None and not line.startswith("|---"):
            found += re.findall(r"`([^`]+)`", cells[column])
    return sorted(set(found))


@cache
def strings() -> str:
    """Every string of the project's sources, with gaps where an f-string has values; between them, ``END``."""
    found: set[str] = set()
    for package in ("zmav", "mesh", "agents", "ground"):
        for path in (ROOT / package).rglob("*.py"):
            todo: list[ast.AST] = [ast.parse(path.read_text(), str(path))]
            while todo:
                node = todo.pop()
                if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
                    continue  # a docstring is said to nobody
                if isinstance(node, ast.Constant) and isinstance(node.value, str):
                    found.add(node.value)
                elif isinstance(node, ast.JoinedStr):
                    parts = [str(p.value) if isinstance(p, ast.Constant) else GAP for p in node.values]
                    found.add("".join(parts))
                todo.extend(ast.iter_child_nodes(node))
    return END.join(found)


def said(words: str) -> bool:
    """Some string holds these words, "…" being anything in it."""
    parts = [part.strip() for part in words.strip("… ").split("…")]
    return re.search(f"[^{END}]*?".join(map(re.escape, parts)), strings()) is not None


def test_messages_are_found_in_the_page() -> None:
    assert len(quoted()) > 60


def test_the_program_says_so() -> None:
    """One test: reading all sources takes a second, and each worker would do it."""
    assert not said("the parrot of … is deceased")
    assert [words for words in quoted() if not said(words)] == []
