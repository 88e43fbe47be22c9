"""Labs for tests: ``async with`` them yourself, or take the fixture, which ends what a test began."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from mesh.lab import network as network_module
from mesh.lab.lab import Lab
from mesh.lab.network import Network
from mesh.lab.scenario import Scenario, check

StartLab = Callable[..., Coroutine[Any, Any, Lab]]


def scenario(**tables: Any) -> Scenario:
    """A scenario from what its file would hold."""
    return check(msgspec.convert(tables, Scenario))


@pytest.fixture
def able() -> None:
    """Skip where no lab can be made, with the reason."""
    try:
        network_module.check_able()
    except network_module.LabError as e:
        pytest.skip(str(e))


@pytest.fixture
def make(able: None) -> Iterator[Callable[..., Network]]:
    """``make(hosts=..., media=...)``: a network without programs."""
    with contextlib.ExitStack() as stack:
        yield lambda **tables: stack.enter_context(Network(scenario(**tables)))


@pytest.fixture
async def start_lab(able: None, tmp_path: Path) -> AsyncIterator[StartLab]:
    """``await start_lab(hosts=..., media=...)``: a lab with its programs; ``programs=False`` without."""
    async with contextlib.AsyncExitStack() as stack:
        count = 0

        async def start(programs: bool = True, **tables: Any) -> Lab:
            nonlocal count
            count += 1
            made = Lab(scenario(**tables), tmp_path / f"lab{count}", programs=programs)
            return await stack.enter_async_context(made)

        yield start
