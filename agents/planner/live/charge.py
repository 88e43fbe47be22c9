"""Which planner is in charge: a term that only grows, heartbeats and a token. No clock and no network here.

The planner in charge says so several times a second, says its book once a second at least, and holds a liveliness
token; what is lost of them for a few seconds does no harm. Each that takes charge counts the term up by one, and among
those who believe to be in charge the highest (term, with goals or without, instance) is; the others stand by as soon as
they hear of it. Nobody relies on that alone: a vehicle is commanded by who holds its lease, and it gives one at a time.
"""

from __future__ import annotations

from dataclasses import dataclass, field

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


@dataclass
class Charge:
    """One planner's view. ``now`` is in monotonic seconds; ``instance`` tells its process from every other."""

    name: str
    instance: str
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
    _tokens: set[str] = field(default_factory=set)
    """the instances of those whose token says that they are in charge"""
    _others: set[str] = field(default_factory=set)
    """and of those who stand by"""

    @property
    def in_charge(self) -> bool:
        return self.term > 0

    def token(self, instance: str, present: bool, in_charge: bool = True) -> None:
        """Another's token came or went: of being in charge, or of standing by."""
        if instance == self.instance:
            return
        tokens = self._tokens if in_charge else self._others
        if present:
            tokens.add(instance)
        else:
            tokens.discard(instance)

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
        held = self.book is not None and self.book.instance in self._tokens
        somebody = held if self.book is not None else bool(self._tokens or self._others)
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
