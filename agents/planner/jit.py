"""Numba's compiler, with types that a checker can follow: what is compiled is kept beside the source file."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])


def jit(function: F) -> F:
    """Compile for the types it is called with, once on this machine; no Python objects inside.

    Fast but exact where it matters: no reordering of sums, NaN compares as always.
    """
    return cast(F, numba.njit(cache=True, error_model="numpy", nogil=True)(function))
