"""``python -m zmav``: the same as ``zmav``."""

from __future__ import annotations

from zmav.cli import main

if __name__ == "__main__":
    main()
