"""The workflows for GitHub, which no test can run: what they name is in the tree, versions are the project's."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

import zmav

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parent.parent.parent
FOLDER = ROOT / ".github" / "workflows"
NAMES = sorted(path.name for path in FOLDER.glob("*.yml"))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
PYTHONS = re.findall(r":: (3\.\d+)'", str(PROJECT["classifiers"]))


def workflow(name: str) -> dict[Any, Any]:
    found = yaml.safe_load((FOLDER / name).read_text(encoding="utf-8"))
    assert isinstance(found, dict)
    return found


def steps(name: str) -> Iterator[dict[str, Any]]:
    for job in workflow(name)["jobs"].values():
        yield from job.get("steps", ())


def runs(name: str) -> str:
    return "\n".join(step["run"] for step in steps(name) if "run" in step)


def test_they_are_the_four() -> None:
    assert NAMES == ["build.yml", "ci.yml", "publish.yml", "site.yml"]


@pytest.mark.parametrize("name", NAMES)
def test_each_says_that_it_is_untried_and_may_write_nothing_by_default(name: str) -> None:
    head = (FOLDER / name).read_text(encoding="utf-8").split("name:")[0].replace("\n# ", " ")
    assert "never run on GitHub" in head
    assert workflow(name)["permissions"] == {"contents": "read"}
    jobs = workflow(name)["jobs"].values()
    assert all("timeout-minutes" in job for job in jobs if "uses" not in job)


@pytest.mark.parametrize("name", NAMES)
def test_what_they_run_is_there(name: str) -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"\bmake ([a-z]+)", runs(name)):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target
    for path in re.findall(r"(?:\bbash|\bpython3?) (\S*/\S+)", runs(name)):
        assert (ROOT / path).is_file(), path
    for job in workflow(name)["jobs"].values():
        assert "uses" not in job or (ROOT / job["uses"]).is_file()


def test_ci_and_build_try_every_python_that_the_project_names() -> None:
    assert PYTHONS[0] == PROJECT["requires-python"].removeprefix(">=")
    assert workflow("ci.yml")["jobs"]["test"]["strategy"]["matrix"]["python"] == PYTHONS
    assert "bash .ci/run" in runs("ci.yml")
    (given,) = [
        step["with"]["python-version"] for step in steps("build.yml") if "python-version" in step.get("with", {})
    ]
    assert given.split() == PYTHONS
    assert re.findall(r"--python python(\S+?)'?(?= |$|\n)", runs("build.yml")) == PYTHONS


def test_what_is_published_is_what_was_built_and_tested_and_only_by_a_tag() -> None:
    publish = workflow("publish.yml")
    assert publish[True] == {"push": {"tags": ["v*"]}}  # YAML 1.1 reads the key "on" as a truth value
    assert publish["jobs"]["publish"]["needs"] == ["build", "test"]
    assert [publish["jobs"][job]["uses"] for job in ("build", "test")] == [
        "./.github/workflows/build.yml",
        "./.github/workflows/ci.yml",
    ]
    assert publish["jobs"]["publish"]["permissions"]["id-token"] == "write"
    assert all(workflow(name)[True]["workflow_call"] is None for name in ("build.yml", "ci.yml"))
    names = {
        step["with"]["name"]
        for file in ("build.yml", "publish.yml")
        for step in steps(file)
        if "-artifact@" in step.get("uses", "")
    }
    assert names == {"dist"}
    assert not any("password" in step.get("with", {}) for step in steps("publish.yml"))
    assert "v$(sed -n " in runs("publish.yml") and "sha256sum --check SHA256SUMS" in runs("publish.yml")


def test_the_site_is_built_with_what_its_extra_brings() -> None:
    assert "make site" in runs("site.yml")
    assert {"mkdocs-material", "mike"} <= {
        re.split(r"[\[>=]", each)[0] for each in PROJECT["optional-dependencies"]["site"]
    }


def test_the_version_is_said_alike_everywhere() -> None:
    version = PROJECT["version"]
    assert zmav.__version__ == version
    assert f"<version>{version}</version>" in (ROOT / "ground/ros2/interfaces/zmav_msgs/package.xml").read_text()
    newest = re.findall(r"^## (.*)$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)[0]
    assert re.fullmatch(rf"{re.escape(version)} - 20\d\d-\d\d-\d\d", newest)
    said = (ROOT / "deploy/containers/README.md").read_text(encoding="utf-8")
    assert set(re.findall(r"zmav:(\d+\.\d+\.\d+)", said)) == {version}
