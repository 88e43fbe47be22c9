"""What a test reaches, read from the source: which of our modules it imports, by which names, and what those import.

A test file is read by definition, so that a test is held to need only the fixtures and helpers that it uses; a module
of the product is read as a whole. A package that is passed through on the way to a module counts, but what its
``__init__`` imports does not: ``zmav`` offers all of the client there.
"""

from __future__ import annotations

import ast
import contextlib
import os
from collections.abc import Iterable, Iterator
from pathlib import Path

import msgspec

CACHE = Path(".pytest_cache") / "imports.json"
PACKAGES = ("zmav", "agents", "mesh", "ground", "deploy", "docs", "tests")


class Source(msgspec.Struct):
    """One file: the names that it imports, and what each of its definitions uses."""

    stamp: tuple[int, int]
    """when the file changed (ns), and its size"""
    imports: dict[str, str] = {}
    """the dotted name behind each imported one; imports in functions count, those for types only do not"""
    needed: set[str] = set()
    """the modules that it imports, or the names in them"""
    named: set[str] = set()
    """every text that may name a module: ``-m mesh.lab.relay``, ``agents.demo.cli:demo``"""
    uses: dict[str, set[str]] = {}
    """the dotted names that each definition uses, as they are written in this file; of a test file only"""


def parse(module: str, path: Path, stamp: tuple[int, int]) -> Source:
    """What a file says."""
    tree, found = ast.parse(path.read_bytes()), Source(stamp)
    for node in _at_runtime(tree):
        if isinstance(node, ast.Import):
            for each in node.names:
                found.needed.add(each.name)
                first = each.name.partition(".")[0]
                found.imports |= {each.asname: each.name} if each.asname else {first: first, each.name: each.name}
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(filter(None, (_package(module, path, node.level), node.module)))
            names = {each.asname or each.name: f"{base}.{each.name}" for each in node.names}
            found.imports |= names
            found.needed.update(names.values())
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value.startswith(PACKAGES):
            found.named.add(node.value.partition(":")[0])
    for node in tree.body if module.startswith("tests") else []:
        for name in _defined(node):
            found.uses.setdefault(name, set()).update(_names(node))
    return found


def _defined(node: ast.stmt) -> list[str]:
    """The names of the module that it gives a meaning."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return [node.name]
    if isinstance(node, ast.Assign | ast.AnnAssign):
        return [each.id for each in ast.walk(node) if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store)]
    return []


def _package(module: str, path: Path, level: int) -> str:
    """The package that an import of so many dots is from."""
    if not level:
        return ""
    parts = module.split(".")
    if path.name != "__init__.py":
        parts = parts[:-1]
    return ".".join(parts[: len(parts) - level + 1])


class Sources:
    """All files of a tree, read as they are asked for.

    ``cache``: a file in which what was read of them is kept from one run to the next (:meth:`save`): to read all takes
    ten seconds of a core, and each worker of a run needs it.
    """

    def __init__(self, root: Path, packages: Iterable[str] = PACKAGES, cache: Path | None = None) -> None:
        self.paths = {
            _module(path.relative_to(root)): path for each in packages for path in (root / each).rglob("*.py")
        }
        self.modules = {path.resolve(): module for module, path in self.paths.items()}
        self._cache = cache
        self._read: dict[str, Source] = {}
        self._kept = _load(cache)
        self._reached: dict[tuple[str, str], frozenset[str]] = {}
        self._steps: dict[tuple[str, str], tuple[set[str], set[tuple[str, str]]]] = {}

    def read(self, module: str) -> Source:
        if module not in self._read:
            path = self.paths[module]
            status = path.stat()
            kept, stamp = self._kept.get(module), (status.st_mtime_ns, status.st_size)
            self._read[module] = kept if kept is not None and kept.stamp == stamp else parse(module, path, stamp)
        return self._read[module]

    def save(self) -> None:
        """Keep what was read; other processes may do so at the same time."""
        assert self._cache is not None
        keep(self._cache, Kept(_own_stamp(), self._read))

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
            for used in source.uses.get(name, ()):
                first, _, rest = used.partition(".")
                if first in source.uses:
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


class Kept(msgspec.Struct):
    """What the cache holds."""

    by: tuple[int, int]
    """the stamp of this file, which read them"""
    sources: dict[str, Source]


def keep(path: Path, value: object) -> None:
    """Write it as JSON; other processes may do so at the same time, and none reads a part of it."""
    path.parent.mkdir(exist_ok=True)
    new = path.with_suffix(f".{os.getpid()}")
    new.write_bytes(msgspec.json.encode(value))
    new.replace(path)


def _own_stamp() -> tuple[int, int]:
    status = Path(__file__).stat()
    return status.st_mtime_ns, status.st_size


def _load(cache: Path | None) -> dict[str, Source]:
    """What is in the cache; nothing where it is missing, broken, or another version's."""
    with contextlib.suppress(OSError, msgspec.MsgspecError):
        kept = msgspec.json.decode(cache.read_bytes(), type=Kept) if cache is not None else None
        return kept.sources if kept is not None and kept.by == _own_stamp() else {}
    return {}


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
