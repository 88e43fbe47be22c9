"""Which messages a regular expression names, at a bounded cost.

Python's expressions can take time exponential in the text, and seconds to be understood alone. There are only so many
messages, so each expression is tried on all their names once: at once where it is of a harmless form, and else in a
process that is ended in time.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import sys
from collections.abc import Iterable

from zmav.errors import BadInput
from zmav.waiting import within

LONGEST = 500
"""characters of an expression"""
PATIENCE = 3.0
"""s for the process, its start included"""
_PART = re.compile(r"\^?(?:\w|\.\*)*\$?")
_PROGRAM = """
import json, re, sys
pattern, names = json.load(sys.stdin)
try:
    print(json.dumps([name for name in names if re.search(pattern, name)]))
except (re.error, RecursionError, OverflowError) as e:
    print(json.dumps(str(e)))
"""


async def matching(pattern: str, names: Iterable[str]) -> frozenset[str]:
    """The names in which ``pattern`` is found; raises :class:`BadInput` for what is none, or takes too long."""
    if len(pattern) > LONGEST:
        text = f"the filter has {len(pattern)} characters, and may have {LONGEST}"
        raise BadInput(text, field="filter", value=pattern[:80], expected=f"at most {LONGEST} characters")
    if _is_harmless(pattern):
        compiled = re.compile(pattern)
        return frozenset(name for name in names if compiled.search(name))
    return await _elsewhere(pattern, list(names))


def _is_harmless(pattern: str) -> bool:
    """Names with at most two ``.*`` each, and alternatives of these: nothing to go back and forth over."""
    return all(_PART.fullmatch(part) and part.count(".*") <= 2 for part in pattern.split("|"))


async def _elsewhere(pattern: str, names: list[str]) -> frozenset[str]:
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-I", "-S", "-W", "ignore", "-c", _PROGRAM, stdin=pipe, stdout=pipe
    )
    try:
        said, _ = await within(PATIENCE, process.communicate(json.dumps([pattern, names]).encode()))
        found = json.loads(said)
    except (asyncio.TimeoutError, ValueError):
        text = f"the filter takes longer than {PATIENCE:g} s: repeat less within what is repeated"
        raise BadInput(text, field="filter", value=pattern[:80], expected="a simpler regular expression") from None
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        await process.wait()
    if isinstance(found, str):
        text = f"the filter is no regular expression: {found}"
        raise BadInput(text, field="filter", value=pattern[:80], expected="a regular expression")
    return frozenset(found)
