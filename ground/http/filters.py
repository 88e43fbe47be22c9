"""Which messages a regular expression names, at a bounded cost.

Python's expressions can take time exponential in the text. Names, ``.``, ``.*``, sets of characters and alternatives
suffice to name messages, and cannot.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from zmav.errors import BadInput

LONGEST, MOST_STARS, MOST_GROUPS = 500, 2, 2
"""characters of an expression; ``.*`` in each of its alternatives; groups in it"""
FORM = "names, '.', '.*', [A-Z], (A|B), ^, $ and |"
_ALTERNATIVE = r"\^?(?:\.\*|[\w.]|\[[\w-]+\]|\((?:\w+\|)*\w+\))*\$?"
_PATTERN = re.compile(rf"{_ALTERNATIVE}(?:\|{_ALTERNATIVE})*", re.ASCII)
_OUTSIDE_GROUPS = re.compile(r"\|(?![\w|]*\))")


def matching(pattern: str, names: Iterable[str]) -> frozenset[str]:
    """The names in which ``pattern`` is found; raises :class:`BadInput` for one that is not of that form."""
    stars = max(part.count(".*") for part in _OUTSIDE_GROUPS.split(pattern[:LONGEST]))
    if len(pattern) > LONGEST or stars > MOST_STARS or pattern.count("(") > MOST_GROUPS:
        most = f"{LONGEST} characters, {MOST_STARS} times '.*' in each alternative and {MOST_GROUPS} groups"
        raise BadInput(f"the filter has more than {most}", field="filter", value=pattern[:80], expected=most)
    try:
        if not _PATTERN.fullmatch(pattern):
            raise ValueError(pattern)
        compiled = re.compile(pattern)
    except (ValueError, re.error):
        text = f"the filter {pattern[:80]!r} is not understood: it may be made of {FORM}"
        raise BadInput(text, field="filter", value=pattern[:80], expected=FORM) from None
    return frozenset(name for name in names if compiled.search(name))
