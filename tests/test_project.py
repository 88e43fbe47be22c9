"""The project's own rules: who may import whom, how long a file may be, what is pinned and what is installed."""

from __future__ import annotations

import ast
import functools
import importlib.metadata
import importlib.util
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping, Set
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parent.parent
MAX_LINES = 500

# What each top-level package may import of the project, besides itself.
BELOW = {
    "zmav": set(),
    "mesh": {"zmav"},
    "agents": {"mesh", "zmav"},
    "ground": {"mesh", "zmav"},
    "deploy": {"ground", "agents", "mesh", "zmav"},
}

# The layers within zmav, lowest first. A unit imports from lower layers, and from those named beside it in its own.
# "zmav" itself is the public face: everything below is gathered there, so nothing but the command line imports it.
LAYERS: tuple[dict[str, set[str]], ...] = (
    {
        "errors": set(),
        "process": {"errors", "systemd"},
        "waiting": set(),
        "systemd": set(),
        "tokens": {"direct"},
        "direct": set(),
        "ratelimit": set(),
        "guard": set(),
        "shared": {"errors"},
        "bus": set(),
        "tunable": {"errors"},
    },
    {
        "wire": set(),
        "keys": {"wire"},
        "geo": {"wire"},
        "verbs": {"wire", "keys"},
        "figures": set(),
        "rotation": set(),
        "terrain": set(),
    },
    {
        "config": set(),
        "formats": set(),
        "corrections": {"formats"},
        "traffic": {"corrections"},
        "host": set(),
        "trust": set(),
        "rundir": set(),
    },
    {"session": set(), "schemas": set()},
    {"mavlink": set(), "links": set()},
    {"autopilots": set(), "sim": set()},
    {"services": set(), "hil": set()},
    {
        # What runs beside an autopilot.
        "adapter": set(),
        "forwarding": {"adapter"},
        "onboard": {"adapter", "forwarding"},
        # What others read the key space with.
        "zenoh_codec": set(),
        # What agents and scripts use; a client hands out vehicles, and these ask through their client.
        "subscription": set(),
        "client": {"vehicle", "subscription"},
        "vehicle": {"client", "subscription"},
        "swarm": {"client", "vehicle"},
        "agent": {"client", "vehicle", "swarm"},
        "flying": {"agent", "vehicle"},
        "vision": {"client"},
        "children": {"client"},
    },
    {"doctor": set()},
    {"zmav": set()},
    {"cli": set(), "__main__": {"cli"}},
)
RANK = {unit: rank for rank, layer in enumerate(LAYERS) for unit in layer}


def files() -> list[Path]:
    """Every file of the project: the root's own, and those of its folders that are not some tool's."""
    tops = [path for path in ROOT.iterdir() if not path.name.startswith(".") or path.name in (".ci", ".gitignore")]
    folders = [path for path in tops if path.is_dir() and path.name not in ("build", "dist", "node_modules")]
    inside = [each for path in folders if not (path / "pyvenv.cfg").exists() for each in path.rglob("*")]
    return [path for path in (*tops, *inside) if path.is_file() and "__pycache__" not in path.parts]


