"""OpenCV and BLAS without threads of their own."""

from __future__ import annotations

import os
import subprocess
import sys

COUNTED = """
import time
import cv2, numpy as np
from zmav.vision.threads import one_thread
one_thread()
a = np.ones((900, 900), dtype=np.float32)
idle = False
while not idle:  # OpenBLAS's threads look for work in a loop for a while after they were made
    spent = time.process_time()
    time.sleep(0.05)
    idle = time.process_time() - spent < 0.005
cpu, wall = time.process_time(), time.thread_time()
for _ in range(10):
    a @ a
cv2.filter2D(np.ones((2000, 2000), dtype=np.float32), -1, a[:9, :9])
print(time.process_time() - cpu, time.thread_time() - wall, cv2.getNumThreads())
"""


def test_all_is_done_in_the_thread_that_asks() -> None:
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("OPENBLAS", "OMP"))}
    ran = subprocess.run([sys.executable, "-c", COUNTED], env=environment, capture_output=True, text=True, check=True)
    process, thread, threads = map(float, ran.stdout.split())
    assert threads == 1
    assert process < 1.2 * thread + 0.02
