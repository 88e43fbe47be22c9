"""Where the scene is drawn: what is put on a path within one step is logged once, the last of it."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import rerun as rr

logger = logging.getLogger(__name__)
Path = tuple[str, ...]
NED: Path = ("world", "ned")
VEHICLES: Path = (*NED, "vehicles")


class Canvas:
    """Draws into a recording. Call :meth:`flush` at most ten times a second: no path is then logged more often."""

    def __init__(self, recording: rr.RecordingStream) -> None:
        self.recording = recording
        self._pending: dict[Path, rr.AsComponents] = {}
        self._lines: list[tuple[Path, rr.AsComponents]] = []
        self._shown: set[Path] = set()
        self._names: dict[Path, str] = {}
        self.failed = 0

    def put(self, path: Path, what: rr.AsComponents | None) -> None:
        """Draw it in place of what was there; None: nothing."""
        if what is None:
            self.clear(path)
        else:
            self._pending[path] = what
            self._shown.add(path)

    def clear(self, path: Path) -> None:
        """Nothing is there any more; where nothing was, nothing is logged."""
        if path in self._shown:
            self._shown.discard(path)
            self._pending[path] = rr.Clear(recursive=False)

    def fixed(self, path: Path, *what: rr.AsComponents) -> None:
        """What is the same at all times, and known to anyone who looks later; logged at once."""
        self._log(path, what, static=True)

    def line(self, path: Path, what: rr.AsComponents) -> None:
        """A line of a log, of which every one counts."""
        self._lines.append((path, what))

    def flush(self, t: float) -> int:
        """Log what was put, as of ``t`` (UTC seconds), which the timeline ``time`` shows; how much it was."""
        self.recording.set_time("time", timestamp=t)
        pending, lines = self._pending, self._lines
        self._pending, self._lines = {}, []
        for path, what in (*pending.items(), *lines):
            self._log(path, (what,))
        return len(pending) + len(lines)

    def _log(self, path: Path, what: Sequence[rr.AsComponents], static: bool = False) -> None:
        name = self._names.get(path)
        if name is None:
            name = self._names[path] = "/".join(rr.escape_entity_path_part(part) for part in path)
        try:
            self.recording.log(name, *what, static=static)
        except Exception:  # a value that Rerun refuses is not worth the picture of everything else
            self.failed += 1
            logger.debug("%s was not drawn", name, exc_info=True)
