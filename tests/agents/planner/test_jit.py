"""Compiled kernels: kept where they can be, and never used after a source of theirs has changed."""

from __future__ import annotations

import ast
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import pytest

from agents.planner.solve import jit
from agents.planner.solve import warm as warming
from agents.planner.solve.warm import warm

KERNELS = sorted(p for p in jit.PACKAGE.rglob("*.py") if "\n@jit\n" in p.read_text() or p.name == "jit.py")
CALLED = "from agents.planner.solve.jit import jit\n\n@jit\ndef inner(x):\n    return x + 1.0\n"
CALLER = (
    "from {name}.called import inner\nfrom agents.planner.solve.jit import jit\n\n"
    "@jit\ndef outer(x):\n    return inner(x)\n"
)


def test_a_change_in_any_kernel_changes_the_fingerprint_and_no_other_change_does(tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    called, plain = tmp_path / "sub" / "called.py", tmp_path / "plain.py"
    called.write_text(CALLED)
    plain.write_text("@jit_not\ndef f(x):\n    return x  # @jit\n")
    before = jit.fingerprint(tmp_path)
    plain.write_text("x = 2\n")
    assert jit.fingerprint(tmp_path) == before
    called.write_text(CALLED.replace("1.0", "2.0"))
    changed = jit.fingerprint(tmp_path)
    called.rename(tmp_path / "called.py")
    assert len({before, changed, jit.fingerprint(tmp_path)}) == 3


def test_two_processes_keep_both_kinds_of_a_kernel_until_one_in_another_file_changes(tmp_path: Path) -> None:
    """Numba reads its index of them, adds to it and writes it again; and it looks at a kernel's own file only."""
    package = tmp_path / "kernels_of_a_test"
    package.mkdir()
    (package / "caller.py").write_text(CALLER.format(name=package.name))
    (package / "called.py").write_text(CALLED)
    program = (
        "import sys; from pathlib import Path; from agents.planner.solve import jit\n"
        f"sys.path.insert(0, {str(tmp_path)!r}); jit.PACKAGE = Path({str(package)!r})\n"
        f"from {package.name}.caller import outer\n"
        "print(*(outer(eval(given)) for given in sys.argv[1:]), sum(outer.stats.cache_hits.values()))"
    )

    def start(*given: str) -> subprocess.Popen[str]:
        # -B: Python itself takes two sources of one size and second for the same.
        command = [sys.executable, "-B", "-c", program, *given]
        return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)

    def said(process: subprocess.Popen[str]) -> list[str]:
        return process.communicate()[0].split()

    both = [start("1"), start("1.0")]
    assert list(map(said, both)) == [["2.0", "0"], ["2.0", "0"]]
    assert said(start("1", "1.0")) == ["2.0", "2.0", "2"]
    (package / "called.py").write_text(CALLED.replace("1.0", "2.0"))
    assert said(start("1.0")) == ["3.0", "0"]


@pytest.fixture
def package(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[[str], None]:
    """Have the sources lie at a place in the test's folder, and no other named."""

    def lie(place: str) -> None:
        monkeypatch.setattr(jit, "PACKAGE", tmp_path / place)
        monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)

    return lie


