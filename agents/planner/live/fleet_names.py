"""Names of vehicles as people write them."""

from __future__ import annotations

import fnmatch


def match_names(patterns: list[str], names: list[str]) -> list[str]:
    """The names that the patterns mean (``quad*``, ``all``), in the patterns' order, each once; a name that is no
    pattern as it is, known or not.
    """
    found: list[str] = []
    for pattern in patterns:
        if pattern == "all" and "all" not in names:
            pattern = "*"
        found += [pattern] if not set("*?[") & set(pattern) else sorted(fnmatch.filter(names, pattern))
    return list(dict.fromkeys(found))
