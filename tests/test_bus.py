"""zmav/bus.py: who hears of what, and that a listener which raises keeps no other from it."""

from __future__ import annotations

from typing import NamedTuple

import pytest

from zmav.bus import Bus


class Landed(NamedTuple):
    name: str


class Started(NamedTuple):
    pass


def fail(told: Landed) -> None:
    raise ValueError(told.name)


def test_listeners_of_a_type_hear_of_it_in_their_order_and_others_do_not() -> None:
    bus, heard = Bus(), list[object]()
    bus.on(Landed, lambda told: heard.append(("first", told.name)))
    bus.on(Started, heard.append)
    bus.on(Landed, lambda told: heard.append(("second", told.name)))
    bus.tell(Landed("quad1"))
    assert heard == [("first", "quad1"), ("second", "quad1")]
    bus.tell(Started())
    assert heard[2:] == [Started()]


def test_the_others_hear_of_it_though_a_listener_raises_and_the_teller_learns_of_that() -> None:
    bus, heard = Bus(), list[str]()
    bus.on(Landed, fail)
    bus.on(Landed, lambda told: heard.append(told.name))
    with pytest.raises(ValueError, match="quad1"):
        bus.tell(Landed("quad1"))
    assert heard == ["quad1"]