@pytest.fixture
def kept(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Where compiled kernels are kept."""
    monkeypatch.setattr(jit, "folder", lambda: tmp_path)
    return tmp_path


def test_kernels_go_to_the_users_cache_where_the_sources_cannot_have_them_or_nowhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, package: Callable[[str], None]
) -> None:
    (tmp_path / "file").touch()  # in which nobody can make a folder, root neither
    package("file")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    found = jit.folder.__wrapped__()
    assert found is not None and found.is_dir() and found.parent == tmp_path / "cache" / "zmav"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert jit.folder.__wrapped__() is None
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "told"))
    told = jit.folder.__wrapped__()
    assert told is not None and told.parent == tmp_path / "told"


def test_few_older_folders_stay(tmp_path: Path, package: Callable[[str], None]) -> None:
    package(".")
    for k in range(3 * jit.KEPT):
        (tmp_path / "kernel.py").write_text(CALLED.replace("1.0", f"{k}.0"))
        last = jit.folder.__wrapped__()
    left = list((tmp_path / "__pycache__").glob("kernels-*"))
    assert last in left and len(left) == 1 + jit.KEPT


@pytest.mark.usefixtures("kept")
def test_one_compiles_a_part_and_who_comes_later_finds_it_done() -> None:
    with pytest.raises(KeyboardInterrupt), jit.compiling("ways"):
        raise KeyboardInterrupt
    with jit.compiling("ways") as ours:  # what was broken off is done again
        assert ours
        with jit.compiling("ways", wait=False) as another, jit.compiling("judged", wait=False) as other_part:
            assert not another and other_part
    with jit.compiling("ways") as ours, jit.compiling("judged") as others:
        assert not ours and not others
    assert not jit.compiled()
    jit.complete()
    assert jit.compiled()


@pytest.mark.usefixtures("kept")
def test_a_plan_from_a_file_waits_for_what_it_needs_and_another_process_does_the_rest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    compiled: list[str] = []
    others: list[None] = []
    monkeypatch.setattr(warming, "PARTS", {name: lambda n=name: compiled.append(n) for name in warming.PARTS})
    monkeypatch.setattr(warming, "_other", lambda first: others.append(None))
    warming.begin(planes=False)
    assert compiled == list(warming.FIRST) and len(others) == 1
    warming.begin(planes=True)
    assert compiled == [*warming.FIRST, "winged"] and len(others) == 2
    jit.complete()
    warming.begin(planes=True)
    assert len(compiled) == len(warming.FIRST) + 1 and len(others) == 2


def test_who_needs_a_part_waits_for_who_compiles_it(kept: Path) -> None:
    jit.wait_for("discrete")  # nobody does
    waited = threading.Thread(target=jit.wait_for, args=("discrete",))
    with jit.compiling("discrete") as ours:
        waited.start()
        waited.join(0.3)
        assert ours and waited.is_alive() is not jit.interpreted()
    waited.join(30.0)
    assert not waited.is_alive() and (kept / "discrete.done").exists()


def test_all_kernels_are_compiled_before_a_first_plan() -> None:
    """None is left for a plan of vehicles in flight to wait for."""
    warm()
    done, of = jit.progress()
    assert done == of > 70


def test_a_kernel_is_compiled_once_for_all_integers_that_others_call_it_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))  # not among those that are counted
    jit.folder.cache_clear()
    try:

        @jit.jit
        def inner(n: int) -> int:
            return n + 1

        @jit.jit
        def outer(n: int) -> int:
            return inner(1) + inner(2) + inner(n)

        assert outer(3) == 9
        assert jit.interpreted() or len(cast(Any, inner).signatures) == 1
    finally:
        jit.folder.cache_clear()


@pytest.mark.parametrize("path", KERNELS, ids=lambda p: str(p.relative_to(jit.PACKAGE)))
def test_no_kernel_uses_linear_algebra(path: Path) -> None:
    """So that numba is loaded without SciPy's."""
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.FunctionDef) and any(getattr(d, "id", "") == "jit" for d in node.decorator_list):
            attributes = {inner.attr for inner in ast.walk(node) if isinstance(inner, ast.Attribute)}
            assert not attributes & {"linalg", "dot", "vdot"}, node.name
            assert not any(isinstance(inner, ast.MatMult) for inner in ast.walk(node)), node.name


def test_numba_is_loaded_without_linear_algebra_and_a_parser_of_c_and_others_have_them_still() -> None:
    program = (
        "import sys; from agents.planner.solve import warm; warm.load_numba()\n"
        "assert 'scipy.linalg' not in sys.modules and 'numba.np.arraymath' in sys.modules\n"
        "assert 'pycparser' not in sys.modules and 'cffi' not in sys.modules\n"
        "import scipy.linalg, scipy.optimize; warm.load_numba(); print(scipy.linalg.norm([3.0, 4.0]))"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["5.0"]


@pytest.mark.parametrize("path", KERNELS, ids=lambda p: str(p.relative_to(jit.PACKAGE)))
def test_kernels_use_no_constants_of_files_that_the_fingerprint_leaves_out(path: Path) -> None:
    """Numba compiles constants in."""
    tree = ast.parse(path.read_text())
    foreign = {
        name.asname or name.name
        for node in tree.body
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(("agents.", "zmav."))
        for name in node.names
        if jit.PACKAGE.parents[1] / f"{(node.module or '').replace('.', '/')}.py" not in KERNELS
    }
    used = {
        inner.id
        for node in tree.body
        if isinstance(node, ast.FunctionDef)
        and any(isinstance(d, ast.Name) and d.id == "jit" for d in node.decorator_list)
        for statement in node.body
        for inner in ast.walk(statement)
        if isinstance(inner, ast.Name)
    }
    assert not used & foreign
