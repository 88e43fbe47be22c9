"""A hexarotor under PX4's rules: what a client sees of it, and that it flies."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tests.sim.px4.conftest import MakeCompanion


def test_it_flies_on_six_and_says_so(make_companion: MakeCompanion) -> None:
    companion = make_companion(airframe="hexa")
    companion.take_off()
    companion.world.step(3.0)
    assert companion.near(0.0, 0.0, -2.5, 0.4)
    beat = companion.all("HEARTBEAT")[-1]
    assert (beat["type"], beat["autopilot"]) == (13, 12)
    pwm = companion.all("SERVO_OUTPUT_RAW")[-1]
    assert all(1100 < pwm[f"servo{i}_raw"] < 1900 for i in range(1, 7))
    assert {pwm[f"servo{i}_raw"] for i in range(7, 17)} == {900}
    assert companion.command(512, 375) == [0]
    outputs = companion.all("ACTUATOR_OUTPUT_STATUS")[-1]
    assert outputs["active"] == 6
    assert [round(value) for value in outputs["actuator"][:7]] == [*[pwm[f"servo{i}_raw"] for i in range(1, 7)], 0]


def test_it_flies_to_the_corners_of_a_square_by_offboard(make_companion: MakeCompanion) -> None:
    companion = make_companion(airframe="hexa")
    companion.offboard(lambda: companion.position(0.0, 0.0, -4.0), 4.0)
    for north, east in ((5.0, 0.0), (5.0, 5.0)):
        say = lambda n=north, e=east: companion.position(n, e, -4.0)  # noqa: E731
        companion.until(lambda n=north, e=east: companion.near(n, e, -4.0, 0.4), 20.0, say)  # type: ignore[misc]
