"""Pictures that matplotlib drew, as files."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

from zmav.errors import BadInput

if TYPE_CHECKING:  # an extra, which anyone who has drawn a figure has
    from matplotlib.figure import Figure


def save(figure: Figure, path: Path) -> None:
    """Write it as what the file's name says (PNG where it says nothing), whole or not at all.

    Raises :class:`BadInput` for a kind of file that there is not, and for a file that cannot be written.
    """
    data = io.BytesIO()
    try:
        figure.savefig(data, format=path.suffix.lstrip(".").lower() or "png")
        path.write_bytes(data.getvalue())
    except ValueError as e:
        raise BadInput(f"cannot draw {path}: {e}", field="picture", value=str(path), expected="png, svg or pdf") from e
    except OSError as e:
        raise BadInput(f"cannot write {path}: {e.strerror}", field="picture", value=str(path)) from e
