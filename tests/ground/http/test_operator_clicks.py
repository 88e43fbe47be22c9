"""Clicks that were not meant: the second one of a double click lands on what the first one had asked."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import pytest

from tests.ground.http.browser import READ_S, FakePlanner, Fleet, Tab
from tests.ground.http.test_operator import TOASTS, at, bar, opened

if TYPE_CHECKING:
    from tests.ground.http.conftest import Served

LAND = "#bar [data-verb=land]"
ASKING = "document.querySelector('#bar [data-verb=land]').classList.contains('asking')"
OPEN = "document.getElementById('confirm').open"
A_WHILE = 0.5
"""s in which an order would have come to the vehicle"""


@pytest.mark.asyncio(loop_scope="module")
async def test_a_double_click_is_one_press(tab: Tab, served: Served, fleet: Fleet, planner: FakePlanner) -> None:
    fleet.more = {"quad1": at(0, 0), "quad2": at(0, 20)}
    await opened(tab, served)
    await tab.click("[data-row=quad1]")
    await tab.until(f"{bar('Land quad1')} !== undefined && document.querySelector('.card') !== null")
    fleet.orders.clear()
    await tab.double_click(LAND)
    await tab.until(ASKING)
    await asyncio.sleep(A_WHILE)
    assert fleet.orders == [], "nobody has read the question"
    await tab.click(LAND)
    await tab.until(f"{TOASTS}.includes('quad1: land done')")
    fleet.orders.clear()
    land = ".card .orders button:nth-child(2)"
    assert await tab.text(land) == "Land"
    await tab.double_click(land)
    await tab.until("document.querySelector('.card .asking') !== null")
    await asyncio.sleep(A_WHILE)
    assert fleet.orders == []
    served.post("/swarm/submit", {"goal": {"kind": "takeoff", "vehicles": ["quad1"], "height": 10}})
    await tab.run("showTab('goals')")
    await tab.until("document.querySelector('#goals .orders button:nth-child(2)') !== null")
    await tab.double_click("#goals .orders button:nth-child(2)")
    await asyncio.sleep(A_WHILE)
    assert "cancel" not in [verb for verb, _ in planner.asked]
    assert not tab.said


@pytest.mark.asyncio(loop_scope="module")
async def test_presses_again_and_again_are_heard(tab: Tab, served: Served, fleet: Fleet) -> None:
    fleet.more = {"quad1": at(0, 0)}
    await opened(tab, served)
    await tab.click("[data-row=quad1]")
    await tab.until(f"{bar('Land quad1')} !== undefined")
    fleet.orders.clear()
    for _ in range(10):
        if fleet.orders:
            break
        await tab.click(LAND)
        await asyncio.sleep(0.15)
    assert fleet.orders == ["quad1/do/land"], "in haste nobody waits between them"


@pytest.mark.asyncio(loop_scope="module")
async def test_a_yes_under_the_pointer_is_none(tab: Tab, served: Served, fleet: Fleet) -> None:
    fleet.more = {"quad1": at(0, 0, armed=False)}
    await opened(tab, served)
    await tab.click("[data-row=quad1]")
    await tab.until(f"!{bar('Arm')}.disabled")
    await tab.run(f"{bar('Arm')}.click()")
    yes = await tab.place("#confirm-yes")
    await tab.click("#confirm button[value=no]")
    await tab.until(f"!{OPEN}")
    fleet.orders.clear()
    await tab.run(f"{bar('Arm')}.focus()")
    await tab.key("Enter")
    await tab.click(yes)
    await asyncio.sleep(A_WHILE)
    assert await tab.run(OPEN), "it asks as before"
    assert fleet.orders == []
    await tab.click(yes)
    await tab.until(f"{TOASTS}.includes('quad1: arm done')")
    fleet.orders.clear()
    await tab.double_click("#bar .divider + button")
    await tab.until(OPEN)
    assert "One question at a time" not in await tab.run(TOASTS)
    await tab.click("#confirm button[value=no]")
    await tab.until(f"!{OPEN}")
    assert fleet.orders == []
    assert not tab.said


@pytest.mark.asyncio(loop_scope="module")
async def test_a_pointer_that_was_down_before_the_question_means_something_else(
    tab: Tab, served: Served, fleet: Fleet
) -> None:
    fleet.more = {"quad1": at(0, 0)}
    await opened(tab, served)
    await tab.click("[data-row=quad1]")
    await tab.until(f"{bar('Land quad1')} !== undefined")
    fleet.orders.clear()
    x, y = await tab.place(LAND)
    await tab.mouse("mouseMoved", x, y)
    await tab.mouse("mousePressed", x, y, held=True)
    await tab.run(f"{bar('Land')}.focus()")
    await tab.key("Enter")
    await tab.until(ASKING)
    await asyncio.sleep(READ_S)
    await tab.mouse("mouseReleased", x, y)
    await asyncio.sleep(A_WHILE)
    assert fleet.orders == []
    assert await tab.run(ASKING)
    await tab.click(LAND)
    await tab.until(f"{TOASTS}.includes('quad1: land done')")
