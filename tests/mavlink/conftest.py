"""What the MAVLink tests share: dialects, pymavlink as the independent judge, recordings."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from zmav.mavlink import Dialect, load_dialect


@pytest.fixture(scope="session")
def dialect() -> Dialect:
    """ardupilotmega, the default."""
    return load_dialect()


@pytest.fixture(scope="session")
def pymav() -> ModuleType:
    """pymavlink's own implementation of the same dialect."""
    from pymavlink.dialects.v20 import ardupilotmega

    module: ModuleType = ardupilotmega
    return module


@pytest.fixture(scope="session")
def recording(shared_data: Path) -> Callable[[str], list[bytes]]:
    """The frames of a recording: a .tlog has eight bytes of timestamp before each."""

    def read(name: str) -> list[bytes]:
        data = (shared_data / name).read_bytes()
        frames = []
        pos = 8
        while pos < len(data):
            end = pos + 12 + data[pos + 1] + (13 if data[pos + 2] & 1 else 0)
            frames.append(data[pos:end])
            pos = end + 8
        return frames

    return read
