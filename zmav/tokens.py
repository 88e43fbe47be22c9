"""Which liveliness tokens there are, by whom they are about: so many of each and no more, each found at once."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

import zenoh

from zmav.direct import direct

Who = TypeVar("Who")
What = TypeVar("What")
OF_EACH = 16
"""tokens of one that are remembered: a process has one, and who has more wants to fill our memory"""
STRANGERS = 64
"""names that are not known to be anybody's, and whose tokens are remembered until it is known"""
MOST_FOUND = 10_000
"""tokens that are told of at a time"""


def find_tokens(session: zenoh.Session, key: str, timeout: float, complete: bool = False) -> list[str]:
    """The keys of those tokens that ``session`` finds within ``timeout`` seconds. Not from Zenoh's own threads.

    ``complete``: raise TimeoutError where there may be more of them.

    With the default channel, which holds 256 replies, a router that knows more would wait in ``get`` for ever: it
    answers itself before anybody can read.
    """
    found: list[str] = []
    over, cut = threading.Event(), threading.Event()

    def on_reply(reply: zenoh.Reply) -> None:
        if reply.ok is not None and len(found) < MOST_FOUND:
            found.append(str(reply.ok.key_expr))
        else:
            cut.set()  # an error reply: Zenoh's own, as the time was over

    session.liveliness().get(key, direct(on_reply, over.set), timeout=timeout)
    if (not over.wait(timeout + 1.0) or cut.is_set()) and complete:
        raise TimeoutError(f"not all tokens of {key} were found within {timeout:g} s")
    return found


class TokenTable(Generic[Who, What]):
    """What each token says, by whom it is about and by its key.

    ``is_known(who)``: there is always room for them; of others there is room for :data:`STRANGERS`. Of one's tokens the
    newest are kept, for who floods us may have come first; but none gives way to one of less ``worth(what)``. What is
    beyond the bounds is as if it had not come. Not thread-safe.
    """

    def __init__(self, is_known: Callable[[Who], bool], worth: Callable[[What], float] = lambda what: 0.0) -> None:
        self._is_known, self._worth = is_known, worth
        self._tokens: dict[Who, dict[str, What]] = {}
        self._strangers: set[Who] = set()
        self._crowded: set[Who] = set()

    def add(self, who: Who, key: str, what: What) -> bool:
        """It is there; False where there was no room, or it was there before."""
        held = self._tokens.get(who)
        if held is None:
            if not self._is_known(who):
                self._strangers = {one for one in self._strangers if not self._is_known(one)}
                if len(self._strangers) >= STRANGERS:
                    return False
                self._strangers.add(who)
            held = self._tokens[who] = {}
        if key in held:
            return False
        if len(held) >= OF_EACH:
            if self._is_known(who):
                self._crowded.add(who)
            least = min(held, key=lambda each: self._worth(held[each]))  # the oldest of equals
            if self._worth(held[least]) > self._worth(what):
                return False
            del held[least]
        held[key] = what
        return True

    def remove(self, who: Who, key: str) -> bool:
        """It is gone; False where it was not there."""
        held = self._tokens.get(who, {})
        if key not in held:
            return False
        del held[key]
        if not held:
            del self._tokens[who]
            self._strangers.discard(who)
        return True

    def of(self, who: Who) -> list[What]:
        return list(self._tokens.get(who, {}).values())

    def strangers(self) -> list[Who]:
        """Who is present, and not known."""
        return [who for who in self._strangers if not self._is_known(who)]

    def crowded(self) -> list[Who]:
        """Who is known, and had more tokens than are remembered: the true one may be among those that gave way."""
        return sorted(self._crowded, key=str)

    def settle(self, who: Who) -> None:
        """The true one of a crowd was found."""
        self._crowded.discard(who)

    def __iter__(self) -> Iterator[Who]:
        """Who is known and present."""
        return (who for who in list(self._tokens) if self._is_known(who))

    def __len__(self) -> int:
        """How many tokens are remembered."""
        return sum(map(len, self._tokens.values()))

    def __contains__(self, who: object) -> bool:
        return who in self._tokens