def modules() -> list[tuple[str, Path]]:
    """Every module of the project outside the tests, as its dotted name and its file."""
    found = []
    for package in BELOW:
        for path in sorted((ROOT / package).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            found.append((".".join(parts[:-1] if parts[-1] == "__init__" else parts), path))
    return found


@functools.cache
def is_module(name: str) -> bool:
    path = ROOT.joinpath(*name.split("."))
    return path.is_dir() or path.with_suffix(".py").is_file()


def statements(tree: ast.AST) -> Iterator[ast.AST]:
    """All statements, those within others too: nine in ten nodes of a file are in expressions, where no import is."""
    todo = [tree]
    while todo:
        node = todo.pop()
        yield node
        for field in ("body", "orelse", "finalbody", "handlers", "cases"):
            inner = getattr(node, field, ())
            todo += inner if isinstance(inner, list) else ()


def imports(name: str, path: Path, source: str) -> Iterator[str]:
    """The project's modules that a module imports, wherever in the file, for types or to run."""
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    for node in statements(ast.parse(source, str(path))):
        if isinstance(node, ast.Import):
            found = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = importlib.util.resolve_name("." * node.level + (node.module or ""), package)
            if base.partition(".")[0] not in BELOW:
                continue
            # "from zmav import errors" names a module, "from zmav.errors import Stale" does not.
            inside = [f"{base}.{alias.name}" for alias in node.names]
            found = [each if is_module(each) else base for each in inside]
        else:
            continue
        yield from (each for each in found if each.partition(".")[0] in BELOW)


@functools.cache
def graph() -> dict[str, frozenset[str]]:
    """What each module of the project imports of it; reading all of them takes seconds."""
    return {name: frozenset(imports(name, path, path.read_text(encoding="utf-8"))) for name, path in modules()}


def unit_of(name: str) -> str:
    """The layer's unit a module of zmav belongs to: its first part below zmav, or zmav itself."""
    return name.split(".")[1] if "." in name else name


def objection(importer: str, imported: str) -> str | None:
    """Why a module may not import another, or None if it may."""
    above, below = importer.split(".")[0], imported.split(".")[0]
    if above != below:
        return None if below in BELOW[above] else f"{above} may import {sorted(BELOW[above])} only"
    if above == "agents":
        same = importer.split(".")[1:2] == imported.split(".")[1:2]
        return None if same else "agents meet in the key space, not in each other's code"
    if above != "zmav":
        return None
    our_unit, their_unit = unit_of(importer), unit_of(imported)
    if not {our_unit, their_unit} <= set(RANK):
        return None  # test_every_unit_of_zmav_has_a_layer says so, once
    if our_unit == their_unit or RANK[their_unit] < RANK[our_unit]:
        return None
    if their_unit in LAYERS[RANK[our_unit]].get(our_unit, ()):
        return None
    return f"zmav.{their_unit} is not below zmav.{our_unit}"


def test_imports_go_one_way() -> None:
    assert modules(), "no modules found: the test looks in the wrong place"
    wrong = [
        f"{name}: imports {imported}: {why}"
        for name, found in graph().items()
        for imported in found
        if (why := objection(name, imported))
    ]
    assert not wrong, "\n" + "\n".join(sorted(wrong))


# Where modules may import each other in a circle: a client hands out vehicles, which ask through their client.
CIRCLES = ("zmav.client", "zmav.vehicle")


def circles(graph: Mapping[str, Set[str]]) -> list[list[str]]:
    """The sets of modules that reach each other (R. Tarjan's strongly connected components), alone ones left out."""
    order: dict[str, int] = {}
    lowest: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(name: str) -> None:
        order[name] = lowest[name] = len(order)
        stack.append(name)
        for other in sorted(graph[name]):
            if other not in order:
                visit(other)
            if other in stack:
                lowest[name] = min(lowest[name], lowest[other])
        if lowest[name] == order[name]:
            circle = stack[stack.index(name) :]
            del stack[stack.index(name) :]
            if len(circle) > 1:
                found.append(sorted(circle))

    for name in sorted(graph):
        if name not in order:
            visit(name)
    return found


def test_a_circle_is_found() -> None:
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b", "d"}, "d": set()}) == [["b", "c"]]


def test_modules_do_not_import_each_other_in_circles() -> None:
    """For types and within functions included: who reads one of a circle has to read all of it."""
    inside = {name: found & graph().keys() - {name} for name, found in graph().items()}
    found = [circle for circle in circles(inside) if not all(name.startswith(CIRCLES) for name in circle)]
    assert not found, "\n" + "\n".join(" <-> ".join(circle) for circle in found)


def test_every_unit_of_zmav_has_a_layer() -> None:
    units = {unit_of(name) for name, _ in modules() if name.split(".")[0] == "zmav"}
    assert units <= set(RANK), f"give these a place in LAYERS: {sorted(units - set(RANK))}"


@pytest.mark.parametrize(
    ("importer", "statement", "allowed"),
    [
        ("zmav.cli.ls", "from zmav.vehicle import Vehicle", True),
        ("zmav.cli.ls", "from zmav import open", True),
        ("zmav.links.udp", "from ..errors import BadUrl", True),
        ("zmav.links.udp", "from .base import Link", True),
        ("zmav.links.udp", "from zmav import mavlink", False),
        ("zmav.mavlink.rates", "def f():\n    import zmav.links.udp", False),
        ("zmav.keys", "from zmav import wire", True),
        ("zmav.wire", "from zmav import keys", False),
        ("zmav.services.orders.command", "from zmav import open", False),
        ("zmav", "from .vehicle import Vehicle", True),
        ("zmav.services.orders.command", "import zmav.adapter", False),
        ("zmav.adapter", "import agents.vehicle", False),
        ("agents.planner.plan", "from .path import straight", True),
        ("agents.planner.plan", "from agents.follower import aim", False),
        ("agents.planner.plan", "from ground import gateway", False),
        ("agents.planner.plan", "from mesh.routers import Router", True),
        ("ground.gateway", "from agents.planner import plan", False),
        ("mesh.routers", "import ground", False),
        ("deploy.check", "import ground.gateway, agents.vehicle.cli", True),
    ],
)
def test_the_arrows_themselves(importer: str, statement: str, allowed: bool) -> None:
    found = list(imports(importer, Path("x.py" if "." in importer else "__init__.py"), statement))
    assert found
    assert all(objection(importer, each) is None for each in found) is allowed


def test_no_file_is_over_500_lines() -> None:
    lengths = {
        path.relative_to(ROOT): len(path.read_text(encoding="utf-8").splitlines())
        for path in files()
        if path.suffix in (".py", ".sh")
    }
    assert lengths
    assert not {str(path): lines for path, lines in lengths.items() if lines > MAX_LINES}


# Hosts of package registries by the words in their names, and the options that point a client at one.
REGISTRY = re.compile(
    r"https?://[^\s/\"']*(?:pypi|pythonhosted|conda|npmjs|crates|maven|proxy\.golang|rubygems)"
    r"|\b(?:pypi|pythonhosted|npmjs|crates|anaconda)\.(?:org|io|com)\b"
    r"|--(?:(?:extra-)?index-url|(?:find-link|trusted-host)s?\b)",
    re.IGNORECASE,
)


def test_no_file_names_a_registry() -> None:
    named = [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()}"
        for path in files()
        if b"\0" not in path.read_bytes()
        for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), 1)
        if REGISTRY.search(line)
    ]
    assert not named, "\n" + "\n".join(named)


