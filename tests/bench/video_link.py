"""What comes of video over a link of 1 Mbit/s that loses 5 %: ``sudo python tests/bench/video_link.py``.

Needs root and /dev/net/tun: a lab of a vehicle and a ground host with a router each, over ``udp/?rel=1;mixed_rel=1``
and, with credentials, over ``quic/``. Of the last half of a minute: units and key frames that came, torn ones, delay,
bytes.
"""

from __future__ import annotations

import asyncio
import json
import statistics
import sys
import tempfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from mesh.lab.lab import Lab  # noqa: E402

SECONDS = 60
VERB = "import sys; from zmav import cli; from agents.camera.video_cli import video; cli.zmav = video; cli.main()"
SOURCES = {
    "an encoder that is told its bits": ("clock:1280x720@30",),
    "a camera of 0.4 Mbit/s": ("{folder}/lean.mp4",),
    "one of 2 and of 0.4 Mbit/s": ("{folder}/rich.mp4", "{folder}/lean.mp4"),
    "one of 2 Mbit/s": ("{folder}/rich.mp4",),
}


def scenario(credentials: bool) -> str:
    return f"""
name = "video"
profile = "lan"
credentials = {str(credentials).lower()}
[hosts.ground]
[hosts.quad1]
[[media]]
kind = "link"
name = "air"
between = ["quad1", "ground"]
rate = "1 Mbit/s"
delay = "5 ms"
loss = 0.05
"""


async def measured(credentials: bool, sources: tuple[str, ...]) -> list[dict[str, Any]]:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "video.toml"
        file.write_text(scenario(credentials))
        async with Lab(file) as lab:
            await lab.ready()
            run = ["timeout", "-s", "INT", str(SECONDS + 8), sys.executable, "-c", VERB, "run", *sources]
            camera = asyncio.create_task(
                lab.run_in("quad1", *run, "--vehicle", "quad1", "--loop", timeout=SECONDS + 60)
            )
            show = [
                "timeout",
                "-s",
                "INT",
                str(SECONDS),
                sys.executable,
                "-c",
                VERB,
                "show",
                "quad1",
                "--wait",
                "30",
                "--json",
            ]
            done = await lab.run_in("ground", *show, timeout=SECONDS + 60)
            said = await camera
    if not done.stdout:
        print(done.stderr, said.stderr)
    return [json.loads(line) for line in done.stdout.splitlines()]


def words(lines: list[dict[str, Any]]) -> str:
    late = lines[len(lines) // 2 :]
    if not late:
        return "nothing came"
    delays = [each["delay"] for each in late if each["delay"] is not None]
    return (
        f"{statistics.mean(each['rate_hz'] for each in late):.1f} Hz, "
        f"{sum(each['key_frames'] for each in late)} key frames in {len(late)} s, "
        f"{late[-1]['torn'] - late[0]['torn']} torn, {late[-1]['dropped'] - late[0]['dropped']} waited out, "
        f"{1e3 * statistics.median(delays):.0f} ms, {statistics.mean(each['rate_bytes'] for each in late) / 1e3:.0f} kB/s"
    )


async def main() -> None:
    from tests.bench.video import film

    with tempfile.TemporaryDirectory() as folder:
        for name, bits in (("rich", 2e6), ("lean", 4e5)):
            film(Path(folder) / f"{name}.mp4", bits=bits)
        for credentials in (False, True):
            for what, sources in SOURCES.items():
                lines = await measured(credentials, tuple(each.format(folder=folder) for each in sources))
                print(f"{'quic' if credentials else 'udp '}  {what}: {words(lines)}", flush=True)


if __name__ == "__main__":
    asyncio.run(main())
