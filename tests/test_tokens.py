"""Liveliness tokens that are remembered: bounded for each, by dictionary, and room for who is known."""

from __future__ import annotations

from zmav.tokens import OF_EACH, STRANGERS, TokenTable


class Counting(str):
    """A key that counts how often it is compared: a scan would be seen."""

    compared = 0

    def __eq__(self, other: object) -> bool:
        Counting.compared += 1
        return str.__eq__(self, other)

    __hash__ = str.__hash__


def test_a_flood_of_one_is_bounded_and_each_costs_the_same() -> None:
    present: TokenTable[str, int] = TokenTable(lambda who: True)
    Counting.compared = 0
    flood = [Counting(f"token {n}") for n in range(10_000)]
    for n, key in enumerate(flood):
        present.add("quad1", key, n)
    assert len(present) == OF_EACH
    assert present.add("quad2", "token", 1) and list(present) == ["quad1", "quad2"]
    assert len(present) == OF_EACH + 1
    for key in flood:
        present.remove("quad1", key)
    assert list(present) == ["quad2"] and present.of("quad1") == []
    assert Counting.compared <= 2 * len(flood), "looked up, and not looked for"


def test_the_true_one_is_seen_among_many_that_came_before() -> None:
    """And after it, where it is worth more: who floods us may begin whenever he likes."""
    present: TokenTable[str, str] = TokenTable(lambda who: True, lambda what: what == "true")
    for n in range(100):
        present.add("quad1", f"before {n}", "forged")
    assert present.crowded() == ["quad1"]
    assert present.add("quad1", "token", "true") and "true" in present.of("quad1")
    for n in range(100):
        present.add("quad1", f"after {n}", "forged")
    assert "true" in present.of("quad1") and len(present) == OF_EACH
    present.settle("quad1")
    assert present.crowded() == []
    alike: TokenTable[str, int] = TokenTable(lambda who: True)
    for n in range(100):
        alike.add("quad1", f"{n}", n)
    assert alike.of("quad1") == list(range(100 - OF_EACH, 100)), "of equals the newest"


def test_names_nobody_knows_have_little_room_and_take_none_from_the_known() -> None:
    known = {"quad1"}
    present: TokenTable[str, None] = TokenTable(known.__contains__)
    assert sum(present.add(f"ghost{n}", "token", None) for n in range(10_000)) == STRANGERS
    assert list(present) == [] and len(present.strangers()) == STRANGERS
    assert present.add("quad1", "token", None) and list(present) == ["quad1"]
    known.add("ghost0")
    assert list(present) == ["ghost0", "quad1"], "it was admitted meanwhile"
    assert present.add("ghost-next", "token", None), "and has left its place to another"
    assert present.remove("ghost1", "token") and not present.remove("ghost1", "token")
    assert len(present.strangers()) == STRANGERS - 1


def test_the_same_token_twice_is_one() -> None:
    present: TokenTable[str, str] = TokenTable(lambda who: True)
    assert present.add("quad1", "token", "a") and not present.add("quad1", "token", "a")
    assert present.of("quad1") == ["a"] and "quad1" in present
    assert present.remove("quad1", "token") and "quad1" not in present
