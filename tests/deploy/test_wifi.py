"""``deploy/wifi``: addresses agree wherever they stand, fleet files can be planned, the real programs parse theirs."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections import defaultdict
from ipaddress import ip_interface
from pathlib import Path

import pytest
from click.testing import CliRunner

from mesh.cli.config import command
from mesh.plan import plan_router
from tests.deploy.networks import LAYOUTS, WIFI, addresses, entries, files, fleet_file, networkd, rows, values
from zmav.config import load_fleet
from zmav.session import SessionSettings

CHANNEL = {"5180": "36", "5220": "44", "5240": "48"}
"""MHz -> number, of those in use here"""

layouts = pytest.mark.parametrize("layout", LAYOUTS)


def test_all_five_are_there() -> None:
    assert LAYOUTS == ["access-point", "lte", "mesh", "two-radios", "wds"]


@layouts
def test_a_table_says_what_the_files_set(layout: str) -> None:
    table = rows(layout)
    assert table
    for row in table:
        assert (row.interface, row.address) in set(addresses(layout, row.folders)), row


@layouts
def test_nothing_lies_there_that_no_host_takes(layout: str) -> None:
    taken = {path for row in rows(layout) for path in files(layout, row.folders).values()}
    spare = {path for path in (WIFI / layout).rglob("*") if path.is_file() and path.suffix not in (".md", ".toml")}
    assert spare <= taken, spare - taken


@layouts
def test_no_two_have_one_address_and_each_interface_has_one_network(layout: str) -> None:
    seen: dict[str, str] = {}
    networks = defaultdict(set)
    for row in rows(layout):
        mine = ip_interface(row.address)
        assert seen.setdefault(str(mine.ip), row.host) == row.host, f"{mine.ip}: {seen[str(mine.ip)]} and {row.host}"
        assert mine.ip not in (mine.network.network_address, mine.network.broadcast_address)
        networks[str(mine.network)].add(mine.network)
        by_host = {ip_interface(each.address).network for each in rows(layout) if each.host == row.host}
        assert len(by_host) == len([each for each in rows(layout) if each.host == row.host]), "two radios, one network"
    apart = [next(iter(each)) for each in networks.values()]
    assert not any(a.overlaps(b) for a in apart for b in apart if a is not b)


@layouts
def test_the_fleet_file_has_the_same_addresses(layout: str) -> None:
    table = rows(layout)
    fleet = load_fleet(fleet_file(layout))
    there = {(row.host, row.interface): ip_interface(row.address) for row in table}
    checked = 0
    for place, host in fleet.hosts().items():
        name = place.partition(".")[2]
        for radio in host.mesh.radios:
            ours = [i for (who, interface), i in there.items() if who == name and radio.interface in (None, interface)]
            assert radio.ip() in ours, f"{place}: {radio.address} on {radio.interface}; the table has {ours}"
            checked += 1
    assert checked >= 4


@layouts
def test_each_host_s_router_can_be_planned_with_the_addresses_that_it_has(layout: str) -> None:
    path = fleet_file(layout)
    fleet = load_fleet(path)
    for place in fleet.hosts():
        name = place.partition(".")[2]
        told = CliRunner().invoke(command, ["--file", str(path), "--name", name, "--insecure", "--json"])
        assert told.exit_code == 0, told.output
        there = {row.interface: [ip_interface(row.address)] for row in rows(layout) if row.host == name}
        plan = plan_router(fleet, name, SessionSettings(), insecure=True, there=there)
        assert plan.radios
        assert all(radio.present for radio in plan.radios), "a radio is on another interface than networkd's"
        assert not plan.scouts_on, "all addresses are known here: no multicast"


def test_the_meeting_point_is_where_all_call_it() -> None:
    fleet = load_fleet(fleet_file("lte"))
    meeting = plan_router(
        fleet, "meeting", SessionSettings(), insecure=True, there={"wg0": [ip_interface("10.8.0.254/16")]}
    )
    assert any("10.8.0.254:7447" in each for each in meeting.listens)
    assert [each for each in fleet.mesh.rendezvous if "/10.8.0.254:7447?" in each]


def test_the_tunnel_lets_each_host_be_itself_alone() -> None:
    hub = entries(WIFI / "lte/meeting/systemd/network/30-wg0.netdev")
    allowed = dict(
        zip(values(hub, "WireGuardPeer", "PublicKey"), values(hub, "WireGuardPeer", "AllowedIPs"), strict=True)
    )
    hosts = {row.host: ip_interface(row.address) for row in rows("lte") if row.host != "meeting"}
    assert allowed == {f"PUBLIC-KEY-OF-{host}": f"{address.ip}/32" for host, address in hosts.items()}
    spoke = entries(WIFI / "lte/host/systemd/network/30-wg0.netdev")
    (network,) = {str(address.network) for address in hosts.values()}
    assert values(spoke, "WireGuardPeer", "AllowedIPs") == [network]
    (endpoint,) = values(spoke, "WireGuardPeer", "Endpoint")
    assert endpoint.rpartition(":")[2] == values(hub, "WireGuard", "ListenPort")[0]
    assert values(spoke, "NetDev", "MTUBytes") == values(hub, "NetDev", "MTUBytes")


def test_no_key_is_given_away() -> None:
    for path in WIFI.rglob("*"):
        if path.is_file():
            text = path.read_text(encoding="utf-8")
            assert not re.search(r"\b[A-Za-z0-9+/]{43}=", text), f"{path} has a key in it"
            assert set(re.findall(r'^\s*sae_password="?([^"\n]+)', text, re.MULTILINE)) <= {"change-me-before-flight"}


def settings(path: Path) -> dict[str, str]:
    """A file of hostapd or wpa_supplicant: names and values, without the braces and quotes."""
    found = re.findall(r"^\s*(\w+)=([^{\n]+)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    return {name: value.strip('"') for name, value in found}


@layouts
def test_those_who_are_to_hear_each_other_agree(layout: str) -> None:
    air = [path for path in (WIFI / layout).rglob("*.conf") if path.parent.name in ("hostapd", "wpa_supplicant")]
    said = [settings(path) for path in air]
    if not said:
        assert layout == "lte"
        return
    for name in ("ssid", "sae_password", "ieee80211w", "sae_pwe"):
        assert len({each[name] for each in said}) == 1, name
    assert len({each.get("country") or each.get("country_code") for each in said}) == 1
    channels = {each["channel"] for each in said if "channel" in each}
    looked_on = {CHANNEL[each] for one in said for each in one.get("freq_list", one.get("frequency", "")).split()}
    if layout in ("access-point", "wds"):
        assert looked_on == channels
    assert all(each.get("scan_freq") == each.get("freq_list") for each in said)


def test_relays_reach_the_one_before_them_and_never_themselves() -> None:
    own = {host: settings(WIFI / f"wds/{host}/hostapd/wlan0.conf")["channel"] for host in ("mast", "roof", "van")}
    assert len(set(own.values())) == 3
    for relay, before in (("roof", {"mast"}), ("van", {"mast", "roof"})):
        uplink = settings(WIFI / f"wds/{relay}/wpa_supplicant/wpa_supplicant-wlan1.conf")
        assert {CHANNEL[each] for each in uplink["freq_list"].split()} == {own[each] for each in before}
    texts = {re.sub(r"(?m)^channel=\d+$", "", (WIFI / f"wds/{h}/hostapd/wlan0.conf").read_text()) for h in own}
    assert len(texts) == 1, "the three differ in more than the channel"


def test_who_bridges_a_client_uses_four_addresses_at_both_ends() -> None:
    for path in WIFI.rglob("70-wifi.rules"):
        rule, folder = path.read_text(encoding="utf-8"), path.parents[2]
        assert "set power_save off" in rule
        joined = [
            each
            for each in folder.rglob("*.network")
            if "Bridge=br0" in each.read_text() and re.search(r"(?m)^Name=.*wlan", each.read_text())
        ]
        assert bool(joined) == ("set 4addr on" in rule), path
        units = list(folder.rglob("wpa_supplicant@*.service.d/*.conf"))
        assert units
        assert all(("-bbr0" in each.read_text()) == bool(joined) for each in units)
    for path in WIFI.rglob("hostapd/wlan0.conf"):
        assert settings(path)["wds_sta"] == "1"
        assert settings(path)["wds_bridge"] == settings(path)["bridge"] == "br0"


def test_the_mesh_has_room_for_what_batman_adv_puts_before_a_frame() -> None:
    made = networkd("mesh", ("host", "quad1"))
    (inside,) = values(made["10-bat0.netdev"], "NetDev", "MTUBytes")
    (outside,) = values(made["20-wlan0.network"], "Link", "MTUBytes")
    assert int(outside) - int(inside) == 32
    assert values(made["20-wlan0.network"], "Network", "BatmanAdvanced") == ["bat0"]


PROGRAMS = {"hostapd": ["hostapd"], "wpa_supplicant": ["wpa_supplicant", "-i", "nosuch0", "-c"]}


def complaints(program: str, path: Path) -> list[str]:
    """What the real program says of the lines of its file; it then fails, for there is no such interface."""
    done = subprocess.run(
        [*PROGRAMS[program], str(path)],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=20,
        check=False,
    )
    assert done.returncode != 0
    return [
        line for line in (done.stdout + done.stderr).splitlines() if re.search(r"^Line \d+|errors found|parse", line)
    ]


@pytest.mark.parametrize("program", sorted(PROGRAMS))
def test_the_program_itself_parses_its_files(program: str, tmp_path: Path) -> None:
    if shutil.which(program) is None:
        pytest.skip(f"{program} is not installed")
    found = sorted(path for path in WIFI.rglob("*.conf") if path.parent.name == program)
    assert found
    for path in found:
        text = re.sub(r"wlan\d", "nosuch0", path.read_text(encoding="utf-8"))  # never an interface of this computer
        text = text.replace("/run/wpa_supplicant GROUP=netdev", str(tmp_path / "control"))
        ours = tmp_path / path.name
        ours.write_text(text, encoding="utf-8")
        assert not complaints(program, ours), path
        ours.write_text(text.replace("sae_pwe=2", "sae_pew=2"), encoding="utf-8")
        assert complaints(program, ours), "the program does not say what it does not know"


UNITS = (Path("/lib/systemd/system"), Path("/usr/lib/systemd/system"))
DROPINS = sorted(WIFI.rglob("*.service.d/*.conf"))


@pytest.mark.parametrize("dropin", DROPINS, ids=lambda path: str(path.relative_to(WIFI)).replace("/systemd/system", ""))
def test_systemd_takes_the_unit_with_what_is_added_to_it(dropin: Path, tmp_path: Path) -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("needs systemd-analyze")
    unit = dropin.parent.name.removesuffix(".d")
    template = unit.partition("@")[0] + "@.service"
    base = next((folder / template for folder in UNITS if (folder / template).is_file()), None)
    if base is None:
        pytest.skip(f"the package that has {template} is not installed")
    shutil.copyfile(base, tmp_path / template)
    target = tmp_path / dropin.parent.name / dropin.name
    target.parent.mkdir()
    for text, good in ((dropin.read_text(encoding="utf-8"), True), ("[Service]\nRestrat=always\n", False)):
        target.write_text(text, encoding="utf-8")
        done = subprocess.run(
            ["systemd-analyze", "verify", unit],
            env={"PATH": os.environ["PATH"], "SYSTEMD_UNIT_PATH": f"{tmp_path}:"},
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        about = [line for line in (done.stdout + done.stderr).splitlines() if str(tmp_path) in line or unit in line]
        assert (not about) == good, about