def test_a_registry_would_be_found() -> None:
    words = ("py", "pi")
    assert REGISTRY.search("https://" + "".join(words) + ".example/simple")
    assert REGISTRY.search("--index" + "-url=elsewhere")
    assert not REGISTRY.search("https://mavlink.io/en/services/command.html")


@pytest.fixture(scope="module")
def project() -> dict[str, Any]:
    """The table [project] of pyproject.toml."""
    with (ROOT / "pyproject.toml").open("rb") as file:
        table: dict[str, Any] = tomllib.load(file)["project"]
    return table


def lock_blocks() -> list[str]:
    """Each package of the lock with its hashes, without comments."""
    lines = (ROOT / "requirements.lock").read_text(encoding="utf-8").splitlines()
    return re.split(r"\n(?=\S)", "\n".join(line for line in lines if not line.lstrip().startswith("#")).strip())


def test_the_lock_has_hashes_of_everything_and_of_what_builds_us() -> None:
    """pip refuses all of it for one without; what builds us is the same as pyproject.toml asks for."""
    for block in lock_blocks():
        assert re.search(r"--hash=sha256:[0-9a-f]{64}", block), block
    with (ROOT / "pyproject.toml").open("rb") as file:
        whole = tomllib.load(file)
    assert set(whole["build-system"]["requires"]) <= set(whole["project"]["optional-dependencies"]["build"])


