"""Callbacks straight on the thread of Zenoh's that reads the network.

Zenoh's default gives each subscriber a thread of its own, which is woken for every sample. What only hands over, or is
as quick as that, needs none.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable
from typing import Any

from zenoh import handlers


def direct(call: Callable[[Any], object], end: Callable[[], object] | None = None) -> Any:
    """A handler for ``declare_subscriber`` and ``get`` that has ``call`` called on Zenoh's own thread, and ``end`` when
    nothing more comes.

    ``call`` must be quick, must not raise, and must not wait for anything of Zenoh's: nothing else is read meanwhile.
    """
    seen: set[int] = set()

    def called(item: Any) -> None:
        thread = threading.get_ident()
        if thread not in seen:
            seen.add(thread)
            _keep_state()
        call(item)

    return handlers.Callback(called, end, indirect=False)


def _keep_state() -> None:
    """Have this thread's Python state outlive the callback: else each call makes one, maps memory for its frames, and
    unmaps it. Zenoh's threads are few and last as long as the process.
    """
    ctypes.pythonapi.PyGILState_Ensure()
