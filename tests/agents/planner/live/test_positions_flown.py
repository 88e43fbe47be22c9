"""The README's own commands, flown by simulated copters whose receivers drift apart as typical ones do: by the
simulator's truth nobody comes nearer to another than was promised.

More seeds: ``python -m tests.agents.planner.live.flying --seeds 5``.
"""

from __future__ import annotations

import pytest

from tests.agents.planner.live.flying import PROMISED, fly, readme, show

README = ("takeoff", "formation", "goto")
pytestmark = [pytest.mark.asyncio, pytest.mark.timeout(400)]


async def test_the_readme_s_commands_keep_what_they_promise_with_typical_receivers() -> None:
    goals = {name: make for name, make in readme().items() if name in README}
    flown = await fly(goals, teams=1, size=4, weather={"noise": "typical", "seed": 27})
    assert all(each.entry.state == "done" for each in flown.took), show(flown)
    assert flown.nearest >= PROMISED, show(flown)
    for each in flown.took:
        text = each.preview["positions"]["text"]
        assert text.startswith("positions ±1.2") and "apart" in text, text
