"""Recorders where there are credentials, and where packages are missing."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh

import zmav
from ground.record.folder import Folder
from ground.record.recorder import Recorder, Wanted
from ground.record.storage import RecordingSettings
from tests.ground.record.conftest import Frames
from tests.mesh.credentials.conftest import Fleet
from zmav import keys, wire
from zmav.client import Answer
from zmav.errors import BadConfig
from zmav.session import SessionSettings
from zmav.trust.certificate import Role
from zmav.trust.credentials import Credentials
from zmav.trust.proof import Signer

BLOCK: dict[str, Any] = {"congestion_control": zenoh.CongestionControl.BLOCK}


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Fleet]:
    fleet = Fleet(tmp_path)
    yield fleet
    fleet.close()


@pytest.mark.parametrize("role", [Role.VIEWER, Role.OPERATOR])
async def test_any_member_may_record_and_answer(fleet: Fleet, tmp_path: Path, role: Role) -> None:
    """Behind quad1's door: it hears all, believes the states that quad1 signed, and is heard when it answers."""
    fleet.issue(quad1=Role.VEHICLE, gs=role)
    door = fleet.router("quad1")
    home = fleet.open(None, door.unix)
    quad1 = Credentials.load(str(fleet.members["quad1"]))
    signer, key = Signer(quad1), keys.STATE.key("alpha", "quad1")

    def certificate(query: zenoh.Query) -> None:
        query.reply(query.key_expr, quad1.certificate.der)

    home.declare_queryable(keys.CERTIFICATE.key("alpha", "quad1"), certificate)
    settings = SessionSettings(connect=[door.quic], credentials=str(fleet.members["gs"]))
    make = Frames()

    async def last(what: str) -> wire.History | None:
        def get() -> list[bytes]:
            replies = home.get(f"zmav/alpha/gs/history/quad1/{what}", timeout=5.0)
            return [reply.ok.payload.to_bytes() for reply in replies if reply.ok]

        found = await asyncio.to_thread(get)
        return wire.decode(found[0], wire.History, "history") if found else None

    with Folder(tmp_path / "out") as folder:
        async with (
            zmav.open(fleet="alpha", settings=settings) as z,
            Recorder(z, folder, RecordingSettings(keep_free=0), Wanted(), lambda line: None) as recorder,
        ):
            assert recorder.name == "gs"
            number = 0
            while not (await last("state") and await last("ATTITUDE")):
                number += 1
                lie = wire.VehicleState(t=0.0, fleet="alpha", name="quad1", instance="i", mode="LIE")
                home.put(key, wire.encode(lie), **BLOCK)
                true = wire.encode(wire.VehicleState(t=number, fleet="alpha", name="quad1", instance="i", mode="AUTO"))
                home.put(key, true, attachment=signer.sign(key, true), **BLOCK)
                home.put(f"zmav/alpha/quad1/{make.key}", make(), **BLOCK)
            found = await last("state")
            assert found is not None
            assert found.entries[-1].value["mode"] == "AUTO"
            answers = await z.ask("zmav/alpha/*/history/quad1/state", b'{"last": 1000}', 10.0, keys.HISTORY)
            (answer,) = [answer for answer in answers if isinstance(answer, Answer)]
            every = wire.decode(answer.payload, wire.History, "history")
            assert {entry.value["mode"] for entry in every.entries} == {"AUTO"}
            with pytest.raises(BadConfig, match="by your credentials this host is gs"):
                Recorder(z, folder, RecordingSettings(), Wanted(name="other"), lambda line: None)


def test_without_the_mcap_package_tlogs_are_still_recorded_and_played(tmp_path: Path) -> None:
    """As on a core installation: the package cannot be imported."""
    program = f"""
import sys
for name in ("mcap", "zstandard", "starlette", "uvicorn", "websockets", "rerun"):
    sys.modules[name] = None
from pathlib import Path
from typing import Any
from click.testing import CliRunner
from ground.record import cli, replay
from ground.record.folder import Folder
from ground.record.sources import open_all
from ground.record.storage import RecordingSettings, Storage
from zmav.mavlink import Packer, load_dialect

told = CliRunner().invoke(cli.command, ["--out", {str(tmp_path)!r}])
assert "pip install 'zmav[ground]'" in str(told.exception), told
told = CliRunner().invoke(replay.command, [__file__.replace(".py", ".mcap")])
assert "pip install 'zmav[ground]'" in str(told.exception), told
with Folder(Path({str(tmp_path / "out")!r})) as folder:
    storage = Storage(folder, RecordingSettings(mcap=False, keep_free=0), load_dialect(), print)
    storage.start()
    frame = Packer(load_dialect(), sysid=1, compid=1).pack("HEARTBEAT")
    storage.put("zmav/demo/quad1/mav/rx/1/1/HEARTBEAT", frame)
    storage.close()
(source,) = open_all([storage.session])
assert [record.data for record in source.records()] == [frame]
print("played")
"""
    script = tmp_path / "core.py"
    script.write_text(program)
    (tmp_path / "core.mcap").write_text("")
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout == "played\n", done.stderr
