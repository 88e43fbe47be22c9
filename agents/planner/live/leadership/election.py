"""Which planner is in charge: a term that only grows, heartbeats and a token. No clock and no network here.

The planner in charge says so several times a second, says its book once a second at least, and holds a liveliness
token; what is lost of them for a few seconds does no harm. Each that takes charge counts the term up by one, and among
those who believe to be in charge the highest (term, with goals or without, instance) is; the others stand by as soon as
they hear of it. Nobody relies on that alone: a vehicle is commanded by who holds its lease, and it gives one at a time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

from zmav.tokens import TokenTable
from zmav.wire import swarm

HEARTBEAT, BEAT = 1.0, 0.3
"""s between two books, of which a bad network loses most, for they are long; and between two words on who is in charge
alone
"""
PATIENCE = 3.0
"""s without a word or a token after which a standby takes over"""
SILENCE = 5.0
"""s more without a word after which a planner is gone, whatever its token says: a half dead link keeps tokens. So much
longer waits, too, who has no book to go on from, while there are others: one of them may have it
"""


class Token(NamedTuple):
    """What a planner's token says: which process it is of, and that it is in charge, or stands by."""

    instance: str
    in_charge: bool


@dataclass
class LeaderElection:
    """One planner's view. ``now`` is in monotonic seconds; ``instance`` tells its process from every other.

    ``is_planner(name)``: whose tokens count. So many of each are remembered, that of the planner in charge always.
    """

    name: str
    instance: str
    is_planner: Callable[[str], bool]
    patience: float = PATIENCE
    term: int = 0
    """0: stands by"""
    book: swarm.Book | None = None
    """the last of the planner in charge, while we stand by"""
    highest: int = 0
    goals: bool = False
    """there are some in our book, while we are in charge"""
    _heard: float = -1e9
    _since: float | None = None
    tokens: TokenTable[str, Token] = field(init=False)

    def __post_init__(self) -> None:
        self.tokens = TokenTable(self.is_planner, lambda token: token == self._held)

    @property
    def in_charge(self) -> bool:
        return self.term > 0

    @property
    def _held(self) -> Token | None:
        """The token of the planner in charge."""
        return Token(self.book.instance, True) if self.book is not None else None

    def token(self, name: str, token: Token, present: bool) -> None:
        """Another's token came or went."""
        if token.instance == self.instance:
            return
        key = f"{token.instance} {token.in_charge}"
        if present:
            self.tokens.add(name, key, token)
        else:
            self.tokens.remove(name, key)

    def hear(self, book: swarm.Book, now: float) -> bool:
        """Another's book came. True: it is in charge and we are not any more."""
        if book.instance == self.instance:
            return False
        self.highest = max(self.highest, book.term)
        if self.in_charge:
            if _rank(book) <= (self.term, self.goals, self.instance):
                return False  # it hears ours within a second, and stands by
            self.term = 0
            self.book, self._heard = book, now
            return True
        known = self.book
        if known is not None and book.instance != known.instance and _rank(book) < _rank(known):
            # One that has just been started and heard of nobody has nothing in its book: we go on from ours.
            emptied = bool(known.goals) and not book.goals
            if emptied or not self.lost(now):
                return False
        self.book, self._heard = book, now
        return False

    def beat(self, told: swarm.Charge, now: float) -> None:
        """Another's word that it is in charge: as good as its book, but that there is nothing to go on from in it."""
        if told.instance == self.instance:
            return
        self.highest = max(self.highest, told.term)
        if self.book is None or told.term > self.book.term or told.instance == self.book.instance:
            self._heard = now

    def lost(self, now: float) -> bool:
        """Nobody is in charge as far as we hear: no word for a while, and no token either, or not for long."""
        self._since = now if self._since is None else self._since
        silent = now - max(self._heard, self._since)
        if self.book is not None:
            somebody = self._held in self.tokens.of(self.book.planner)
        else:
            somebody = any(True for _ in self.tokens)
        return silent > (self.patience + SILENCE if somebody else self.patience)

    def take(self) -> swarm.Book | None:
        """Take charge: the book to go on from, where there is one."""
        self.term = self.highest = self.highest + 1
        book, self.book = self.book, None
        return book

    @property
    def of(self) -> str:
        """Who is in charge, by name; empty: nobody that we know of."""
        if self.in_charge:
            return self.name
        return self.book.planner if self.book else ""


def _rank(book: swarm.Book) -> tuple[int, bool, str]:
    return book.term, bool(book.goals), book.instance
