"""docs/safety.md: every row names what proves it, and what it names is there and runs."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent.parent
PAGE = ROOT / "docs" / "safety.md"
TEST = re.compile(r"`([\w/]+\.py)::([\w:]+)`")
Definition = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef


def rows() -> list[str]:
    """The table under "The table", without its head."""
    section = PAGE.read_text().split("\n## The table\n")[1].split("\n## ")[0]
    return [line for line in section.splitlines() if line.startswith("| ")][1:]


NAMED = sorted({found for row in rows() for found in TEST.findall(row)})


@cache
def tree(path: str) -> ast.Module:
    return ast.parse((ROOT / "tests" / path).read_text(), path)


def definition(path: str, name: str) -> Definition:
    body: list[ast.stmt] = tree(path).body
    for part in name.split("::"):
        (found,) = [each for each in body if isinstance(each, Definition) and each.name == part]
        body = found.body
    return found


def marks(path: str, name: str) -> list[str]:
    """What is written about that test, on it, on its class and on its file."""
    parts = name.split("::")
    on = [definition(path, "::".join(parts[: n + 1])) for n in range(len(parts))]
    told = [ast.unparse(mark) for each in on for mark in each.decorator_list]
    for statement in tree(path).body:
        if isinstance(statement, ast.Assign) and ast.unparse(statement.targets[0]) == "pytestmark":
            told.append(ast.unparse(statement.value))
    return told


def test_the_table_is_read() -> None:
    assert len(rows()) > 30
    assert len(NAMED) > 40


@pytest.mark.parametrize("row", rows(), ids=lambda row: row[2:40].strip())
def test_each_row_says_what_proves_it(row: str) -> None:
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    assert len(cells) == 4, row
    assert TEST.search(cells[3]) or "not tested" in cells[3], row


@pytest.mark.parametrize(("path", "name"), NAMED)
def test_what_is_named_is_there_and_not_switched_off(path: str, name: str) -> None:
    assert name.split("::")[-1].startswith("test_")
    assert isinstance(definition(path, name), (ast.FunctionDef, ast.AsyncFunctionDef))
    told = marks(path, name)
    assert not [mark for mark in told if re.search(r"\b(skip|xfail)\b", mark)], told
    first = ast.unparse(definition(path, name).body[0])
    assert not first.startswith("pytest.skip("), first