@pytest.mark.parametrize(
    "extras", [(), ("planner",), ("ground", "vision"), ("interpreted",), ("build", "dev"), ("--only", "build")]
)
def test_what_extras_need_is_picked_from_the_lock(extras: tuple[str, ...]) -> None:
    """All that installed packages say they require is among it, so that pip's --require-hashes lacks none."""
    done = subprocess.run(
        [sys.executable, ROOT / "deploy" / "needed.py", *extras], capture_output=True, text=True, check=True
    )
    names = {
        canonicalize_name(Requirement(line.split("\\")[0]).name)
        for line in done.stdout.splitlines()
        if re.match(r"[a-z0-9]", line)
    }
    assert ("numpy" in names) == ("--only" not in extras) and ("hatchling" in names) == ("build" in extras)
    assert ("ompl" in names) == bool({"planner", "interpreted", "dev"} & set(extras))
    assert ("numba" in names) == bool({"planner", "dev"} & set(extras))
    for name in names:
        try:
            required = importlib.metadata.requires(name) or []
        except importlib.metadata.PackageNotFoundError:
            continue
        for requirement in map(Requirement, required):
            if requirement.marker is None or requirement.marker.evaluate({"extra": ""}):
                assert canonicalize_name(requirement.name) in names, f"{name} needs {requirement}"


def test_an_extra_that_there_is_not_is_told() -> None:
    done = subprocess.run([sys.executable, ROOT / "deploy" / "needed.py", "nonsense"], capture_output=True, text=True)
    assert done.returncode == 1 and "no extra nonsense; there are planner, vision" in done.stderr


def test_the_lock_pins_every_dependency(project: dict[str, Any]) -> None:
    pins = [Requirement(block.split("\\")[0]) for block in lock_blocks()]
    loose = [str(pin) for pin in pins if pin.url or [each.operator for each in pin.specifier] != ["=="]]
    assert not loose, "the lock holds exact versions and nothing else"
    here = {canonicalize_name(pin.name): pin for pin in pins if not pin.marker or pin.marker.evaluate()}

    groups = [project["dependencies"], *project["optional-dependencies"].values()]
    wanted = [Requirement(text) for group in groups for text in group]
    for requirement in wanted:
        if requirement.name == project["name"] or (requirement.marker and not requirement.marker.evaluate()):
            continue
        pin = here.get(canonicalize_name(requirement.name))
        assert pin, f"{requirement} is not in requirements.lock: renew it with make lock"
        version = next(iter(pin.specifier)).version
        assert requirement.specifier.contains(version), f"{requirement} but {pin}: renew the lock with make lock"


def entry_points(project: dict[str, Any]) -> set[tuple[str, str, str]]:
    """What pyproject.toml declares, as (group, name, value)."""
    groups = {"console_scripts": project["scripts"], **project["entry-points"]}
    return {(group, name, value) for group, names in groups.items() for name, value in names.items()}


def test_entry_points_resolve(project: dict[str, Any]) -> None:
    for group, name, value in sorted(entry_points(project)):
        assert callable(importlib.metadata.EntryPoint(name, value, group).load()), f"{group}: {name} = {value}"


EXTRAS = ("cv2", "mcap", "numba", "ompl", "rerun", "scipy", "shapely", "starlette", "uvicorn", "websockets")


