"""The controller's own process: one cycle in, one output out. Knows nothing of networks; ends with its supervisor.

    python -m agents.controllers.host FD

It loads what it is told to, tries it out on one cycle, and waits. Its supervisor keeps another one warm beside it, so
that a saved file is loaded there while this one flies.
"""

from __future__ import annotations

import base64
import copy
import gc
import pickle
import signal
import socket
import sys
import time
from typing import Any

import msgspec
import numpy as np

from agents.controllers import packets
from agents.controllers.loading import load, where
from agents.controllers.stack import Stack
from agents.controllers.types import OUTPUTS, Output, Reference, State, Trim

LOOKING_ON, IN_FORCE = 0, 1
"""a cycle's phase; in any other its output goes out, and nothing is remembered from cycle to cycle"""
TRIAL = 1.0
"""s for the cycle on which a controller is tried out"""
COLLECT_EVERY = 500
"""cycles between two looks for garbage, after an output has gone out"""


class Host:
    """Answers a supervisor on a socket that keeps datagrams apart."""

    def __init__(self, line: socket.socket) -> None:
        self._line = line
        self._what = ""
        self._stack: Stack | None = None
        self._kept: dict[str, Any] | None = None
        self._names: tuple[str, ...] = ()
        self._failed = False
        self._cycles = 0

    def run(self) -> None:
        """Until the supervisor is gone."""
        gc.disable()
        while data := self._line.recv(packets.MOST):
            if data[:1] == packets.CYCLE:
                self._cycle(data)
            else:
                self._hear(packets.heard(data))

    # Cycles.

    def _cycle(self, data: bytes) -> None:
        begun = time.perf_counter()
        number, phase, state, reference, trim = packets.unpack_cycle(data)
        try:
            output = self._step(phase, state, reference, trim)
            signals = self._signals()
            answer = packets.pack_output(number, time.perf_counter() - begun, output, signals)
            self._failed = False
        except Exception as e:
            if not self._failed or phase:  # while it only looks on, once is enough
                self._say(failed=f"{type(e).__name__}: {e}")  # at once: to find out where takes longer than some cycles
                self._say(because=where(e, self._what))
            self._failed = True
            return
        self._tell_names(tuple(signals))
        self._line.send(answer)
        self._cycles += 1
        if self._cycles % COLLECT_EVERY == 0:
            gc.collect(1)

    def _step(self, phase: int, state: State, reference: Reference, trim: Trim) -> Output | None:
        stack = self._stack
        if stack is None:
            return None
        if phase != IN_FORCE or self._kept is not None:
            stack.reset(state, reference, trim)
            if self._kept is not None:
                stack.keep(self._kept)
                self._kept = None
        if phase == LOOKING_ON:
            return None
        return checked(stack.update(state, reference), stack.controller.gives)

    def _signals(self) -> dict[str, float]:
        return {} if self._stack is None else self._stack.signals

    def _tell_names(self, names: tuple[str, ...]) -> None:
        if names != self._names:
            self._names = names
            self._say(names=names)

    # What it is told.

    def _hear(self, said: dict[str, Any]) -> None:
        if "load" in said:
            self._load(**said["load"])
        elif "tune" in said and self._stack is not None:
            self._stack.tune(**said["tune"])
        elif "keep" in said and self._stack is not None:
            self._kept = pickle.loads(base64.b64decode(said["keep"]))
        elif "give" in said and self._stack is not None:
            self._say(kept=base64.b64encode(pickle.dumps(self._stack.kept())).decode())

    def _load(self, what: str, cls: str, tuned: dict[str, float]) -> None:
        self._what = what
        try:
            stack = Stack(load(what, cls)())
            for name, value in tuned.items():
                if name in stack.tunables:
                    stack.tune(name, value)
            _try(copy.deepcopy(stack))
        except BaseException as e:  # whatever a user's file does: even sys.exit()
            self._say(broken=where(e, what))
            return
        self._stack = stack
        gc.collect()
        gc.freeze()
        kind = stack.controller
        self._say(
            loaded=type(kind).__name__, level=kind.level, gives=kind.gives, doc=(type(kind).__doc__ or "").strip(),
            tunables={name: msgspec.to_builtins(each) for name, each in stack.tunables.items()},
        )  # fmt: skip

    def _say(self, **what: Any) -> None:
        self._line.send(packets.talk(**what))


def checked(output: object, gives: str) -> Output:
    """The output itself; raises TypeError or ValueError where it is not what the class says that it gives, or has
    numbers that are none.
    """
    expected = OUTPUTS[gives]
    if not isinstance(output, expected):
        raise TypeError(f"update() gave {output!r}; expected a {expected.__name__}, as gives = {gives!r} says")
    for name, value in vars(output).items():
        if value is not None and not np.isfinite(np.asarray(value, dtype=float)).all():
            raise ValueError(f"update() gave {name} = {value}, which is not finite")
    return output


def _try(stack: Stack) -> None:
    """One cycle at a hover: what is wrong with every cycle shows before it flies. Raises what it raises, and
    TimeoutError where it does not end.
    """

    def too_long(number: int, frame: object) -> None:
        raise TimeoutError(f"one cycle took longer than {TRIAL:g} s")

    signal.signal(signal.SIGALRM, too_long)
    signal.setitimer(signal.ITIMER_REAL, TRIAL)
    try:
        _one_cycle(stack)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def _one_cycle(stack: Stack) -> None:
    state, reference, trim = State(), Reference(level=stack.controller.level), Trim()
    state.sticks[2] = 0.5
    stack.reset(state, reference, trim)
    packets.pack_output(0, 0.0, checked(stack.update(state, reference), stack.controller.gives), stack.signals)


def main() -> None:
    with socket.socket(fileno=int(sys.argv[1])) as line:
        Host(line).run()


if __name__ == "__main__":
    main()
