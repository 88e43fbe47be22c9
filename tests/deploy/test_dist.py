"""The wheel and the sdist: the same bytes twice, all in them that is needed, and a bill of what they are made of."""

from __future__ import annotations

import hashlib
import importlib.util
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import zipfile
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from zmav.cli.install import PACKAGES, lay_out
from zmav.shared import TREE, deploy

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parent.parent.parent


def script(name: str) -> ModuleType:
    """A program of deploy/, which is no package."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "deploy" / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.process
def test_what_is_built_is_the_same_bytes_twice_and_from_what_an_installation_holds(tmp_path: Path) -> None:
    pytest.importorskip("hatchling", reason="needs the build extra")
    dist = script("dist")
    tree = tmp_path / "tree"
    lay_out(tree)
    sdist, wheel = dist.build_twice(tree, tmp_path / "scratch")
    assert (sdist.suffix, wheel.suffix) == (".gz", ".whl")
    dist.check_contents(wheel)
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "installed")
        for each in archive.infolist():  # pip sets these, zipfile does not
            (tmp_path / "installed" / each.filename).chmod(each.external_attr >> 16 & 0o777)
    (data,) = (tmp_path / "installed").glob("*.data/data/share/zmav")
    laid = tmp_path / "laid"
    shutil.copytree(data, laid)
    for name in PACKAGES:
        shutil.copytree(tmp_path / "installed" / name, laid / name)
    (again,) = dist.build(laid, tmp_path / "again", "wheel")
    dist.same(wheel, again, "built as 'zmav install' does")


def test_the_tree_that_an_installation_lays_out_is_all_that_the_installer_wants(tmp_path: Path) -> None:
    assert (TREE, deploy()) == (ROOT, ROOT / "deploy")
    installer = lay_out(tmp_path / "tree")
    assert installer == tmp_path / "tree" / "deploy" / "install.sh"
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    for source, target in project["tool"]["hatch"]["build"]["targets"]["wheel"]["shared-data"].items():
        assert target == f"share/zmav/{source}"
        assert (tmp_path / "tree" / source).exists()
    assert not list((tmp_path / "tree").rglob("__pycache__"))


def test_each_extra_is_tried_and_those_for_users_are_what_the_installer_and_its_page_name() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = set(project["optional-dependencies"])
    sys.path.insert(0, str(ROOT / "deploy"))
    try:
        assert set(script("extras").PROMISES) == extras
    finally:
        sys.path.remove(str(ROOT / "deploy"))
    for_users = extras - {"build", "site", "all", "dev"}
    helped = subprocess.run(
        ["bash", ROOT / "deploy" / "install.sh", "--help"], capture_output=True, text=True, check=True
    )
    (named,) = re.findall(r"--extras LIST .*\n +(.*)\n", helped.stdout)
    assert set(named.split(", ")) == for_users
    page = (ROOT / "docs" / "install.md").read_text(encoding="utf-8")
    assert (
        set(re.findall(r"^\| `(\w+)` \|", page.split("| extra |")[1].split("`deploy/extras.py`")[0], re.M)) == for_users
    )
    (everything,) = project["optional-dependencies"]["all"]
    assert set(everything.removeprefix("zmav[").removesuffix("]").split(",")) == for_users - {"interpreted"}


@pytest.mark.process
def test_an_installation_that_is_interrupted_ends_as_its_script_wants(tmp_path: Path) -> None:
    """It may be at what must not be left half done; its files stay until then."""
    (tmp_path / "deploy").mkdir()
    slow = """trap '' INT; echo begun; sleep 1; test -f "$0" && echo whole"""
    (tmp_path / "deploy" / "install.sh").write_text(slow, encoding="utf-8")
    program = (
        "import shutil; from zmav.cli import install\n"
        f"install.lay_out = lambda to: shutil.copytree({str(tmp_path / 'deploy')!r}, to / 'deploy') / 'install.sh'\n"
        "install.command([])"
    )
    command = [sys.executable, "-c", program]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True) as run:
        assert run.stdout is not None
        assert run.stdout.readline() == "begun\n"
        os.killpg(run.pid, signal.SIGINT)
        assert run.stdout.read() == "whole\n"
    assert run.returncode == 0


@pytest.fixture(scope="module")
def bill() -> dict[str, Any]:
    sys.path.insert(0, str(ROOT / "deploy"))
    try:
        found: dict[str, Any] = script("sbom").bill()
    finally:
        sys.path.remove(str(ROOT / "deploy"))
    return found


def test_the_bill_names_every_package_of_the_lock_with_its_hashes(bill: dict[str, Any]) -> None:
    assert (bill["bomFormat"], bill["specVersion"]) == ("CycloneDX", "1.6")
    lock = (ROOT / "requirements.lock").read_text(encoding="utf-8")
    pinned = [line.split("==")[0] for line in lock.splitlines() if "==" in line and line[0].isalnum()]
    packages = [each for each in bill["components"] if each["purl"].startswith("pkg:pypi/")]
    assert sorted(each["name"] for each in packages) == sorted(pinned)
    assert sum(len(each["hashes"]) for each in packages) == lock.count("sha256:")
    assert len({each["bom-ref"] for each in bill["components"]}) == len(bill["components"])
    (zenoh,) = [each for each in packages if each["name"] == "eclipse-zenoh"]
    assert zenoh["scope"] == "required"
    assert zenoh["licenses"]
    assert all(each["properties"][0]["value"] for each in packages), "each is there for the core or an extra"


def test_the_bill_names_what_is_vendored_with_its_licence(bill: dict[str, Any]) -> None:
    vendored = {each["name"]: each for each in bill["components"] if not each["purl"].startswith("pkg:pypi/")}
    page, ros = ROOT / "ground/http/static/vendor", ROOT / "ground/ros2/interfaces"
    manifests = {folder: json.loads((folder / "manifest.json").read_bytes()) for folder in (page, ros)}
    assert set(vendored) == {each["name"] for manifest in manifests.values() for each in manifest}
    for folder, manifest in manifests.items():
        listed = {"manifest.json"}
        for each in manifest:
            assert vendored[each["name"]]["licenses"][0]["license"]["name"] == each["licence"]
            for name, digest in each["files"].items():
                assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest, name
            listed |= set(each["files"])
        there = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
        ours = {name for name in there if name.startswith("zmav_msgs/")}
        assert there - ours == listed, "each file that others wrote is in a manifest"
    assert all((page / f"{each['name']}.LICENSE").is_file() for each in manifests[page])
