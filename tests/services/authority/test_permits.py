"""What permits a vehicle to be moved cannot be forgotten: it is built in, and nothing has a default for it."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import zmav

ROOT = Path(zmav.__file__).parent
FILES = [ROOT / "adapter.py", ROOT / "forwarding.py", ROOT / "onboard.py", *sorted((ROOT / "services").rglob("*.py"))]
PERMITS = ("MayMove", "Prove", "Permit", "Allowed", "Control", "Gate", "Verifier")
"""types of what permits, as signatures name them"""
TELLS = (
    (("send", "send_raw"), ("port", "adapter", "link")),
    (("command", "enter", "give"), ("_do", "commander")),
    (("fly",), ("watchdog",)),
)
"""calls by which the autopilot is told something, and what they are called on"""

NEEDS_NONE = {
    "Adapter": "the link itself: what its services send, they are permitted to",
    "EventTexts": "asks for the report of the checks",
    "Flight": "handlers: reached by Orders alone, behind its Permit",
    "Identity": "asks for messages",
    "MissionFlight": "handlers: reached by Orders alone, behind its Permit",
    "Onboard": "sends its HEARTBEAT",
    "ParamTalk": "asks for parameters and sets them: an order of its own",
    "Rates": "asks for rates",
    "Payload": "handlers: reached by Orders alone, behind its Permit",
    "Talk": "moves files",
    "TerrainRequests": "says how high the ground is, where the autopilot asks",
    "TimeSync": "asks for the time",
    "Transfer": "moves missions",
    "TriggeredCamera": "a handler: reached by Orders alone, behind its Permit; by itself it only ends what that began",
}
"""classes that send to the autopilot and are permitted by somebody else, or move nothing"""
PERMITTING = {
    "admit",
    "guard",
    "prove",
    "allowed",
    "accept",
    "busy",
    "free",
    "may_take",
    "may_move",
    "may_send",
    "check",
    "checks",
    "near",
    "lead",
    "leads",
    "leading",
    "aside",
    "permit",
    "sealed",
    "param",
    "rally",
    "future",
    "ask_time",
}
# To parse all of the tree takes each worker seconds: only files where these are found can hold what is looked for.
CONCERNED = re.compile(rf"{'|'.join(PERMITS)}|\.(?:{'|'.join(name for names, _ in TELLS for name in names)})\(")
ASSIGNED = re.compile(rf"\._*(?:{'|'.join(sorted(PERMITTING))})\s*(?:[,:)\]]|=(?!=))")


def classes() -> Iterator[tuple[Path, ast.ClassDef, str]]:
    """Each class of these files, and its text."""
    for path in FILES:
        if not CONCERNED.search(text := path.read_text()):
            continue
        lines = text.split("\n")
        for node in ast.walk(ast.parse(text, str(path))):
            if isinstance(node, ast.ClassDef):
                yield path, node, "\n".join(lines[node.lineno - 1 : node.end_lineno])


def calls(node: ast.AST) -> set[str]:
    """``port.send`` as "send", ``commander.enter`` as "enter": what a class has the autopilot told."""
    found = set()
    for call in ast.walk(node):
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Attribute):
            name = call.func.attr
            if any(name in names and ast.unparse(call.func.value).endswith(owners) for names, owners in TELLS):
                found.add(name)
    return found


def built(path: Path, name: str) -> type[Any]:
    module = ".".join(path.relative_to(ROOT.parent).with_suffix("").parts)
    found = getattr(importlib.import_module(module), name)
    assert isinstance(found, type)
    return found


def permits(made: type[Any]) -> list[inspect.Parameter]:
    """The parameters of what permits, by their annotations."""
    found = inspect.signature(made).parameters.values()
    return [p for p in found if not {*re.findall(r"\w+", str(p.annotation))}.isdisjoint(PERMITS)]


CLASSES = list(classes())
MOVERS = [
    (path, node.name) for path, node, _ in CLASSES if calls(node) and node.name not in NEEDS_NONE
]  # what asks for something dangerous, and is not excused by name
ASKERS = [
    (path, node.name)
    for path, node, text in CLASSES
    if "__init__" in {each.name for each in node.body if isinstance(each, ast.FunctionDef)}
    and any(permit in text for permit in PERMITS)
    and permits(built(path, node.name))
]


@pytest.mark.parametrize(("path", "name"), MOVERS, ids=[name for _, name in MOVERS])
def test_each_class_that_tells_the_autopilot_something_is_permitted_to(path: Path, name: str) -> None:
    assert permits(built(path, name)), f"{name} sends to the autopilot, and takes nothing that permits it"


@pytest.mark.parametrize(("path", "name"), ASKERS, ids=[name for _, name in ASKERS])
def test_none_can_be_built_without_what_permits(path: Path, name: str) -> None:
    made = built(path, name)
    needed = [p for p in inspect.signature(made).parameters.values() if p.default is inspect.Parameter.empty]
    by_name = {p.name: object() for p in needed}
    for permit in permits(made):
        assert permit.default is inspect.Parameter.empty, f"{name}({permit.name}=...) has a default"
        with pytest.raises(TypeError, match=f"missing .*{permit.name}"):
            made(**{given: value for given, value in by_name.items() if given != permit.name})


def test_those_that_are_meant_are_among_them() -> None:
    """The search above finds what it is for."""
    asking = {name for _, name in ASKERS}
    assert asking >= {
        "Authority",
        "FrameForwarder",
        "GcsTraffic",
        "Leases",
        "Orders",
        "PositionLeader",
        "Questions",
        "Setpoints",
        "StreamWatchdog",
    }
    assert {name for _, name in MOVERS} >= {
        "Authority",
        "FrameForwarder",
        "PositionLeader",
        "Setpoints",
        "StreamWatchdog",
    }
    assert NEEDS_NONE.keys() <= {node.name for _, node, _ in CLASSES if calls(node)}, "an excuse that nobody needs"


def assignments(files: list[Path]) -> Iterator[tuple[str, str, ast.expr]]:
    """Where, to what attribute, and what is assigned."""
    for path in files:
        if not ASSIGNED.search(text := path.read_text()):
            continue
        for node in ast.walk(ast.parse(text, str(path))):
            if isinstance(node, ast.Assign):
                pairs = [(target, node.value) for target in node.targets]
            elif isinstance(node, ast.AnnAssign) and node.value is not None:
                pairs = [(node.target, node.value)]
            else:
                continue
            for target, value in pairs:
                both = isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple)
                targets = target.elts if isinstance(target, ast.Tuple) else [target]
                values = value.elts if both and isinstance(value, ast.Tuple) else [value] * len(targets)
                for to, what in zip(targets, values, strict=False):
                    if isinstance(to, ast.Attribute):
                        yield f"{path.name}:{node.lineno}", ast.unparse(to), what


def permitted_by_default(files: list[Path]) -> list[str]:
    """Attributes that permit by a lambda, or that another object is given afterwards."""
    found = []
    for where, to, what in assignments(files):
        owner, _, name = to.rpartition(".")
        if name.lstrip("_") in PERMITTING and (owner != "self" or isinstance(what, ast.Lambda)):
            found.append(f"{where} {to}")
    return found


def test_no_attribute_permits_until_somebody_assigns_it() -> None:
    packages = ("zmav", "agents", "ground", "mesh")
    files = [path for package in packages for path in sorted((ROOT.parent / package).rglob("*.py"))]
    assert len(files) > len(FILES)
    assert permitted_by_default([path for path in files if ROOT / "sim" not in path.parents]) == []


def test_one_that_did_would_be_found(tmp_path: Path) -> None:
    bad = tmp_path / "bad.py"
    bad.write_text(
        "class A:\n"
        "    def __init__(self, b):\n"
        "        self.guard: object = lambda: None\n"
        "        b.setpoints.accept, self.x = print, 1\n"
    )
    assert permitted_by_default([bad]) == ["bad.py:3 self.guard", "bad.py:4 b.setpoints.accept"]
