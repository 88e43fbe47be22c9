"""``deploy/wifi`` in namespaces: the real systemd-networkd reads its files, and zmav's routers meet over the result."""

from __future__ import annotations

import base64
import json
import re
import shutil
import sys
from pathlib import Path

import pytest

from tests.deploy.networks import LAYOUTS, WIFI, fleet_file, rows
from tests.deploy.rig import Place, cable, check_able, client, places, until

pytestmark = pytest.mark.root
ZMAV = (sys.executable, "-m", "zmav")
COMPLAINT = re.compile(
    r"Unknown|[Ff]ailed to parse|Invalid|[Ii]gnoring (assignment|section)|ineffective|outside of section"
)


@pytest.fixture(autouse=True)
def able() -> None:
    check_able()


def complaints(directory: Path) -> list[str]:
    """What networkd says of the files in a directory, having read them all."""
    directory.with_suffix(".log").unlink(missing_ok=True)
    place = Place("reader", directory)
    try:
        place.configure()
        until(lambda: "Enumeration completed" in place.log.read_text(), "networkd has read its files", place.log)
        return [line for line in place.log.read_text().splitlines() if COMPLAINT.search(line)]
    finally:
        place.end()


def test_networkd_knows_every_line(tmp_path: Path) -> None:
    """All files of all layouts at once, each under a name of its own; the keys of WireGuard are put in as told."""
    directory = tmp_path / "all"
    directory.mkdir()
    key = base64.b64encode(bytes(range(32))).decode()
    count = 0
    for path in sorted(each for layout in LAYOUTS for each in (WIFI / layout).glob("**/systemd/network/**/*")):
        if path.is_dir():
            continue
        steps = path.relative_to(WIFI).parts
        below = steps.index("network") + 1
        name = f"{'-'.join(steps[:below])}-{'/'.join(steps[below:])}"
        if steps[below].endswith(".d"):  # a main file of its own, or nobody would read it
            name = f"{'-'.join(steps[:-1])}.network"
        target = directory / name
        target.parent.mkdir(parents=True, exist_ok=True)
        text = path.read_text(encoding="utf-8")
        text = re.sub(r"PUBLIC-KEY-OF-\w+", key, text).replace(
            "/etc/systemd/network/wg0.key", "/etc/systemd/network/key"
        )
        match = "" if "[Match]" in text or "[NetDev]" in text else "[Match]\nName=nosuch0\n"
        target.write_text(match + text, encoding="utf-8")
        count += 1
    (directory / "key").write_text(key)
    shutil.chown(directory / "key", group="systemd-network")
    (directory / "key").chmod(0o640)
    assert count > 30
    assert complaints(directory) == []
    (directory / "99-wrong.network").write_text("[Match]\nName=nosuch0\n[Network]\nAdress=10.77.0.9/24\n")
    assert len(complaints(directory)) == 1, "networkd does not say what it does not know"


def test_a_peer_whose_key_was_not_put_in_is_refused(tmp_path: Path) -> None:
    directory = tmp_path / "lte"
    shutil.copytree(WIFI / "lte" / "host" / "systemd" / "network", directory)
    assert any("PUBLIC-KEY-OF-meeting" in line or "PublicKey" in line for line in complaints(directory))


@pytest.mark.slow
def test_zmav_finds_its_vehicle_through_the_bridges(tmp_path: Path) -> None:
    """access-point: ground - ap - bridge - quad1 and quad2, with their addresses and the fleet file."""
    table = {row.host: row for row in rows("access-point")}
    wanted = ["ground", "ap", "quad1", "quad2", "bridge of quad1", "bridge of quad2"]
    with places("access-point", {name: table[name].folders for name in wanted}, tmp_path) as made:
        ap, ground = made["ap"], made["ground"]
        cable(ap, "eth0", ground, "eth0")
        for place in made.values():
            if not place.name.startswith("bridge of"):
                place.configure()
        for number, name in enumerate(("quad1", "quad2"), 1):
            bridge = made[f"bridge of {name}"]
            cable(bridge, "eth0", made[name], "eth0")
            client(ap, number, bridge, "wlan0")
            bridge.configure()
        for name, place in made.items():
            place.await_address(table[name].interface, table[name].address)
        shared = ("--file", str(fleet_file("access-point")), "--insecure")
        ground.start(*ZMAV, "router", "--name", "ground", *shared, log=tmp_path / "router.log")
        for number, name in enumerate(("quad1", "quad2"), 1):
            simulated = tmp_path / f"{name}.toml"
            simulated.write_text(f'[vehicles.{name}]\nlink = "tcp:127.0.0.1:5760"\nsysid = {number}\nsim = {{}}\n')
            control = str(tmp_path / f"{name}.sock")
            made[name].start(*ZMAV, "sim", "--fleet", str(simulated), "--control", control)
            up = ("up", "--link", "tcp:127.0.0.1:5760", "--name", name)
            made[name].start(*ZMAV, *up, *shared, log=tmp_path / f"{name}.up.log")

        def seen() -> set[tuple[str, bool, str | None]]:
            told = ground.run(*ZMAV, "ls", "--fleet", "field", "--json", check=False)
            vehicles = [json.loads(line) for line in told.splitlines()]
            return {(each["name"], each.get("connected", False), each.get("clash")) for each in vehicles}

        both = {("quad1", True, None), ("quad2", True, None)}
        until(lambda: seen() == both, "both vehicles in 'zmav ls' on the ground", tmp_path / "quad1.up.log")
