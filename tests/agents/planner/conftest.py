"""Before the planner's first test: compile its kernels, once on a machine, while no test's clock runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from agents.planner.model import staticmap
from agents.planner.solve import jit
from agents.planner.solve.warm import warm


def pytest_collection_finish(session: pytest.Session) -> None:
    ours = any(Path(__file__).parent in item.path.parents for item in session.items)
    if ours and not session.config.option.collectonly and not jit.compiled():
        warm()


@pytest.fixture
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    """A way that there is not is looked for a tenth as long as usual."""
    for name in ("PATIENCE", "THOROUGH"):
        monkeypatch.setattr(staticmap, name, getattr(staticmap, name) / 10.0)
