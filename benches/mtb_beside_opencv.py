#!/usr/bin/env python3
"""Compare the bitmap search with OpenCV's AlignMTB on the same planes of 12 MP and 1024 x 768, with one thread each.

    benches/mtb_beside_opencv.py        (needs numpy and opencv-python, with its photo module)

The planes are those of the group "mtb" of benches/stages.rs: frames 3 and 4 of testdata/window, mirrored. OpenCV only finds shifts."""
import os, re, subprocess, time
from pathlib import Path
import cv2
import numpy as np

root = Path(__file__).resolve().parent.parent
cv2.setNumThreads(1)


def plane(number, width, height, left):
    grey = cv2.imread(str(root / f"testdata/window/window_{number}.jpg"), cv2.IMREAD_GRAYSCALE)
    fold = lambda i, n: np.where(i // n % 2 == 0, i % n, n - 1 - i % n)
    return np.ascontiguousarray(grey[fold(np.arange(height), grey.shape[0])][:, fold(np.arange(width) + left, grey.shape[1])])


def opencv(size):
    a, b = plane(3, *size, 0), plane(4, *size, 23)
    times = []
    for _ in range(11):
        start = time.perf_counter()
        cv2.createAlignMTB(6).calculateShift(a, b)
        times.append(time.perf_counter() - start)
    return 1e3 * sorted(times)[len(times) // 2]


bench = ["cargo", "bench", "--bench", "stages", "--", "mtb/shift"]
ours = subprocess.run(bench, cwd=root, env={**os.environ, "RAYON_NUM_THREADS": "1"}, capture_output=True, text=True, check=True).stdout
for name, size in [("12 MP", (4096, 3072)), ("1024x768", (1024, 768))]:
    print(f"cv2.AlignMTB shift {name}: {opencv(size):.1f} ms")
for name, middle in re.findall(r"^mtb/(.*?)\s+time:\s+\[\S+ \S+ (\S+ \S+)", ours, re.M):
    print(f"hdralign {name}: {middle}")
