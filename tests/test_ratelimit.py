"""What is let through once in a while: for each, counted, and bounded no matter who comes."""

from __future__ import annotations

from zmav.ratelimit import RateLimit


def test_each_is_let_through_once_in_a_while_and_the_rest_counted() -> None:
    now = [0.0]
    seldom: RateLimit[str] = RateLimit(1.0, 10, lambda: now[0])
    assert [seldom.take("a") for _ in range(5)] == [0, None, None, None, None]
    assert seldom.take("b") == 0
    now[0] = 1.0
    assert seldom.take("a") == 4 and seldom.take("a") is None


def test_a_flood_of_new_ones_is_bounded_and_room_comes_again() -> None:
    now = [0.0]
    seldom: RateLimit[int] = RateLimit(1.0, 10, lambda: now[0])
    assert sum(seldom.take(n) is not None for n in range(10_000)) == 10 == len(seldom)
    now[0] = 1.0
    assert sum(seldom.take(n) is not None for n in range(10_000)) == 10 == len(seldom)


def test_the_first_one_is_let_through_whatever_the_clock_says() -> None:
    now = [0.0]
    for now[0] in (0.0, 0.3, 12345.678, 987654.321, 1e9 / 3.0):
        seldom: RateLimit[str] = RateLimit(0.4, 10, lambda: now[0])
        assert seldom.take("a") == 0
