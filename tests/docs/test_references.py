"""docs/keys.md and docs/cli.md are what the registry and the commands give."""

from __future__ import annotations

import re

import pytest

from docs import generate
from zmav import keys, verbs
from zmav.cli import VERBS


@pytest.mark.parametrize("name", generate.PAGES)
def test_the_page_is_what_the_code_gives(name: str) -> None:
    written = (generate.DOCS / name).read_text(encoding="utf-8")
    assert written == generate.PAGES[name](), f"docs/{name} is out of date: run 'make docs' and commit what it writes"


def test_every_channel_order_and_payload_has_its_place() -> None:
    page = generate.keys_page()
    for channel in keys.CHANNELS.values():
        assert f"`zmav/{channel.template}`" in page
        if channel.payload is not None:
            assert f"\n### {channel.payload.__name__}\n" in page
    for verb in (*verbs.VERBS.values(), *verbs.SWARM_VERBS.values()):
        assert f"| `{verb.name}` | [{verb.args.__name__}]" in page


def test_a_field_is_told_with_its_type_default_and_unit() -> None:
    assert "| `alt_rel` | `float` | `required` | m above home |" in generate.keys_page()
    assert "| `ttl` | `float` | `3.0` | seconds;" in generate.keys_page()


def test_every_verb_has_a_chapter_those_of_entry_points_too() -> None:
    chapters = re.findall(r"^## zmav (\w+)$", generate.cli_page(), re.MULTILINE)
    assert {*VERBS, "up", "swarm", "gcs"} <= set(chapters)
    assert "\n### zmav agent inject\n" in generate.cli_page()
