"""The planner's book: every goal it was given, in order, and what becomes of each. No clock and no network in here."""

from __future__ import annotations

from collections.abc import Callable

import msgspec

from zmav.errors import BadInput
from zmav.wire import swarm

ENDED = ("done", "failed", "cancelled")
"""states that are the last"""
MOST_ENDED, MOST_OPEN = 10, 200
"""goals that have ended and are still told of; goals that wait"""


def kind_of(goal: swarm.Goal) -> str:
    """As it is called on the wire."""
    return str(type(goal).__struct_config__.tag)


class GoalBook:
    """A goal has its vehicles for itself: of two that share one the later waits (``queue``) or takes its place."""

    def __init__(self) -> None:
        self.goals: list[swarm.GoalEntry] = []
        self._count = 0

    # What is asked.

    def add(self, goal: swarm.Goal, when: str, t: float, term: int, by: str = "") -> swarm.GoalEntry:
        """Enter a goal; ``now`` cancels those that share a vehicle with it. Raises :class:`BadInput` when full."""
        if len(self.open) >= MOST_OPEN:
            text = f"the book is full: {MOST_OPEN} goals have not ended yet; cancel some"
            raise BadInput(text, field="goal", value=MOST_OPEN, expected=f"fewer than {MOST_OPEN}")
        self._count += 1
        known = {entry.id for entry in self.goals}
        while (name := f"g{term}-{self._count}") in known:
            self._count += 1
        if when == "now":
            for other in self.sharing(goal.vehicles):
                self.end(other, "cancelled", f"{name} took its place")
        entry = swarm.GoalEntry(id=name, goal=goal, state="queued", t=t, by=by, text="waits for its turn")
        self.goals.append(entry)
        return entry

    def sharing(self, vehicles: list[str]) -> list[swarm.GoalEntry]:
        """The goals that have not ended and have one of these vehicles."""
        wanted = set(vehicles)
        return [entry for entry in self.open if wanted & set(entry.goal.vehicles)]

    def find(self, name: str) -> list[swarm.GoalEntry]:
        """The goal of that id, or all that have not ended where it is empty. Raises :class:`BadInput` for no such."""
        if not name:
            return self.open
        found = [entry for entry in self.goals if entry.id == name]
        if not found:
            known = ", ".join(entry.id for entry in self.goals) or "none"
            raise BadInput(f"no goal {name}; in the book are: {known}", field="goal", value=name, expected=known)
        return found

    # What happens.

    def ready(self) -> list[swarm.GoalEntry]:
        """The goals that wait and share no vehicle with an earlier one that has not ended."""
        found, taken = [], set[str]()
        for entry in self.open:
            if entry.state == "queued" and not taken & set(entry.goal.vehicles):
                found.append(entry)
            taken |= set(entry.goal.vehicles)
        return found

    @property
    def open(self) -> list[swarm.GoalEntry]:
        """The goals that have not ended."""
        return [entry for entry in self.goals if entry.state not in ENDED]

    def end(self, entry: swarm.GoalEntry, state: swarm.GoalState, text: str) -> None:
        """It is over; one that has ended before stays as it ended."""
        if entry.state in ENDED:
            return
        entry.state, entry.text, entry.landing = state, text, {}
        if state == "done":
            entry.progress = 1.0
        ended = [each for each in self.goals if each.state in ENDED]
        for each in ended[: max(0, len(ended) - MOST_ENDED)]:
            self.goals.remove(each)

    def take_over(self, book: swarm.Book, check: Callable[[swarm.Goal], None]) -> list[swarm.GoalEntry]:
        """Go on from another planner's book; the goals that are to be begun again, from wherever their vehicles are.
        One that nobody could have given, for which ``check`` raises :class:`BadInput`, has failed.
        """
        self.goals = [msgspec.structs.replace(entry) for entry in book.goals]
        for entry in self.open:
            try:
                check(entry.goal)
            except BadInput as e:
                self.end(entry, "failed", f"not taken over from {book.planner}: {e.message}")
        again = self.open
        for entry in again:
            entry.state = "paused" if entry.state == "paused" else "queued"
            entry.text = f"taken over from {book.planner}"
            entry.makespan = entry.clearance = None
        return again
