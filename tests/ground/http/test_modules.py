"""The page's own modules: who imports whom, their types, and that every text of theirs stands in one file."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from ground.http import page
from tests.ground.http.browser import Fleet, Tab, pieces
from zmav import wire

if TYPE_CHECKING:
    from tests.ground.http.conftest import Serve

ROOT = Path(__file__).resolve().parents[3]
STATIC = ROOT / "ground/http/static"
SOURCES = {path.name: path.read_text("utf-8") for path in sorted(STATIC.glob("*.js"))}
ENTRIES = ("main.js", "docs.js")
SPOKEN = "texts.js"
BELOW_STORE = {"dom.js", "geo.js", "settings.js", "texts.js", "types.js", "vehicle.js", "vendor.js", "words.js"}
"""what the store may use: no view, and not what brings it its messages"""
NAMES = {"Delete", "Enter", "Escape", "Home", "End", "Tab", "Polygon", "Plan", "Hz"}
"""of keys, units and formats: no texts"""
EVENTS = {"move", "zoom", "zoomend", "resize"}


def imports(name: str) -> set[str]:
    return set(re.findall(r'^import .*? from "\./([a-z]+\.js)";$', SOURCES[name], re.M))


TOKEN = re.compile(
    r"""//[^\n]*|/\*.*?\*/|"((?:[^"\\\n]|\\.)*)"|'((?:[^'\\\n]|\\.)*)'|`|[{}]|(?<=[(,=:]\s)/(?:[^/\\\n]|\\.)+/""", re.S
)
PART = re.compile(r"(?:[^`\\$]|\\.|\$(?!\{))*", re.S)


def literals(source: str) -> Iterator[str]:
    """The strings of a script, and the parts of its templates; comments are none of them."""
    braces: list[str] = []  # "{": of code, "`": within a template's ${}
    at = 0
    while found := TOKEN.search(source, at):
        at = found.end()
        if found[1] is not None or found[2] is not None:
            yield found[1] or found[2] or ""
        elif found[0] == "{":
            braces.append("{")
        elif found[0] == "`" or (found[0] == "}" and braces and braces.pop() == "`"):
            part = PART.match(source, at)
            assert part is not None
            yield part[0]
            at = part.end() + (1 if source[part.end()] == "`" else 2)
            if source[part.end()] == "$":
                braces.append("`")


def english(text: str, classes: set[str]) -> bool:
    """It looks like words for a person: capitalised, or several that are no classes of the style sheets."""
    if re.search(r"^\./|^Arrow|^Content-Type$|^zmav ", text):  # a module, a key, a header, a command
        return False
    if set(re.findall(r"\b[A-Z][a-z]+\b(?![A-Z(])", text)) - NAMES:
        return True
    words = re.findall(r"[a-z]{2,}(?: [a-z-]{2,})+", text)
    return any(set(each.split()) - classes for each in words) and not re.search(r"[#\[\]>]", text)


# Modules.


def test_modules_are_imported_one_way() -> None:
    """Socket, store, views: a view is imported by the page alone or by another view, never by what it reads from."""
    seen: dict[str, int] = {}

    def depth(name: str, above: tuple[str, ...] = ()) -> int:
        assert name not in above, f"in a circle: {[*above, name]}"
        if name not in seen:
            seen[name] = 1 + max((depth(each, (*above, name)) for each in imports(name)), default=0)
        return seen[name]

    for entry in ENTRIES:
        depth(entry)
    assert set(seen) == set(SOURCES) - {"types.js"}, "a module that no page uses"
    below = set(imports("store.js"))
    for _ in SOURCES:
        below |= {each for name in below for each in imports(name)}
    assert below <= BELOW_STORE
    assert "store.js" not in imports("link.js")


