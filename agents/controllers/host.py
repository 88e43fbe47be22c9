"""The controller's own process: one cycle in, one output out. Knows nothing of networks; ends with its supervisor.

    python -m agents.controllers.host FD

It loads what it is told to, tries it out on one cycle, and waits. A saved file is loaded in another one, while this one
flies.
"""

from __future__ import annotations

import gc
import os
import select
import signal
import socket
import sys
import threading
from typing import Any

import msgspec
import numpy as np

from agents.controllers import packets
from agents.controllers.controller import Controller
from agents.controllers.loading import load, where
from agents.controllers.signals import inner_signals
from agents.controllers.stack import Stack
from agents.controllers.types import OUTPUTS, Output, Reference, State, Trim

LOOKING_ON, IN_FORCE = 0, 1
"""a cycle's phase; in any other its output goes out, and nothing is remembered from cycle to cycle"""
TRIAL = 1.0
"""s for the cycle on which a controller is tried out"""
MOST_TEXT = 2000
"""characters of what is said of an error"""
COLLECT_EVERY = 500
"""cycles between two looks for garbage, after an output has gone out"""


class ControllerProcess:
    """Answers a supervisor on a socket that keeps datagrams apart."""

    def __init__(self, line: socket.socket) -> None:
        self._line = line
        self._what = ""
        self._stack: Stack | None = None
        self._begun = False
        """it was reset by a cycle"""
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
                self._hear(packets.unpack_message(data))

    # Cycles.

    def _cycle(self, data: bytes) -> None:
        number, phase, state, reference, trim = packets.unpack_cycle(data)
        try:
            output, stack = self._step(phase, state, reference, trim), self._stack
            signals = {} if stack is None else {**inner_signals(stack.followed), **stack.signals}
            answer = packets.pack_output(number, output, signals)
            self._failed = False
        except Exception as e:
            if not self._failed or phase:  # while it only looks on, once is enough
                said = f"{type(e).__name__}: {e}"[:MOST_TEXT]
                self._say(failed=said)  # at once: to find out where takes longer than some cycles
                self._say(because=where(e, self._what)[:MOST_TEXT])
            else:
                self._line.send(packets.pack_output(number, None, {}))
            self._failed = True
            return
        if tuple(signals) != self._names:
            self._names = tuple(signals)
            self._say(names=self._names)
        self._line.send(answer)
        self._cycles += 1
        if self._cycles % COLLECT_EVERY == 0:
            gc.collect(1)

    def _step(self, phase: int, state: State, reference: Reference, trim: Trim) -> Output | None:
        stack = self._stack
        if stack is None:
            return None
        if phase != IN_FORCE or not self._begun:
            stack.reset(state, reference, trim)
            self._begun = True
        if phase == LOOKING_ON:
            return None
        return checked(stack.update(state, reference), stack.controller.gives)

    # What it is told.

    def _hear(self, said: dict[str, Any]) -> None:
        if "load" in said:
            self._load(**said["load"])
        elif "tune" in said and self._stack is not None:
            try:
                self._stack.tune(**said["tune"])
            except Exception as e:  # a class may have a tune() of its own
                self._say(because=f"not tuned: {where(e, self._what)}"[:MOST_TEXT])

    def _load(self, what: str, tuned: dict[str, float]) -> None:
        self._what = what
        try:
            kind = load(what)
            _try(_made(kind, tuned))  # on one of its own: what it does there is not to be seen in flight
            self._stack = stack = _made(kind, tuned)
        except BaseException as e:  # whatever a user's file does: even sys.exit()
            self._say(broken=where(e, what)[:MOST_TEXT])
            return
        gc.collect()
        gc.freeze()
        self._say(
            loaded=kind.__name__,
            level=kind.level,
            gives=kind.gives,
            doc=(kind.__doc__ or "").strip(),
            tunables={name: msgspec.to_builtins(each) for name, each in stack.tunables.items()},
        )

    def _say(self, **what: Any) -> None:
        self._line.send(packets.pack_message(**what))


def _made(kind: type[Controller], tuned: dict[str, float]) -> Stack:
    stack = Stack(kind())
    for name, value in tuned.items():
        if name in stack.tunables:
            stack.tune(name, value)
    return stack


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
        state, reference, trim = State(), Reference(level=stack.controller.level), Trim()
        state.sticks[2] = 0.5
        stack.reset(state, reference, trim)
        packets.pack_output(0, checked(stack.update(state, reference), stack.controller.gives), stack.signals)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def _end_with(line: socket.socket) -> None:
    """A user's loop without an end does not outlive the supervisor."""
    gone = select.poll()
    gone.register(line, 0)  # its other end is closed: nothing else is waited for
    gone.poll()
    os._exit(0)


def main() -> None:
    with socket.socket(fileno=int(sys.argv[1])) as line:
        threading.Thread(target=_end_with, args=(line,), daemon=True).start()
        ControllerProcess(line).run()


if __name__ == "__main__":
    main()
