"""What ``make check`` runs: the import closure of a test, the files that changed, and the marks."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Literal

import pytest
from pytest import TestReport

from tests.check import Durations, affected_modules, changed_files, long_tests
from tests.conftest import NEEDS, ROOT, marks, reached_by
from tests.imports import Source, Sources, parse

TREE = {
    "zmav/__init__.py": "from zmav.client import open\n",
    "zmav/geo.py": "",
    "zmav/client.py": "from zmav import wire\n",
    "zmav/wire.py": "def f():\n    from .geo import turn\n",
    "zmav/types.py": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from zmav.geo import Point\n",
    "zmav/started.py": "import zmav.geo\n",
    "tests/conftest.py": "from zmav.client import open\ndef helper(): return open()\ndef client(): return helper()\n",
    "tests/test_alone.py": "import zmav.types\ndef test_it(): assert zmav.types\n",
    "tests/test_client.py": "from tests.conftest import client\ndef test_a(): assert client()\ndef test_b(): pass\n",
    "tests/test_started.py": "COMMAND = ['-m', 'zmav.started']\n",
}


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    for name, text in TREE.items():
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    return tmp_path


def test_a_closure_follows_imports_in_functions_and_programs_but_neither_types_nor_packages(tree: Path) -> None:
    affected = affected_modules(tree, ["zmav/geo.py"])
    assert affected == {"zmav.geo", "zmav.wire", "zmav.client", "zmav", "zmav.started"}


def test_a_change_of_the_lock_affects_everything(tree: Path) -> None:
    assert affected_modules(tree, ["requirements.lock"]) >= {"tests.test_alone", "zmav.types"}
    assert affected_modules(tree, ["README.md"]) == set()
    assert affected_modules(tree, ["tests/test_alone.py"]) == {"tests.test_alone"}


def test_a_test_reaches_what_its_own_helpers_use(tree: Path) -> None:
    sources = Sources(tree)
    assert "zmav.client.open" in sources.reach("tests.test_client", "test_a")
    assert "zmav.client.open" not in sources.reach("tests.test_client", "test_b")
    assert "zmav.started" in sources.reach("tests.test_started", "test_c")


def test_what_was_read_is_kept_and_read_again_where_a_file_changed(tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache = tree / "kept" / "imports.json"
    first = affected_modules(tree, ["zmav/geo.py"], cache)
    parsed = list[str]()

    def count(module: str, path: Path, stamp: tuple[int, int]) -> Source:
        parsed.append(module)
        return parse(module, path, stamp)

    monkeypatch.setattr("tests.imports.parse", count)
    assert affected_modules(tree, ["zmav/geo.py"], cache) == first and parsed == []
    (tree / "zmav/client.py").write_text("from zmav import geo\n")
    (tree / "zmav/wire.py").write_text("")
    affected = affected_modules(tree, ["zmav/geo.py"], cache)
    assert affected == {"zmav.geo", "zmav.client", "zmav", "zmav.started"}
    assert sorted(parsed) == ["zmav.client", "zmav.wire"]
    sources = Sources(tree, cache=cache)
    assert "zmav.client.open" in sources.reach("tests.test_client", "test_a")
    cache.write_bytes(b"{")
    assert affected_modules(tree, ["zmav/geo.py"], cache) == affected, "a broken one is as none"


def test_what_changed_is_what_differs_from_the_merge_base(tree: Path) -> None:
    def git(*arguments: str) -> None:
        who = ("-c", "user.name=a", "-c", "user.email=a@b")
        subprocess.run(["git", *who, *arguments], cwd=tree, check=True, capture_output=True)

    git("init", "-b", "main")
    git("add", ".")
    git("commit", "-m", "first")
    assert changed_files(tree) == []
    git("switch", "-c", "work")
    (tree / "zmav/geo.py").write_text("A = 1\n")
    git("commit", "-am", "second")
    (tree / "zmav/wire.py").write_text("")
    (tree / "zmav/new.py").write_text("")
    assert changed_files(tree) == ["zmav/geo.py", "zmav/new.py", "zmav/wire.py"]
    assert changed_files(tree, "work") == ["zmav/new.py", "zmav/wire.py"]


def report(
    name: str,
    when: Literal["setup", "call"],
    outcome: Literal["passed", "failed"],
    took: float,
    kind: type[TestReport] = TestReport,
) -> TestReport:
    return kind(name, ("a.py", 1, "a"), {}, outcome, None, when, duration=took)


def test_the_least_that_a_passed_test_ever_took_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "new" / "durations.json"
    for call_s, least_s in ((2.0, 2.5), (0.25, 0.75), (4.0, 0.75)):
        durations = Durations(path)
        durations.pytest_runtest_logreport(report("a", "setup", "passed", 0.5))
        durations.pytest_runtest_logreport(report("a", "call", "passed", call_s, pytest.SubtestReport))
        durations.pytest_runtest_logreport(report("a", "call", "passed", call_s))
        durations.pytest_runtest_logreport(report("interrupted", "setup", "passed", 0.5))
        durations.pytest_runtest_logreport(report("interrupted", "call", "passed", 0.1, pytest.SubtestReport))
        durations.pytest_sessionfinish()
        assert Durations(path).least_s == {"a": least_s}
    durations.pytest_runtest_logreport(report("a", "call", "failed", 0.5))
    durations.pytest_sessionfinish()
    assert Durations(path).least_s == {}
    path.write_text("{")
    assert Durations(path).least_s == {}, "a torn one is as none"


def test_who_reads_the_tree_is_never_left_out_and_nobody_is_where_data_changed(tmp_path: Path) -> None:
    (tmp_path / "test_a.py").write_text("from tests.conftest import ROOT")
    (tmp_path / "test_b.py").write_text("from zmav import geo")
    least_s = {"test_a.py::a": 1.0, "test_b.py::b": 1.0, "test_b.py::c": 0.25, "test_gone.py::d": 1.0}
    assert long_tests(tmp_path, least_s, ["docs/vision.md", "zmav/geo.py"]) == ["test_b.py::b", "test_gone.py::d"]
    assert long_tests(tmp_path, least_s, ["agents/helipad/check.npz"]) == []


@pytest.mark.parametrize("modules", [[], ["zmav.geo"]])
def test_a_long_one_runs_where_what_it_uses_changed(tmp_path: Path, modules: list[str]) -> None:
    (asked := tmp_path / "asked").write_text(
        json.dumps({"modules": modules, "long": ["tests/test_geo.py::test_a_known_place"]})
    )
    names = ["tests/test_geo.py::test_distances", "tests/test_geo.py::test_a_known_place"]
    command = [sys.executable, "-m", "pytest", "-q", "--collect-only", f"--affected={asked}", *names]
    said = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert "test_distances" in said
    assert ("test_a_known_place" in said) == bool(modules)


@pytest.mark.parametrize(
    ("module", "name", "mark"),
    [
        ("tests.sim.conftest", "make_gcs", "flight"),
        ("tests.conftest", "net", "live"),
        ("tests.agents.demo.test_demo", "start_demo", "process"),
        ("tests.test_check", "test_what_changed_is_what_differs_from_the_merge_base", "process"),
    ],
)
def test_marks_are_given_by_what_a_test_reaches(module: str, name: str, mark: str) -> None:
    reached = Sources(ROOT, ["tests"]).reach(module, name)
    assert not NEEDS[mark].isdisjoint({*reached, *(each.rpartition(".")[0] for each in reached)})


def test_this_test_is_marked(request: pytest.FixtureRequest) -> None:
    assert marks(request.node, reached_by(request.node, Sources(ROOT, ["tests"]))) == ["unit"]