def test_the_types_hold() -> None:
    tsc = shutil.which("tsc") or shutil.which("tsc", path=str(ROOT / "node_modules/.bin"))
    if tsc is None:
        pytest.skip("no TypeScript is installed (npm install typescript)")
    command = [tsc, "-p", str(STATIC / "tsconfig.json")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout


def test_the_page_reads_what_a_state_has() -> None:
    text = SOURCES["types.js"]
    block = text[text.index("{object} State") : text.index("{object} What")]
    read = set(re.findall(r"@property \{.*?\} \[(\w+)\]", block))
    assert len(read) > 10
    assert read <= set(wire.VehicleState.__struct_fields__)


# Texts.

SAME = re.compile(r"zmav|\bHz\b|openapi\.json|\*?[\w*]*(/[\w*]+)+")
"""names and figures that stand in the same letters everywhere"""


def test_every_text_stands_in_one_file() -> None:
    sheets = "".join(path.read_text("utf-8") for path in STATIC.glob("*.css"))
    classes = set(re.findall(r"\.([a-z][a-z-]*)", sheets)) | EVENTS | {"small", "plain"}
    found = {
        f"{name}: {text!r}"
        for name, source in SOURCES.items()
        if name != SPOKEN
        for text in literals(source)
        if english(text, classes)
    }
    assert not found
    for path in STATIC.glob("*.html"):
        text = path.read_text("utf-8")
        bare = SAME.sub(" ", re.sub(r"<[^>]*>", " ", text.replace("{fleet}", "")))
        assert not re.search(r"[A-Za-z]{2,}", bare), path.name
        assert not re.search(r' (title|aria-label|alt)="', text), path.name


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("Hold", True),
        ("no vehicle yet", True),
        ("chip bad", False),
        ("ArrowDown", False),
        ("#table tbody", False),
    ],
)
def test_what_is_taken_for_a_text(text: str, wanted: bool) -> None:
    assert english(text, {"chip", "bad"}) is wanted


def test_every_text_is_used_and_there() -> None:
    there = re.findall(r'^  "([^"]+)": ', SOURCES[SPOKEN], re.M)
    assert len(there) == len(set(there)) > 100
    pages = "".join(path.read_text("utf-8") for path in STATIC.glob("*.html"))
    named = set(re.findall(r'data-(?:text|title|label|placeholder)="([^"]+)"', pages))
    used = named | {text for name, source in SOURCES.items() if name != SPOKEN for text in literals(source)}
    assert not named - set(there), "the page names texts that there are not"
    assert not set(there) - used, "texts that nothing uses"


def translated() -> Iterator[tuple[str, str]]:
    """The page's files, each text in brackets, as a translation would be."""
    for path in STATIC.rglob("*"):
        if path.suffix in page.KINDS:
            text = path.read_text("utf-8")
            if path.name == SPOKEN:
                text = re.sub(r'(^  "[^"]+": |one: |other: )"((?:[^"\\]|\\.)*)"', r'\1"⟦\2⟧"', text, flags=re.M)
                text = re.sub(r"\{ one: .*? \}", lambda found: found[0], text)
            yield path.relative_to(STATIC).as_posix(), text


SEEN = """(() => {
    const found = [];
    const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
    while (walk.nextNode()) found.push(walk.currentNode.textContent);
    for (const element of document.querySelectorAll('*'))
        for (const name of ['title', 'aria-label', 'placeholder', 'alt'])
            if (element.getAttribute(name)) found.push(element.getAttribute(name));
    return found;
})()"""
CORNERS = "[{lat: 0, lon: 0}, {lat: 0, lon: 1}, {lat: 1, lon: 0}]"
DATA = re.compile(SAME.pattern + r"|[a-z]*quad\d|demo|copter|ardupilot|GUIDED|3D|search\d|\b(m|m/s|km|s|V|ms)\b")


@pytest.mark.asyncio(loop_scope="module")
async def test_a_translation_reaches_all_that_is_seen(tab: Tab, serve: Serve, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page, "_files", translated)
    served = serve()
    fleet = Fleet(served)
    try:
        for name in ("quad1", "quad2"):
            fleet.more[name] = {"mode": "GUIDED", "local": (0.0, 0.0, -5.0)}
        await tab.open(f"http://127.0.0.1:{served.port}/")
        await pieces(tab)
        await tab.until("store.all.length === 2 && map.fitted")
        await tab.run("document.getElementById('select-all').click(); drawing.begin('search')")
        await tab.run(f"drawing.shapes.add('search', {CORNERS}); drawing.refresh()")
        await tab.run(
            "[...document.querySelectorAll('#bar button')].find((e) => e.textContent.includes('Arm')).click()"
        )
        await tab.until("document.getElementById('confirm').open && document.querySelectorAll('.card').length === 2")
        left = set()
        for each in await tab.run(SEEN):
            text = each
            while text != (text := re.sub(r"⟦[^⟦⟧]*⟧", " ", text)):
                pass
            left |= {each} if re.search(r"[A-Za-z]{2,}|[{}]", DATA.sub(" ", text)) else set()
        assert not left
        assert json.dumps(await tab.run(SEEN)).count("\\u27e6") > 80
    finally:
        fleet.close()
