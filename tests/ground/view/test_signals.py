"""Controllers' signals: which plot each is drawn in, how it looks, and what is left out."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest

import zmav
from ground.view import signals
from ground.view.painter import blueprint
from ground.view.signals import PLOTS, line_of
from ground.view.table import Table
from ground.view.watch import Watch
from zmav import wire
from zmav.waiting import within

if TYPE_CHECKING:
    from tests.conftest import Net

EV1 = ("demo", "hex1", "ev1", "signals")
PLACE = "/plots/controllers"
Make = Callable[..., Any]


def sample(**values: float) -> wire.Signals:
    """Names with ``__`` for the dot."""
    return wire.Signals(t=1.8e9, values={name.replace("__", "."): value for name, value in values.items()})


def drawn(rows: dict[str, list[Any]], topic: str = r"hex1\ ev1") -> dict[str, list[float]]:
    """Plot and signal of each line of a stream: its values."""
    found = {}
    for path, lines in rows.items():
        plot, _, rest = path.removeprefix(f"{PLACE}/").partition("/")
        who, _, name = rest.rpartition("/")
        if path.startswith(f"{PLACE}/") and who == topic:
            found[f"{plot} {name}"] = [row.values["Scalars:scalars"][0] for row in lines if row.t is not None]
    return found


def look(rows: dict[str, list[Any]], plot: str, name: str, who: str = r"hex1\ ev1") -> dict[str, Any]:
    (style,) = [row.values for row in rows[f"{PLACE}/{plot}/{who}/{name}"] if row.t is None]
    return {part.rpartition(":")[2]: value[0] for part, value in style.items()}


def test_measured_and_asked_for_are_in_one_plot_and_told_apart(paint: Make) -> None:
    painted = paint()
    for x in (0.0, 1.0):
        painted.step(("agent_out", EV1, sample(is__x=x, ref__x=5.0, is__pitch=0.25, ref__pitch=0.5, is__r=-1.0)))
    painted.step(("agent_out", EV1, sample(out__torque__x=0.0625, integral=2.0, took_us=400.0)))
    rows = painted.rows()
    assert drawn(rows) == {
        "position is.x": [0.0, 1.0],
        "position ref.x": [5.0, 5.0],
        "attitude is.pitch": [0.25, 0.25],
        "attitude ref.pitch": [0.5, 0.5],
        "rates is.r": [-1.0, -1.0],
        "outputs out.torque.x": [0.0625],
        "others integral": [2.0],
        "cycle took_us": [400.0],
    }
    measured, asked = look(rows, "position", "is.x"), look(rows, "position", "ref.x")
    assert (measured["names"], asked["names"]) == ("hex1 ev1 x", "hex1 ev1 x ref")
    assert measured["widths"] > 2 * asked["widths"]
    parts = [[look >> shift & 255 for shift in (24, 16, 8)] for look in (measured["colors"], asked["colors"])]
    assert parts[1] == [part // 2 for part in parts[0]], "the same colour, darker"
    assert look(rows, "attitude", "is.pitch")["colors"] != measured["colors"]


@pytest.mark.parametrize(
    ("name", "plot", "reference"),
    [
        ("is.vz", "velocity", False),
        ("ref.yaw", "attitude", True),
        ("reference.z", "position", True),
        ("reference_vel.x", "velocity", True),
        ("out.thrust", "outputs", False),
        ("out", "others", False),
        ("is.mass", "others", False),
        ("ref.mass", "others", True),
        ("p", "others", False),
        ("late", "cycle", False),
    ],
)
def test_names_say_where_a_signal_belongs(name: str, plot: str, reference: bool) -> None:
    line = line_of(name)
    assert (line.plot, line.reference) == (plot, reference)


def test_there_is_a_plot_of_each_kind_one_above_the_other() -> None:
    whole: Any = blueprint().root_container
    tabs = whole.contents[1]
    flight, links, controllers = tabs.contents
    assert [tab.name for tab in (flight, links, controllers)] == ["Flight", "Links", "Controllers"]
    assert [view.origin for view in controllers.contents] == [f"{PLACE}/{plot}" for plot in PLOTS]
    assert {line_of(name).plot for name in ("is.x", "is.vx", "is.yaw", "is.p", "out.x", "a", "took_us")} == set(PLOTS)


def test_two_controllers_share_the_plots_in_other_colours(paint: Make) -> None:
    painted = paint()
    for agent in ("ev1", "ev2"):
        painted.step(("agent_out", ("demo", "hex1", agent, "signals"), sample(is__x=1.0)))
    painted.step(("agent_out", ("demo", "hex1", "navigator", "tracking"), sample(error=0.5)))
    rows = painted.rows()
    first, second = (look(rows, "position", "is.x", rf"hex1\ {agent}") for agent in ("ev1", "ev2"))
    assert first["names"] == "hex1 ev1 x"
    assert second["names"] == "hex1 ev2 x"
    assert first["colors"] != second["colors"]
    assert drawn(rows, r"hex1\ navigator\ tracking") == {"others error": [0.5]}


def test_of_two_fleets_the_fleet_is_named(paint: Make) -> None:
    painted = paint(several=True)
    painted.step(("agent_out", EV1, sample(is__x=1.0)))
    assert look(painted.rows(), "position", "is.x", r"demo\/hex1\ ev1")["names"] == "demo/hex1 ev1 x"


def test_a_signal_alone_makes_no_vehicle(paint: Make) -> None:
    painted = paint()
    painted.step(("agent_out", EV1, sample(is__x=1.0)))
    assert painted.scene.crafts == {}
    assert not [path for path in painted.rows() if path.startswith("/world/ned/vehicles")]


@pytest.mark.parametrize("name", ["", ".x", "a b", "x/../y", "é", "\n", "x" * 61, "is.x\n"])
def test_a_name_that_is_none_is_counted_and_the_others_are_drawn(paint: Make, name: str) -> None:
    painted = paint()
    painted.step(("agent_out", EV1, wire.Signals(t=1.8e9, values={name: 1.0, "is.x": 2.0})))
    assert painted.scene.bad == 1
    assert drawn(painted.rows()) == {"position is.x": [2.0]}


def test_signals_of_a_stream_are_bounded(paint: Make) -> None:
    painted = paint()
    for step in range(3):
        names = {f"s{step}-{i}": 1.0 for i in range(200)}
        painted.step(("agent_out", EV1, wire.Signals(t=1.8e9, values={"is.x": float(step), **names})))
    large = wire.Signals(t=1.8e9, values={"is.x": 3.0, "x" * signals.LARGEST: 1.0})
    painted.step(("agent_out", EV1, large))
    found = drawn(painted.rows())
    assert len(found) == signals.MOST_SIGNALS
    assert found["position is.x"] == [0.0, 1.0, 2.0], "what is known is drawn on"
    assert painted.scene.bad == 3 * 200 + 1 - signals.MOST_SIGNALS + 1


def test_streams_are_bounded(paint: Make) -> None:
    painted = paint()
    for x in (1.0, 2.0):
        painted.step(*(("agent_out", ("demo", "hex1", f"a{i}", "signals"), sample(is__x=x)) for i in range(60)))
    rows = painted.rows()
    assert len([path for path in rows if path.startswith(PLACE)]) == signals.MOST_STREAMS
    assert drawn(rows, r"hex1\ a0") == {"position is.x": [1.0, 2.0]}
    assert painted.scene.bad == 2 * (60 - signals.MOST_STREAMS)


@pytest.mark.parametrize(("wanted", "kinds"), [(True, ["agent_out", "event"]), (False, ["event"])])
async def test_signals_are_heard_of_the_vehicles_that_are_shown_unless_they_are_left_where_they_are(
    net: Net, wanted: bool, kinds: list[str]
) -> None:
    router, endpoint = net.router()
    table = Table()
    reader, found = table.reader(), list[Any]()
    async with zmav.open(connect=[endpoint]) as z:
        watching = asyncio.create_task(Watch(z, table, ("hex*",), signals=wanted).run())
        await net.linked(router, "zmav/demo/hex1/event")
        if wanted:
            await net.linked(router, "zmav/demo/hex1/agent/ev1/out/signals")
        for name in ("quad1", "hex1"):
            router.put(f"zmav/demo/{name}/agent/ev1/out/signals", b"{}")
        router.put("zmav/demo/hex1/event", b"{}")

        async def all_of_it() -> None:
            while {item.kind for item in found} != set(kinds):
                found.extend(item for item in reader.take().items if item.kind != "graph")
                await asyncio.sleep(0.01)

        await within(30.0, all_of_it())
        watching.cancel()
    assert sorted(item.kind for item in found) == kinds
    assert {item.place[:2] for item in found} == {("demo", "hex1")}
