"""OpenCV and BLAS without threads of their own: what is looked at in a picture is many small products, whose threads
would wait for each other longer than they work. Beside other programs a detection takes ten times as long with them.
"""

from __future__ import annotations

import ctypes
from pathlib import Path

from zmav.vision.opencv import opencv

MAPS = Path("/proc/self/maps")
SETTERS = (
    "scipy_openblas_set_num_threads64_",
    "scipy_openblas_set_num_threads",
    "openblas_set_num_threads64_",
    "openblas_set_num_threads",
)
"""of OpenBLAS as NumPy's and OpenCV's wheels have it"""


def one_thread() -> None:
    """From now on, for this whole process, in so far as OpenCV, NumPy and SciPy are imported. Where there is no
    /proc/self/maps, BLAS has what OPENBLAS_NUM_THREADS said as it was imported. Raises BadConfig without OpenCV.
    """
    opencv().setNumThreads(1)
    lines = MAPS.read_text().splitlines() if MAPS.exists() else []
    for path in {line.split(maxsplit=5)[-1] for line in lines if "openblas" in line}:
        library = ctypes.CDLL(path)
        for name in SETTERS:
            if hasattr(library, name):
                getattr(library, name)(1)
