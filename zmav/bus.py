"""What happens in a program, told to those of its parts that asked for it: by its type, in the teller's thread.

What other programs are to hear of goes out on a key (:mod:`zmav.services.status.events`). What may stop something is
no listener, but an argument of the constructor (:mod:`zmav.services.authority.may_move`): nothing here permits.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

E = TypeVar("E")


class Alive(NamedTuple):
    """The event loop went round, and on a vehicle the stream watchdog, too. If it is not told, one of them hangs."""


class Bus:
    """Tells each thing that happens to all that listen to its type, in the order in which they began to. Any thread.

    The type says what happened; its docstring says from which thread it is told.
    """

    def __init__(self) -> None:
        self._listeners: dict[type, tuple[Callable[[Any], object], ...]] = {}
        self._listening = threading.Lock()

    def on(self, kind: type[E], listener: Callable[[E], object]) -> None:
        """Have ``listener`` called with each ``kind`` from now on."""
        with self._listening:
            self._listeners[kind] = (*self._listeners.get(kind, ()), listener)

    def tell(self, what: object) -> None:
        """Call all that listen to the type of ``what``. One that raises keeps no other from hearing of it; the first
        error is raised afterwards, for the teller may have to know.
        """
        failed: Exception | None = None
        for listener in self._listeners.get(type(what), ()):
            try:
                listener(what)
            except Exception as e:
                failed = failed or e
        if failed is not None:
            raise failed