def test_the_verbs_load_without_any_extra(project: dict[str, Any]) -> None:
    """``zmav --help`` names them all, and must do so (and quickly) in the core installation."""
    verbs = project["entry-points"]["zmav.verbs"].values()
    code = (
        "import sys, importlib.metadata as m\n"
        f"sys.modules.update(dict.fromkeys({EXTRAS!r}))\n"  # None: importing it fails
        f"for value in {sorted(verbs)!r}: m.EntryPoint('verb', value, 'zmav.verbs').load()"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_what_is_installed_is_this_tree(project: dict[str, Any]) -> None:
    try:
        installed = importlib.metadata.distribution(project["name"])
    except importlib.metadata.PackageNotFoundError:
        pytest.skip("zmav is not installed in this environment")
    assert installed.version == project["version"]
    assert {(each.group, each.name, each.value) for each in installed.entry_points} == entry_points(project)
    spec = importlib.util.find_spec("zmav")
    assert spec and {Path(each) for each in spec.submodule_search_locations or ()} == {ROOT / "zmav"}


@pytest.mark.parametrize("package", ["zmav", "agents", "mesh", "ground", "tests"])
def test_the_packages_are_regular_ones(package: str) -> None:
    """A folder without ``__init__.py`` gives way to any other package of its (common) name that is installed."""
    assert (ROOT / package / "__init__.py").is_file()


def test_every_benchmark_is_run_by_make() -> None:
    """Scripts are found; a package is run by what the Makefile says."""
    packages = [path.parent.name for path in (ROOT / "tests" / "bench").glob("*/__main__.py")]
    assert packages
    assert [name for name in packages if f'"-m tests.bench.{name}' not in (ROOT / "Makefile").read_text()] == []


# What tests reach of others' private names, and what of ours they patch; neither may grow. Tests assert behaviour: a
# constant that a test needs otherwise is a setting, and what a test must see is public.
MOST_REACHES, MOST_PATCHES = 42, 74
PATCH = re.compile(r"\.setattr$|\bpatch(\.object|\.multiple)?$")


def of_whom(node: ast.expr) -> str:
    """The name that an expression begins with: ``vehicle`` of ``vehicle.rates.demands``."""
    while isinstance(node, ast.Attribute | ast.Subscript | ast.Call):
        node = node.func if isinstance(node, ast.Call) else node.value
    return node.id if isinstance(node, ast.Name) else ""


def may_patch(function: ast.expr) -> bool:
    """By its last name alone, which costs less than to write out the whole."""
    last = (
        function.attr if isinstance(function, ast.Attribute) else function.id if isinstance(function, ast.Name) else ""
    )
    return last in ("setattr", "patch", "object", "multiple")


def inside(source: str | bytes) -> tuple[list[str], list[str]]:
    """The private names of other objects that a test reaches, and what of ours it patches."""
    nodes = list(ast.walk(ast.parse(source)))
    own = {each.name for each in nodes if isinstance(each, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)}
    theirs, found, patched = set[str](), list[str](), list[str]()
    for node in nodes:
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store) and of_whom(node) == "self":
            own.add(node.attr)
        elif isinstance(node, ast.Import | ast.ImportFrom):
            module = node.module or "" if isinstance(node, ast.ImportFrom) else node.names[0].name
            if module.partition(".")[0] not in BELOW:
                theirs |= {(each.asname or each.name).partition(".")[0] for each in node.names}
            elif isinstance(node, ast.ImportFrom):
                found += [each.name for each in node.names if each.name.startswith("_")]
    for node in nodes:
        if isinstance(node, ast.Attribute) and re.match("_(?!_|replace$)", node.attr):
            found += [node.attr] if node.attr not in own and of_whom(node) not in theirs else []
        elif isinstance(node, ast.Call) and node.args and may_patch(node.func) and PATCH.search(ast.unparse(node.func)):
            target = node.args[0]
            text = target.value if isinstance(target, ast.Constant) else None
            ours = text.partition(".")[0] in BELOW if isinstance(text, str) else of_whom(target) not in theirs
            patched += [ast.unparse(target)] if ours else []
    return found, patched


def test_a_reach_and_a_patch_are_found() -> None:
    reach = "from zmav import _a\nimport os\nb._c.d\nos._exit\nclass T:\n def _e(self): self._e()"
    assert inside(reach) == (["_a", "_c"], [])
    patch = "import time\nm.setattr(v.rates, 'X', 1)\npatch('zmav.a')\nm.setattr(time, 'x', 1)\nm.setattr('os.x', 1)"
    assert inside(patch) == ([], ["v.rates", "'zmav.a'"])


def test_tests_reach_no_further_into_what_is_private() -> None:
    tests = [path for path in (ROOT / "tests").rglob("*.py") if path.relative_to(ROOT).parts[1] != "bench"]
    each = [inside(path.read_bytes()) for path in tests]
    assert sum(len(found) for found, _ in each) <= MOST_REACHES
    assert sum(len(patched) for _, patched in each) <= MOST_PATCHES
