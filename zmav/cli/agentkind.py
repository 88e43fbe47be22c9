"""Which agent is meant: of a name, or of a file; and what it is set to."""

from __future__ import annotations

import importlib.util
import re
import sys
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

import msgspec

from zmav.agent import Agent
from zmav.config.table import reading
from zmav.errors import BadConfig, BadInput, missing_extra

GROUP, CONTROLLERS = "zmav.agents", "zmav.controllers"
"""entry points: agents by name, and controllers that an agent runs"""
CONTROLLER = "controller"
"""the agent that runs a controller"""


def resolve(what: str) -> tuple[type[Agent], dict[str, Any]]:
    """The agent that is meant, and settings that go with it: of a name, or of a file that holds a class.

    Raises :class:`~zmav.errors.BadInput` for a name that there is not, :class:`BadConfig` for a file that holds none.
    """
    if what.endswith(".py"):
        own = _agent_in(Path(what))
        return (own, {}) if own is not None else (find(CONTROLLER), {"controller": what})
    known = entry_points(group=GROUP).names
    if what not in known and what in entry_points(group=CONTROLLERS).names:
        return find(CONTROLLER), {"controller": what}
    return find(what), {}


def _agent_in(path: Path) -> type[Agent] | None:
    """The agent that a file holds. A controller's file is not run here, but in a process of its own: None."""
    with reading(path, "agent"):
        text = path.read_text(encoding="utf-8", errors="replace")  # what is wrong in it, Python says with its line
    if not re.search(r"^class \w+\(.*\bAgent\b", text, re.MULTILINE):
        return None
    name = f"zmav_agent_file_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # where the types in its annotations are looked up
    try:
        spec.loader.exec_module(module)
    except Exception as e:
        raise BadConfig(f"{path}: {type(e).__name__}: {e}", field="name", value=str(path), expected="an agent") from e
    found = [
        each
        for each in vars(module).values()
        if isinstance(each, type) and issubclass(each, Agent) and each.__module__ == name
    ]
    if len(found) != 1 or not hasattr(found[0], "name"):
        names = ", ".join(each.__name__ for each in found) or "none"
        text = f"{path} holds {names}; expected one class derived from zmav.Agent, with a name"
        raise BadConfig(text, field="name", value=str(path), expected="one agent")
    return found[0]


def find(name: str) -> type[Agent]:
    """The agent of that name; raises :class:`~zmav.errors.BadInput` naming those there are."""
    known: dict[str, EntryPoint] = {point.name: point for point in entry_points(group=GROUP)}
    if name not in known:
        names = ", ".join(sorted(known)) or "none installed"
        raise BadInput(f"no agent {name!r}; there are: {names}", field="name", value=name, expected=names)
    try:
        kind = known[name].load()
    except ImportError as e:
        raise missing_extra(f"the agent {name}", e.name, "vision") from e
    if not (isinstance(kind, type) and issubclass(kind, Agent)):
        raise BadConfig(f"{known[name].value} is no zmav.Agent", field="name", value=name, expected="a zmav.Agent")
    return kind


def settings_of(kind: type[Agent], values: dict[str, Any]) -> msgspec.Struct:
    """The settings of an agent of that kind; raises :class:`BadInput` naming those there are."""
    try:
        return msgspec.convert(values, kind.settings_type, strict=False)
    except msgspec.ValidationError as e:
        known = ", ".join(field.name for field in msgspec.structs.fields(kind.settings_type)) or "none"
        raise BadInput(f"{kind.name}: {e}; settings: {known}", field="option", value=values, expected=known) from e
