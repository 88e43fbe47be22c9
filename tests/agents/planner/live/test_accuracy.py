"""What positions may be off, by what autopilots report, and the room that plans make for it."""

from __future__ import annotations

import itertools
import math

import pytest

from agents.planner.live.accuracy import (
    DRIFT,
    FIXED,
    FLOAT,
    FORGETS_S,
    LOST,
    SIGMAS,
    UNTOLD,
    Accuracies,
    position_error,
    rooms,
)
from zmav import wire


def state(gps: wire.Gps | None = None, estimate: wire.Estimate | None = None, armed: bool = True) -> wire.VehicleState:
    return wire.VehicleState(t=0.0, fleet="demo", name="quad1", instance="a", gps=gps, estimate=estimate, armed=armed)


def gps(fix: str, h_acc: float | None = None, hdop: float | None = None) -> wire.Gps:
    return wire.Gps(fix=fix, h_acc=h_acc, hdop=hdop)


@pytest.mark.parametrize(
    ("told", "error"),
    [
        (gps("3D_FIX", 1.2), 1.2),
        (gps("3D_FIX", 0.1), DRIFT),
        (gps("3D_FIX"), UNTOLD),
        (gps("3D_FIX", hdop=2.0), 2.0 * UNTOLD),
        (gps("DGPS", 0.9), 0.9),
        (gps("RTK_FIXED", 0.014), FIXED),
        (gps("RTK_FIXED"), FIXED),
        (gps("RTK_FIXED", 0.8), 0.8),
        (gps("RTK_FLOAT", 0.02), FLOAT),
        (gps("NO_FIX", 0.3), LOST),
        (gps("2D_FIX"), LOST),
        (None, UNTOLD),
    ],
)
def test_what_a_receiver_says_is_believed_down_to_what_its_fix_can_do(told: wire.Gps | None, error: float) -> None:
    assert position_error(state(told))[0] == pytest.approx(error)


def test_the_worse_of_receiver_and_filter_counts() -> None:
    filtered = wire.Estimate(accuracy=2.4, ratio=0.1)
    assert position_error(state(gps("3D_FIX", 1.2), filtered)) == (2.4, "3D_FIX")
    assert position_error(state(gps("RTK_FIXED"), wire.Estimate(accuracy=0.29))) == (0.29, "RTK_FIXED")


def test_indoors_the_filter_alone_is_asked() -> None:
    assert position_error(state(None, wire.Estimate(accuracy=0.04))) == (0.04, "filter")
    assert position_error(state(gps("NO_GPS"), wire.Estimate(accuracy=0.04))) == (0.04, "filter")


def test_a_filter_that_is_off_its_sensors_is_believed_less() -> None:
    there = state(gps("3D_FIX", 1.0), wire.Estimate(ratio=1.0))
    assert position_error(there)[0] == pytest.approx(2.0)
    assert position_error(there, 0.1)[0] == pytest.approx(0.2), "what is declared, too"
    lost = state(gps("3D_FIX", 1.0), wire.Estimate(ratio=50.0))
    assert position_error(lost)[0] == pytest.approx(4.0), "and not without bounds"


@pytest.mark.parametrize("errors", [(1.2, 1.2, 1.2), (0.05, 1.2, 0.9), (0.0, 1.2), (0.05, 0.05), (0.5, 3.0, 1.0)])
def test_any_two_have_room_for_three_deviations_of_what_they_are_off_together(errors: tuple[float, ...]) -> None:
    found = rooms({str(i): error for i, error in enumerate(errors)})
    for (i, one), (j, other) in itertools.combinations(enumerate(errors), 2):
        assert found[str(i)] + found[str(j)] >= SIGMAS * math.hypot(one, other) - 1e-9
    assert max(found.values()) <= SIGMAS * max(errors) + 1e-9


def test_what_was_worse_is_forgotten_slowly_and_what_is_worse_counts_at_once() -> None:
    known = Accuracies()
    known.heard("quad1", state(gps("3D_FIX", 3.0)), None, 100.0)
    known.heard("quad1", state(gps("3D_FIX", 1.0)), None, 101.0)
    known.settle(["quad1"])
    assert 2.8 < known.error("quad1") <= 3.0
    known.heard("quad1", state(gps("3D_FIX", 1.0)), None, 101.0 + 5.0 * FORGETS_S)
    assert known.error("quad1") == 1.0
    known.heard("quad1", state(gps("3D_FIX", 4.0)), None, 300.0)
    assert known.error("quad1") == 4.0
    known.settle([])
    assert (known.error("quad1"), known.room("quad1")) == (0.0, 0.0)


@pytest.mark.parametrize(("armed", "error"), [(False, 1.0), (True, 4.7)])
def test_what_it_was_before_a_receiver_found_its_satellites_counts_in_flight_alone(armed: bool, error: float) -> None:
    known = Accuracies()
    known.heard("quad1", state(gps("NO_FIX"), armed=armed), None, 100.0)
    known.heard("quad1", state(gps("3D_FIX", 1.0), armed=armed), None, 101.0)
    known.heard("quad1", state(gps("3D_FIX", 0.9), armed=armed), None, 102.0)  # and this is held on the ground, too
    assert known.error("quad1") == pytest.approx(error)


def test_a_number_without_an_end_is_counted_like_any_other() -> None:
    """It came as JSON from somebody: all that are heard are settled together, and the planner with them."""
    known = Accuracies()
    for name, told in (("quad1", gps("3D_FIX", 1e308)), ("quad2", gps("3D_FIX", 1.0))):
        known.heard(name, state(told, wire.Estimate(ratio=1e308)), None, 0.0)
    known.settle(["quad1", "quad2"])
    assert math.isfinite(known.room("quad1"))
    assert known.error("quad2") == pytest.approx(4.0)
