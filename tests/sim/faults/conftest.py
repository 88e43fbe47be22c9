"""A copter in the air, for faults to come upon."""

from __future__ import annotations

import pytest

from tests.sim.conftest import Desk, MakeDesk


@pytest.fixture
def aloft(make_desk: MakeDesk) -> Desk:
    desk = make_desk()
    desk.take_off(10.0)
    desk.clear()
    return desk
