"""The queue before a radio with a budget: short, fair, and probes first."""

from __future__ import annotations

from mesh.bearer.shaper import FEWEST, MOST_FIRST, QUEUE, Shaper

RATE = 100e3


def drained(shaper: Shaper[str], start: float, seconds: float) -> list[str]:
    """What leaves within so long, asked as often as it says."""
    left: list[str] = []
    now = start
    while now < start + seconds:
        left += shaper.take(now)
        wait = shaper.wait(now)
        if wait is None:
            break
        now += max(wait, 1e-6)
    return left


def test_what_comes_too_fast_leaves_at_the_budget_in_order_and_the_rest_is_refused() -> None:
    shaper: Shaper[str] = Shaper(RATE, 0.0)
    taken = [n for n in range(100) if shaper.put("a", str(n), 1000)]
    assert len(taken) == FEWEST * 1500 // 1000
    assert drained(shaper, 0.0, 10.0) == [str(n) for n in taken]
    assert shaper.wait(10.0) is None and len(shaper) == 0


def test_what_waits_is_worth_thirty_milliseconds() -> None:
    shaper: Shaper[str] = Shaper(1e6, 0.0)
    while shaper.put("a", "", 1000):
        pass
    assert len(shaper) == QUEUE * 1e6


def test_a_flood_to_one_neighbour_takes_nothing_from_another() -> None:
    shaper: Shaper[str] = Shaper(RATE, 0.0)
    left: list[str] = []
    now, refused = 0.0, 0
    for step in range(2000):
        now = step / 1000  # 1 MB/s for one, 10 kB/s for the other, through 100 kB/s
        shaper.put("flood", "flood", 1000)
        if step % 20 == 0:
            refused += not shaper.put("quiet", "quiet", 200)
        left += shaper.take(now)
    assert refused == 0
    assert left.count("quiet") >= 99
    assert 150 <= left.count("flood") <= 195


def test_two_floods_share_by_bytes_and_not_by_datagrams() -> None:
    shaper: Shaper[str] = Shaper(RATE, 0.0)
    left: list[str] = []
    for step in range(3000):
        for _ in range(4):
            shaper.put("small", "small", 300)
        shaper.put("large", "large", 1500)
        left += shaper.take(step / 1000)
    ratio = 300 * left.count("small") / (1500 * left.count("large"))
    assert 0.8 < ratio < 1.25


def test_probes_go_before_what_waits_and_are_few() -> None:
    shaper: Shaper[str] = Shaper(RATE, 0.0)
    for n in range(4):
        shaper.put("a", f"data {n}", 1400)
    assert list(shaper.take(0.0)) == ["data 0", "data 1"]
    assert all(shaper.put_first("probe", 45) for _ in range(MOST_FIRST))
    assert not shaper.put_first("one too many", 45)
    assert drained(shaper, 0.1, 1.0)[:MOST_FIRST] == ["probe"] * MOST_FIRST
