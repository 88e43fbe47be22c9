"""What a level of setpoints needs of the autopilot's parameters, held against the cache of them."""

from __future__ import annotations

from zmav.autopilots import Autopilot, Need, Target
from zmav.errors import Unsupported
from zmav.services.events import Events
from zmav.services.identity import Identity
from zmav.services.param import Params


class Needs:
    """Judges each setpoint's level; a parameter that is not known yet is not held against it. On the event loop."""

    def __init__(self, params: Params, identity: Identity, events: Events) -> None:
        self._params, self._identity, self._events = params, identity, events
        self._said: set[Need] = set()

    def check(self, autopilot: Autopilot, target: Target) -> None:
        """Raise :class:`Unsupported` with what to set where such setpoints would do nothing; say it once where they
        would do something else than they say.
        """
        for need in autopilot.needs(target):
            source = self._identity.source
            why = need.unmet(self._value, source[0]) if source else None
            if why is None:
                self._said.discard(need)
            elif need.fatal:
                raise Unsupported(why, field=target.level, value=target.level, expected=why, count="parameter")
            elif need not in self._said:
                self._said.add(need)
                self._events.emit("setpoint", "warning", f"{target.level} setpoints: {why}", why="parameter")

    def _value(self, name: str) -> float | None:
        found = self._params.get(name)
        return None if found is None else found.value
