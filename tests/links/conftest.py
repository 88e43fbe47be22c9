"""A link under watch: everything it delivers and says, with waits that end on the event itself."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator

import pytest

from zmav.links import Link, LinkState, open_link

PATIENCE_S = 30.0  # how long an event may take on a busy machine before the test fails


class Watched:
    """A started link, with the pieces of data and the states it reported so far."""

    def __init__(self, link: Link) -> None:
        self.link = link
        self.pieces: list[bytes] = []
        self.states: list[tuple[LinkState, str]] = []
        self._changed = threading.Condition()
        link.start(self._on_data, self._on_state)

    def _on_data(self, data: bytes) -> None:
        with self._changed:
            self.pieces.append(data)
            self._changed.notify_all()

    def _on_state(self, state: LinkState, detail: str) -> None:
        with self._changed:
            self.states.append((state, detail))
            self._changed.notify_all()

    @property
    def data(self) -> bytes:
        return b"".join(self.pieces)

    def until(self, condition: Callable[[], bool], what: str) -> None:
        """Wait until ``condition`` holds; it is asked again after each piece of data and each state."""
        with self._changed:
            assert self._changed.wait_for(condition, PATIENCE_S), f"no {what}; states: {self.states}"

    def expect_data(self, data: bytes) -> None:
        """Wait for as many bytes as ``data`` has, and see that they are these."""
        self.until(lambda: len(self.data) >= len(data), f"{len(data)} bytes (had {len(self.data)})")
        assert self.data == data

    def expect_state(self, state: LinkState, words: str = "", after: int = 0) -> int:
        """Wait for a state with ``words`` in its detail among ``states[after:]``; the index behind it."""
        found: list[int] = []

        def there() -> bool:
            found[:] = [
                index + 1
                for index, (seen, detail) in enumerate(self.states)
                if index >= after and seen is state and words in detail
            ]
            return bool(found)

        self.until(there, f"{state} with {words!r}")
        return found[0]


Watch = Callable[[str | Link], Watched]


@pytest.fixture
def watch() -> Iterator[Watch]:
    """Start a link (or the link of a URL) under watch; closed at the end, and its thread must be gone then."""
    watched: list[Watched] = []

    def start(link: str | Link) -> Watched:
        watched.append(Watched(open_link(link) if isinstance(link, str) else link))
        return watched[-1]

    yield start
    names = {f"link {one.link.url}" for one in watched}
    for one in watched:
        one.link.close()
        assert one.link.state is LinkState.CLOSED
    assert not [thread.name for thread in threading.enumerate() if thread.name in names]


@pytest.fixture
def frames() -> Callable[[int], list[bytes]]:
    """The first N of a series of different MAVLink 2 frames of various lengths (their checksums are not true)."""

    def make(count: int) -> list[bytes]:
        return [
            bytes([0xFD, 4 + n % 40, 0, 0, n % 256, 1, 1, 30, 0, 0])
            + n.to_bytes(4, "big")
            + bytes(n % 40)
            + b"\x12\x34"
            for n in range(count)
        ]

    return make
