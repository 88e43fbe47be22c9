"""``body``: what a vehicle tells a planner of itself."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from zmav import wire
from zmav.config import BodyConfig, body_of, check_body
from zmav.errors import BadConfig
from zmav.wire.swarm import BodyReport

if TYPE_CHECKING:
    from tests.services.conftest import Bench, StartBench


async def asked(b: Bench) -> BodyReport:
    (reply,) = await b.ground.ask("zmav/demo/quad1/body")
    assert reply.ok is not None
    return wire.decode(reply.ok.payload.to_bytes(), BodyReport, "body")


async def test_what_is_declared_and_else_what_is_usual_for_the_kind(bench: StartBench) -> None:
    b = await bench(settings={"body": BodyConfig(radius=0.4, speed=7.0)})
    report = await asked(await b.connected())
    assert (report.kind, report.declared) == ("copter", True)
    assert (report.body.radius, report.body.speed) == (0.4, 7.0)
    assert report.body.accel == body_of("copter").accel


async def test_without_a_table_it_is_as_usual(bench: StartBench) -> None:
    report = await asked(await (await bench()).connected())
    assert report == BodyReport(kind="copter", body=body_of("copter"), declared=False)


def test_only_what_hovers_has_no_least_speed() -> None:
    assert body_of("plane").min_speed > 0.0 < body_of("plane").turn_radius
    assert body_of("rover").min_speed == body_of(None).min_speed == 0.0


@pytest.mark.parametrize(
    ("body", "field"),
    [
        (BodyConfig(radius=float("inf")), "body.radius"),
        (BodyConfig(turn_radius=-1.0), "body.turn_radius"),
        (BodyConfig(speed=3.0, min_speed=4.0), "body.min_speed"),
    ],
)
def test_figures_that_cannot_be(body: BodyConfig, field: str) -> None:
    with pytest.raises(BadConfig) as caught:
        check_body(body, "body")
    assert caught.value.detail["field"] == field
