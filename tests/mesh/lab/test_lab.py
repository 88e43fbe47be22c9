"""A lab as its users have it."""

from __future__ import annotations

import pytest

from tests.mesh.lab.conftest import StartLab

pytestmark = pytest.mark.root


async def test_programs_run_in_hosts(start_lab: StartLab) -> None:
    lab = await start_lab(
        programs=False,
        hosts={"h1": {}, "h2": {}},
        media=[{"kind": "link", "between": ["h1", "h2"], "interface": "eth0"}],
    )
    done = await lab.run_in("h2", "sh", "-c", "cat /proc/net/dev; echo $ZMAV_FLEET; exit 3")
    assert done.returncode == 3
    assert "eth0:" in done.stdout
    assert done.stdout.split()[-1] == "lab"
