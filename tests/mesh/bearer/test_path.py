"""Which of several paths is taken, by an invented clock."""

from __future__ import annotations

from collections.abc import Callable

from mesh.bearer.peer import HOLD, LONGEST_HOLD, Choice, Health, Path

STEP = 0.02
Works = Callable[[float], bool]


class Clock:
    """Lets time pass over paths whose probes are echoed while they work."""

    def __init__(self, *paths: tuple[Path, Works]) -> None:
        self.paths, self.choice, self.now = paths, Choice(), 1000.0

    def run(self, seconds: float) -> list[tuple[float, str]]:
        """When which path was taken, since the start of this."""
        start, taken = self.now, []
        while self.now < start + seconds:
            before = self.choice.current
            chosen = self.choice.judge([path for path, _ in self.paths], self.now)
            if chosen is not before and chosen is not None:
                taken.append((round(self.now - start, 2), chosen.name))
            for path, works in self.paths:
                if path.due(self.now) <= 0.0:
                    nonce, number = path.ask(self.now)
                    if works(self.now):
                        path.echoed(nonce, number, self.now + 0.005)
            self.now += STEP
        return taken


def always(now: float) -> bool:
    return True


def test_the_cheaper_of_two_that_carry_is_taken_and_a_silent_one_is_not() -> None:
    clock = Clock((Path("lte", 100), always), (Path("wifi", 20), always), (Path("wire", 10), lambda now: False))
    clock.run(5.0)
    assert clock.choice.current is not None and clock.choice.current.name == "wifi"


def test_a_path_that_falls_silent_is_left_within_half_a_second() -> None:
    up = True
    clock = Clock((Path("wifi", 20), lambda now: up), (Path("lte", 100), always))
    clock.run(5.0)
    up = False
    ((after, name),) = clock.run(2.0)
    assert name == "lte" and after < 0.5


def test_it_comes_back_when_it_has_been_good_for_a_while_and_not_before() -> None:
    up = True
    clock = Clock((Path("wifi", 20), lambda now: up), (Path("lte", 100), always))
    clock.run(5.0)
    up = False
    clock.run(5.0)
    up = True
    ((after, name),) = clock.run(30.0)
    assert name == "wifi" and after >= 2 * HOLD  # doubled, because it has failed


def test_the_more_often_it_fails_the_longer_it_must_be_good() -> None:
    wifi = Path("wifi", 20)
    clock = Clock((wifi, lambda now: now % 20.0 < 14.0), (Path("lte", 100), always))
    clock.run(400.0)
    assert wifi.hold == LONGEST_HOLD
    assert list(clock.run(200.0)) == []
    assert clock.choice.current is not None and clock.choice.current.name == "lte"


def test_what_has_long_been_good_is_forgiven() -> None:
    flapping = True
    wifi = Path("wifi", 20)
    clock = Clock((wifi, lambda now: not flapping or now % 20.0 < 14.0), (Path("lte", 100), always))
    clock.run(100.0)
    flapping = False
    clock.run(200.0)
    assert wifi.hold == HOLD
    assert clock.choice.current is wifi


def test_a_path_that_loses_much_gives_way_to_a_dearer_one() -> None:
    lossy = False
    count = 0

    def works(now: float) -> bool:
        nonlocal count
        count += 1
        return not lossy or count % 2 == 0

    wifi = Path("wifi", 20)
    clock = Clock((wifi, works), (Path("lte", 100), always))
    clock.run(5.0)
    lossy = True
    ((_, name),) = clock.run(6.0)
    assert name == "lte"
    assert wifi.health is Health.LIMPS


def test_a_little_loss_changes_nothing() -> None:
    count = 0

    def works(now: float) -> bool:
        nonlocal count
        count += 1
        return count % 8 != 0

    clock = Clock((Path("wifi", 20), works), (Path("lte", 100), always))
    clock.run(5.0)
    assert clock.run(60.0) == []


def test_an_address_that_nobody_wrote_down_is_only_for_when_all_others_are_silent() -> None:
    """It may be anybody's who echoes: however cheap and good it is, he takes no working way from the neighbour."""
    up, count = True, 0

    def limps(now: float) -> bool:
        nonlocal count
        count += 1
        return up and count % 2 == 0

    clock = Clock((Path("caller", 5, learned=True), always), (Path("lte", 100), limps))
    clock.run(20.0)
    assert clock.choice.current is not None and clock.choice.current.name == "lte"
    up = False
    ((_, name),) = clock.run(10.0)
    assert name == "caller"
    up = True
    ((after, name),) = clock.run(10.0)
    assert name == "lte" and after < HOLD


def test_where_all_are_silent_the_last_is_kept() -> None:
    up = True
    clock = Clock((Path("wifi", 20), lambda now: up))
    clock.run(2.0)
    up = False
    assert clock.run(20.0) == []
    assert clock.choice.current is not None


def test_an_echo_nobody_waits_for_proves_nothing() -> None:
    path = Path("wifi", 20)
    nonce, number = path.ask(0.0)
    assert not path.echoed(nonce ^ 1, number, 0.1)
    assert not path.echoed(nonce, number + 1, 0.1)
    assert path.judge(0.2) is Health.SILENT
    nonce, number = path.ask(0.3)
    assert path.echoed(nonce, number, 0.4)
    assert not path.echoed(nonce, number, 0.5)


def test_a_slow_radio_is_probed_rarely() -> None:
    probes = {}
    for budget in (2e3, 60e3, None):
        path, now = Path("radio", 20, budget), 0.0
        path.use(now)
        sent = 0
        while now < 20.0:
            if path.due(now) <= 0.0:
                nonce, number = path.ask(now)
                path.echoed(nonce, number, now)
                sent += 1
            path.judge(now)
            now += STEP
        probes[budget] = sent
    assert 45 * probes[2e3] <= 20.0 * 0.02 * 2e3 + 100
    assert probes[2e3] < probes[60e3] <= probes[None]
