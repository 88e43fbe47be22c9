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
    """The event loop went round, and so did what runs beside it: not told, one of them hangs."""


class ListenerFailed(NamedTuple):
    """A listener raised; the others were told all the same."""

    what: object
    error: Exception


class Bus:
    """Tells each thing that happens to all that listen to its type, in the order in which they began to. Any thread.

    The type is what says what happened, and who tells it and from which thread; it stands beside its teller.
    """

    def __init__(self) -> None:
        self._listeners: dict[type, tuple[Callable[[Any], object], ...]] = {}
        self._listening = threading.Lock()

    def on(self, kind: type[E], listener: Callable[[E], object]) -> None:
        """Have ``listener`` called with each ``kind`` from now on."""
        with self._listening:
            self._listeners[kind] = (*self._listeners.get(kind, ()), listener)

    def tell(self, what: object) -> None:
        """Call all that listen to the type of ``what``. One that raises keeps no other from hearing of it: its error is
        told as :class:`ListenerFailed`, or raised afterwards where nobody listens to that.
        """
        failed: Exception | None = None
        for listener in self._listeners.get(type(what), ()):
            try:
                listener(what)
            except Exception as e:
                failed = self._tell_of(what, e) or failed
        if failed is not None:
            raise failed

    def _tell_of(self, what: object, error: Exception) -> Exception | None:
        """What is to be raised still."""
        if isinstance(what, ListenerFailed) or ListenerFailed not in self._listeners:
            return error
        try:
            self.tell(ListenerFailed(what, error))
        except Exception as e:
            return e
        return None
