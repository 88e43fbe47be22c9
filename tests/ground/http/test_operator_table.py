"""The page's table, read by a person."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

from tests.ground.http.browser import Fleet, Tab, card, row
from tests.ground.http.test_operator import at, opened
from zmav import wire

if TYPE_CHECKING:
    from tests.ground.http.conftest import Served


def column(name: str, heading: str) -> str:
    """What stands in a vehicle's row below a heading, as it is seen; empty where it is not."""
    return f"""(() => {{
        const heads = [...document.querySelectorAll('#table th')];
        const cell = {row(name)}.children[heads.findIndex((each) => each.textContent === {json.dumps(heading)})];
        return cell.offsetParent ? cell.innerText : '';
    }})()"""


@pytest.mark.asyncio(loop_scope="module")
async def test_charge_with_time_left_and_fix_with_accuracy(tab: Tab, served: Served, fleet: Fleet) -> None:
    fleet.names.append("quad3")
    fleet.more = {
        "quad1": at(
            0,
            0,
            battery=wire.Battery(remaining=0.76, voltage=15.4, time_left=840.0),
            gps=wire.Gps(fix="3D_FIX", satellites=14, hdop=0.8, h_acc=0.92),
        ),
        "quad2": at(0, 20, battery=wire.Battery(remaining=0.5), gps=wire.Gps(fix="3D_FIX", satellites=9, hdop=1.4)),
        "quad3": at(0, 40, battery=None, gps=None),
    }
    await opened(tab, served, "quad1", "quad2", "quad3")
    await tab.until(f"{column('quad1', 'battery')} === '76 % · 14 min'")
    assert await tab.run(column("quad1", "GPS")) == "3D ±0.9 m"
    assert await tab.run(column("quad2", "battery")) == "50 %", "nothing where the autopilot says nothing"
    assert await tab.run(column("quad2", "GPS")) == "3D HDOP 1.4"
    assert await tab.run(column("quad3", "battery")) == "–"
    assert await tab.run(column("quad3", "GPS")) == "–"
    fleet.more["quad1"]["gps"] = wire.Gps(fix="RTK_FIXED", satellites=22, h_acc=0.014)
    await tab.until(f"{column('quad1', 'GPS')} === 'RTK ±0.01 m'")
    await tab.click("[data-row=quad1]")
    await tab.until(f"{card('quad1')} !== null")
    shown = await tab.run(f"{card('quad1')}.innerText")
    assert "14 min" in shown and "±0.01 m" in shown
    assert not tab.said


@pytest.mark.asyncio(loop_scope="module")
async def test_a_long_name_pushes_nothing_out(tab: Tab, served: Served, fleet: Fleet) -> None:
    long = "survey-rover-of-the-northern-field-with-the-yellow-antenna-2"
    joined = "x" * 80
    fleet.names += [long, joined]
    full = {
        "battery": wire.Battery(remaining=0.76, time_left=840.0),
        "gps": wire.Gps(fix="3D_FIX", satellites=14, hdop=1),
    }
    fleet.more = {name: at(10.0 * i, 0, **full) for i, name in enumerate(fleet.names)}
    await opened(tab, served, *fleet.names)
    fits = "document.getElementById('table-scroll').scrollWidth <= document.getElementById('table-scroll').clientWidth"
    for width, height in ((1400, 900), (400, 800)):
        await tab.size(width, height)
        await tab.until(fits)
        assert await tab.run("document.documentElement.scrollWidth") <= width
        for name in (long, joined):
            called = f"{row(name)}.querySelector('.name b')"
            assert await tab.run(f"{called}.scrollWidth > {called}.clientWidth"), "cut"
            assert await tab.run(f"getComputedStyle({called}).textOverflow") == "ellipsis"
            assert await tab.run(f"{called}.parentElement.title") == f"{name} · copter"
            assert await tab.run(f"{called}.textContent") == name, "a screen reader reads all of it"
            assert await tab.run(f"{row(name)}.querySelector('input').getAttribute('aria-label')") == f"select {name}"
        uncut = f"{row('quad1')}.querySelector('.name b')"
        assert await tab.run(f"{uncut}.scrollWidth <= {uncut}.clientWidth")
        assert await tab.run(column("quad1", "battery")) == "76 % · 14 min"
        await tab.click(f"[data-row={joined}]")
        await tab.until(f"{card(joined)} !== null")
        assert joined in await tab.run(f"{card(joined)}.innerText")
        head = f"{card(joined)}.querySelector('.card-head')"
        assert await tab.run(f"{head}.scrollWidth <= {head}.clientWidth"), "all of the name, and how old its word is"
        assert joined in await tab.text("#whom-names"), "whom an order is for is named in full"
    assert not tab.said
