"""The planner with credentials: who may ask it for what."""

from __future__ import annotations

from pathlib import Path

import pytest

import zmav
from agents.planner.cli.counter import find
from agents.planner.live.agent import Agent
from agents.planner.live.settings import Settings
from mesh.credentials.ca import Authority
from tests.conftest import Net
from zmav.errors import BadInput, Forbidden
from zmav.session import SessionSettings
from zmav.trust.certificate import Role
from zmav.waiting import within
from zmav.wire import swarm

PATIENCE_S = 30.0


async def test_operators_give_goals_and_viewers_look(net: Net, tmp_path: Path) -> None:
    authority = Authority.create(tmp_path / "ca", "alpha")
    folders = {
        name: authority.issue(name, role, out=tmp_path / name)
        for name, role in (("ground", Role.PLANNER), ("ops", Role.OPERATOR), ("eye", Role.VIEWER))
    }
    _, endpoint = net.router()

    def member(name: str) -> zmav.Client:
        settings = SessionSettings(connect=[endpoint], credentials=str(folders[name]))
        return zmav.open(fleet="alpha", settings=settings)

    own = Settings(name="ground", fleet="alpha", patience=1.0)
    async with member("ground") as z, Agent(z, own) as agent, member("ops") as ops, member("eye") as eye:
        hold = swarm.Submit(goal=swarm.Hold(vehicles=["quad1"]))
        viewer = await within(PATIENCE_S, find(eye))
        assert viewer.name == "ground"
        with pytest.raises(Forbidden, match=r"eye \(viewer\) may not use swarm submit"):
            await viewer.order("submit", hold)
        with pytest.raises(BadInput, match="no vehicle quad1 is known"):  # it is looked at, which is all that it lacks
            await viewer.order("preview", swarm.Preview(goal=hold.goal))
        operator = await within(PATIENCE_S, find(ops))
        with pytest.raises(BadInput, match="no vehicle quad1 is known"):
            await operator.order("submit", hold)
        box = swarm.Box(low=(0.0, 0.0, 0.0), high=(1.0, 1.0, -1.0))
        told = swarm.GiveObstacle(obstacle=swarm.Obstacle(name="hut", t=1.0, what=box))
        with pytest.raises(Forbidden):
            await viewer.order("obstacle", told)
        assert (await operator.order("obstacle", told))["news"]
        assert any("by ops" in event.text for event in agent.events)
    async with zmav.open(fleet="alpha", connect=[endpoint]) as stranger:
        assert stranger.member is None  # and nobody is in charge of anything any more
