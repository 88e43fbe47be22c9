"""What a test reaches, read from the source: which of our modules it imports, by which names, and what those import.

A test file is read by definition, so that a test is held to need only the fixtures and helpers that it uses; a module
of the product is read as a whole. A package that is passed through on the way to a module counts, but what its
``__init__`` imports does not: ``zmav`` offers all of the client there.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from functools import cached_property
from pathlib import Path

PACKAGES = ("zmav", "agents", "mesh", "ground", "deploy", "docs", "tests")


class Source:
    """One file: the names that it imports, and what each of its definitions uses."""

    def __init__(self, module: str, path: Path) -> None:
        self.module, self.path = module, path
        self.imports: dict[str, str] = {}
        """the dotted name behind each imported one; imports in functions count, those for types only do not"""
        self.needed: set[str] = set()
        """the modules that it imports, or the names in them"""
        self.named: set[str] = set()
        """every text that may name a module: ``-m mesh.lab.relay``, ``agents.demo.cli:demo``"""
        self._tree = ast.parse(path.read_bytes())
        for node in _at_runtime(self._tree):
            if isinstance(node, ast.Import):
                for each in node.names:
                    self.needed.add(each.name)
                    first = each.name.partition(".")[0]
                    self.imports |= {each.asname: each.name} if each.asname else {first: first, each.name: each.name}
            elif isinstance(node, ast.ImportFrom):
                base = ".".join(filter(None, (self._package(node.level), node.module)))
                found = {each.asname or each.name: f"{base}.{each.name}" for each in node.names}
                self.imports |= found
                self.needed.update(found.values())
            elif isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value.startswith(PACKAGES):
                self.named.add(node.value.partition(":")[0])

    @cached_property
    def definitions(self) -> dict[str, list[ast.AST]]:
        """What gives each name of the module its meaning."""
        found: dict[str, list[ast.AST]] = {}
        for node in self._tree.body:
            names: Iterable[str] = ()
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                names = (node.name,)
            elif isinstance(node, ast.Assign | ast.AnnAssign):
                names = [
                    each.id for each in ast.walk(node) if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store)
                ]
            for name in names:
                found.setdefault(name, []).append(node)
        return found

    def uses(self, name: str) -> set[str]:
        """The dotted names that a definition uses, as they are written in this file."""
        return {used for node in self.definitions.get(name, []) for used in _names(node)}

    def _package(self, level: int) -> str:
        if not level:
            return ""
        parts = self.module.split(".")
        if self.path.name != "__init__.py":
            parts = parts[:-1]
        return ".".join(parts[: len(parts) - level + 1])


class Sources:
    """All files of a tree, read as they are asked for."""

    def __init__(self, root: Path, packages: Iterable[str] = PACKAGES) -> None:
        self.paths = {
            _module(path.relative_to(root)): path for each in packages for path in (root / each).rglob("*.py")
        }
        self.modules = {path.resolve(): module for module, path in self.paths.items()}
        self._read: dict[str, Source] = {}
        self._reached: dict[tuple[str, str], frozenset[str]] = {}
        self._steps: dict[tuple[str, str], tuple[set[str], set[tuple[str, str]]]] = {}

    def read(self, module: str) -> Source:
        if module not in self._read:
            self._read[module] = Source(module, self.paths[module])
        return self._read[module]

    def split(self, dotted: str) -> tuple[str, str]:
        """The longest module of ours at the start of a dotted name, and the rest; no module: not ours."""
        module, rest = dotted, ""
        while module and module not in self.paths:
            module, _, last = module.rpartition(".")
            rest = f"{last}.{rest}" if rest else last
        return module, rest

    def reach(self, module: str, name: str) -> frozenset[str]:
        """The dotted names, ours and others', that a definition in a test file uses, itself or by its helpers."""
        if (module, name) not in self._reached:
            found, seen, todo = set[str](), {(module, name)}, [(module, name)]
            while todo:
                names, helpers = self._step(*todo.pop())
                found |= names
                todo += helpers - seen
                seen |= helpers
            self._reached[module, name] = frozenset(found)
        return self._reached[module, name]

    def _step(self, module: str, name: str) -> tuple[set[str], set[tuple[str, str]]]:
        """What a definition itself uses, and the helpers, as module and name, whose own uses count too."""
        if (module, name) not in self._steps:
            source, names, helpers = self.read(module), {module}, set[tuple[str, str]]()
            for used in source.uses(name):
                first, _, rest = used.partition(".")
                if first in source.definitions:
                    helpers.add((module, first))
                elif first in source.imports:
                    whole = ".".join(filter(None, (source.imports[first], rest)))
                    helper, inside = self.split(whole)
                    if helper.startswith("tests") and inside:
                        helpers.add((helper, inside.partition(".")[0]))
                    else:
                        names.add(whole)
            self._steps[module, name] = names | (source.named & self.paths.keys()), helpers
        return self._steps[module, name]

    def affected(self, changed: Iterable[str]) -> set[str]:
        """The modules whose import closure holds one of these, themselves included."""
        users: dict[str, set[str]] = {}
        for module in self.paths:
            source = self.read(module)
            for dotted in source.needed | (source.named & self.paths.keys()):
                users.setdefault(self.split(dotted)[0], set()).add(module)
        found, todo = set[str](), set(changed)
        while todo:
            module = todo.pop()
            found.add(module)
            todo |= users.get(module, set()) - found
        return found


def _module(path: Path) -> str:
    parts = path.with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _at_runtime(tree: ast.AST) -> Iterator[ast.AST]:
    """As ``ast.walk``, without what stands under ``if TYPE_CHECKING``."""
    todo = [tree]
    while todo:
        node = todo.pop()
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            continue
        yield node
        todo.extend(ast.iter_child_nodes(node))


def _names(node: ast.AST) -> Iterator[str]:
    """Each name in it, with its attributes where it has some; types are not used, they are only written."""
    chain: list[str] = []
    inner = node
    while isinstance(inner, ast.Attribute):
        chain.append(inner.attr)
        inner = inner.value
    if isinstance(inner, ast.Name):
        yield ".".join((inner.id, *reversed(chain)))
        return
    for field, value in ast.iter_fields(node):
        if field not in ("annotation", "returns"):
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from _names(child)
