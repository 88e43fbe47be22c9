"""Circles for planes: apart without any clock, whatever comes when."""

from __future__ import annotations

import itertools

import msgspec
import numpy as np
import pytest

from agents.planner.loiter import (
    STEADY,
    Circling,
    at_height,
    loiter,
    loiter_orders,
    loiter_radius,
    loiter_slots,
    loiter_speed,
)  # fmt: skip
from zmav import wire
from zmav.config import body_of
from zmav.errors import BadInput
from zmav.verbs import VERBS

BODY = body_of("plane")


def near(name: str, height: float, wish: float, east: float = 0.0) -> Circling:
    return Circling(name, BODY, (0.0, east, -height), (300.0, east, -wish))


def test_a_circle_is_one_round_that_can_go_on_for_ever() -> None:
    radius, speed = loiter_radius(BODY), loiter_speed(BODY)
    motion = loiter(np.array([10.0, 20.0, 80.0]), radius, speed, start=1.0)
    assert motion[0, 1:] == pytest.approx(motion[-1, 1:])
    assert np.hypot(motion[:, 1] - 10.0, motion[:, 2] - 20.0) == pytest.approx(radius)
    assert np.diff(motion[:, 0]).max() <= 0.2
    assert speed**2 / radius <= BODY.accel and BODY.min_speed < speed <= BODY.speed


def test_planes_that_may_meet_get_heights_of_their_own_and_the_others_the_height_they_want() -> None:
    slots = loiter_slots([near("a", 60, 80), near("b", 100, 80), near("c", 70, 80, east=5000.0)], 30.0, 300.0, 1.5)
    heights = {slot.vehicle: -slot.centre_ned[2] for slot in slots}
    assert heights["a"] == 80.0 and heights["c"] == 80.0
    assert heights["b"] - heights["a"] == pytest.approx(1.5 * 8.0 + 2.0 * STEADY)
    a, b = slots[0].reserved, slots[1].reserved
    assert a.ceiling <= b.floor


def test_nobody_passes_anybody_whatever_the_delays() -> None:
    """Every order of events that ``first`` allows: no two planes are ever on heights less than a radius' sum apart."""
    rng = np.random.default_rng(3)
    for _ in range(150):
        count = int(rng.integers(2, 7))
        gap = 1.5 * 8.0 + 2.0 * STEADY
        starts = np.cumsum(rng.uniform(gap, 2.5 * gap, count)) + rng.uniform(0.0, 100.0)
        planes = [near(f"p{k}", starts[k], rng.uniform(20.0, 300.0)) for k in range(count)]
        planes = [planes[k] for k in rng.permutation(count)]
        slots = {slot.vehicle: slot for slot in loiter_slots(planes, 20.0, 600.0, 1.5)}
        at = {plane.vehicle: -plane.pos_ned[2] for plane in planes}
        waiting = set(at)
        while waiting:
            able = [name for name in waiting if not waiting & set(slots[name].first)]
            assert able, "somebody waits for himself"
            name = able[int(rng.integers(len(able)))]
            low, high = sorted((at[name], -slots[name].centre_ned[2]))
            for other, height in at.items():
                assert other == name or height <= low - gap + 1e-6 or height >= high + gap - 1e-6
            at[name] = -slots[name].centre_ned[2]
            waiting.discard(name)
        assert all(abs(a - b) >= gap - 1e-6 for a, b in itertools.combinations(at.values(), 2))


def test_no_room_is_said() -> None:
    with pytest.raises(BadInput, match="do not fit into 50 m") as raised:
        loiter_slots([near(f"p{k}", 40.0 + 25.0 * k, 60.0) for k in range(4)], 30.0, 80.0, 1.5)
    assert raised.value.detail["field"] == "vehicles"


def test_orders_are_those_of_the_wire_and_in_turn() -> None:
    planes = [near("low", 60, 110), near("high", 90, 120)]
    slots = loiter_slots(planes, 30.0, 300.0)
    orders = loiter_orders(planes, slots)
    assert [(order.vehicle, order.after) for order in orders] == [
        ("high", ()),
        ("low", (0,)),
        ("low", (1,)),
        ("high", (0,)),
    ]
    for order in orders:
        assert VERBS[order.verb].args is wire.Reposition
        args = msgspec.convert(dict(order.args), wire.Reposition)
        assert args.pos is not None and args.radius == loiter_radius(BODY)
    assert orders[0].args["pos"][:2] == (0.0, 0.0) and orders[3].args["pos"] == slots[1].centre_ned
    assert at_height(slots[0], (0.0, 0.0, slots[0].centre_ned[2] + 3.0))
    assert not at_height(slots[0], planes[0].pos_ned)
