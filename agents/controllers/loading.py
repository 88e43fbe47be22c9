"""From a file or a name to a controller, and from an exception to where in the user's file it came from."""

from __future__ import annotations

import inspect
import sys
import traceback
from pathlib import Path
from types import ModuleType
from typing import Any

from agents.controllers.controller import Controller
from zmav.errors import BadConfig

GROUP = "zmav.controllers"


def is_file(what: str) -> bool:
    return what.endswith(".py")


def load(what: str) -> type[Controller]:
    """The class that a file holds, or the installed one of that name.

    Raises :class:`~zmav.errors.BadConfig`, or whatever the file raises.
    """
    if not is_file(what):
        from importlib.metadata import entry_points  # slow to load, and a file needs none

        known = {point.name: point for point in entry_points(group=GROUP)}
        if what not in known:
            text = f"no controller {what!r}: expected a file that ends in .py, or one of {', '.join(known)}"
            raise BadConfig(text, field="controller", value=what, expected=", ".join(known))
        found: type[Controller] = known[what].load()
        return found
    return _pick(_module(Path(what)), what)


def check(settings: Any) -> None:
    """Raise :class:`~zmav.errors.BadConfig` where a supervisor's settings name no controller. A file is run, here."""
    try:
        load(settings.controller)
    except Exception as e:
        text = where(e, settings.controller)
        raise BadConfig(text, field="controller", value=settings.controller, expected="a controller") from e


def _module(path: Path) -> ModuleType:
    if not path.is_file():
        raise BadConfig(f"there is no file {path}", field="controller", value=str(path), expected="a file")
    module = ModuleType(f"controller_{path.stem}")
    module.__file__ = str(path)
    sys.modules[module.__name__] = module
    sys.path.insert(0, str(path.parent))  # what lies beside it can be imported
    # Python's own import would take a file saved twice in a second for the one that it has compiled already.
    exec(compile(path.read_bytes(), str(path), "exec"), vars(module))
    return module


def _pick(module: ModuleType, what: str) -> type[Controller]:
    here = {
        name: each
        for name, each in vars(module).items()
        if isinstance(each, type) and issubclass(each, Controller) and each.__module__ == module.__name__
    }
    wanted = [each for each in here.values() if hasattr(each, "level") and not inspect.isabstract(each)]
    if len(wanted) != 1:
        names = ", ".join(here) or "none"
        one = "one class derived from Controller, with a level and an update"
        raise BadConfig(f"{what}: expected {one}; there are: {names}", field="class", value=names, expected=one)
    return wanted[0]


def where(error: BaseException, path: str) -> str:
    """The error in a line, with file and line number of the user's file where it passed through that."""
    text = f"{type(error).__name__}: {error}"
    if isinstance(error, SyntaxError):
        return f"{error.filename}:{error.lineno}: {type(error).__name__}: {error.msg}"
    own = Path(path).resolve()
    frames = traceback.extract_tb(error.__traceback__)
    for frame in reversed(frames):
        if Path(frame.filename).resolve() == own:
            return f"{path}:{frame.lineno}: {text} (in {frame.name}: {frame.line})"
    if isinstance(error, BadConfig) or not frames:
        return str(error)
    return f"{frames[-1].filename}:{frames[-1].lineno}: {text}"
