"""How often a setpoint that is a command is given: a stream of commands is not a stream of targets.

The autopilot answers each, and ArduPlane begins its climb again with every DO_REPOSITION: repeated at 20 Hz it never
leaves its height (measured); at 1 Hz it climbs as after one alone.
"""

from __future__ import annotations

from zmav.autopilots import Action, Message

REPEAT_AFTER = 1.0
"""s until the same is said again: it may have been lost"""
RESTARTING = ("MAV_CMD_DO_REPOSITION",)
"""commands that begin something again: not even a changed one is given sooner"""


class Pace:
    """Tells which of a stream's actions are due. For one vehicle; its caller has the lock."""

    def __init__(self) -> None:
        self._given: dict[tuple[str, float], tuple[float, tuple[float, ...]]] = {}
        """when and with what each command was given, by its name and first parameter (a servo's number)"""

    def due(self, action: Action, now: float) -> bool:
        """Whether to give it at ``now`` (monotonic seconds); messages always are."""
        if isinstance(action, Message):
            return True
        what = (action.name, action.params[0])
        at, params = self._given.get(what, (-REPEAT_AFTER, ()))
        same = action.params == params or action.name in RESTARTING
        if same and now - at < REPEAT_AFTER:
            return False
        self._given[what] = (now, action.params)
        return True

    def reset(self) -> None:
        """Another stream begins, or the mode changed: all of it is due."""
        self._given.clear()
