"""``host``: how the computer is on which this runs, for ``zmav doctor``. Nothing is looked at until somebody asks."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import zenoh

from zmav import keys, wire
from zmav.host import report
from zmav.services.queries.questions import Questions, Reply


class HostService:
    """Answers in the lane of questions; ``paths`` are on the file systems that matter here."""

    def __init__(
        self, questions: Questions, instance: str, fleet: str, name: str, paths: Iterable[str | Path] = ()
    ) -> None:
        self._instance, self._name, self._paths = instance, name, ("/", *paths)
        self._key = keys.HOST.key(fleet, name)
        questions.declare(self._key, self._answer)

    def _answer(self, query: zenoh.Query) -> Iterator[Reply]:
        yield Reply(self._key, wire.encode(report(self._name, self._instance, self._paths)))
