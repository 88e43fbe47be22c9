"""Before the planner's first test: compile its kernels, once on a machine, while no test's clock runs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from agents.planner.model.staticmap import StaticMap
from agents.planner.solve import jit
from agents.planner.solve.warm import warm


def pytest_collection_finish(session: pytest.Session) -> None:
    ours = any(Path(__file__).parent in item.path.parents for item in session.items)
    if ours and not session.config.option.collectonly and not jit.compiled():
        warm()


@pytest.fixture
def hasty() -> Iterator[None]:
    """A way that there is not is looked for a tenth as long as usual."""
    usual = StaticMap.patience, StaticMap.thorough
    StaticMap.patience, StaticMap.thorough = (each / 10.0 for each in usual)
    yield
    StaticMap.patience, StaticMap.thorough = usual
