#!/usr/bin/env python3
"""Compares the alignment of rendered brackets, and what `align` states about it, with the known motion.

    tests/measure_alignment.py BINARY FOLDER... [--cases GLOB] [--json FILE] [--list]

Each subfolder of FOLDER with a truth.json is a bracket: {"kind": ..., "width": ..., "height": ..., "frames": [{"file":
..., "is_reference": ..., "homography": 3 x 3, reference pixel -> frame pixel}]}. If the motion is not one homography,
flow_NN.npy has for img_NN.jpg the displacement (dx, dy) of each reference pixel and seen_NN.png which pixels the frame
sees; mover_NN.png of the reference frame are pixels of a moving thing, which are left out for the kind `walker`. A
FOLDER may also be a file that --json wrote. --list prints each frame, --json writes them. Needs Python 3, NumPy and
OpenCV (pip install numpy opencv-python-headless).

Printed for each kind and for all: frames; wrong frames that are not doubted (silent: more than 3 % of the unclipped
pixels that both see are displaced by more than 2 px, and the confidence is 0.5 or more); how many of the right frames
are doubted (confidence below 0.5; rejected frames are neither right nor silent); planar frames: share with a mean error
below 1 px, median and 90th percentile; other frames: how much less of the picture is within 1 px than with the best
homography, in points (median, 75th percentile, largest); exactly unmoved frames of those that did not move; stated
`error_px` over the true root mean square (5th percentile, median, 95th); shares of right frames in three ranges of the
confidence."""
import argparse, json, pathlib, subprocess, sys, tempfile
from fnmatch import fnmatch
import cv2
import numpy as np

cv2.setNumThreads(1)

def displacement(h, size):
    """What homography h does to each pixel centre, minus the pixel."""
    y, x = np.mgrid[:size[1], :size[0]].astype(np.float32)
    q = np.tensordot(np.stack([x, y, np.ones_like(x)], -1), np.array(h, float).reshape(3, 3), (2, 1))
    return q[..., :2] / q[..., 2:] - np.stack([x, y], -1)

def unclipped(image):
    return (image.max(-1) >= 5) & (image.max(-1) <= 250)

def measured(case, truth, frame, reference, got):
    """The row of one frame."""
    size, number = (truth["width"], truth["height"]), frame["file"][4:6]
    best = displacement(frame["homography"], size)
    flow, seen = case / f"flow_{number}.npy", case / f"seen_{number}.png"
    planar = not flow.exists()
    true = best if planar else np.load(flow)
    y, x = np.mgrid[:size[1], :size[0]].astype(np.float32)
    there = np.stack([x, y], -1) + true
    inside = (there >= 0).all(-1) & (there[..., 0] <= size[0] - 1) & (there[..., 1] <= size[1] - 1)
    visible = inside if planar else cv2.imread(str(seen), 0) > 127
    if truth["kind"] == "walker":
        visible &= cv2.imread(str(case / f"mover_{reference['file'][4:6]}.png"), 0) < 128
    image = cv2.imread(str(case / frame["file"]))
    fetched = cv2.remap(image, *there.astype(np.float32).transpose(2, 0, 1), cv2.INTER_LINEAR)
    checked = visible & unclipped(cv2.imread(str(case / reference["file"]))) & unclipped(fetched)
    row = dict(case=case.name, kind=truth["kind"], file=frame["file"], planar=planar, status=got["status"],
               confidence=got.get("confidence") or 0.0, stated=got.get("error_px"), static=bool(not true.any()))
    h = got.get("homography")
    doubted = got["status"] == "rejected" or row["confidence"] < 0.5
    row["doubted"] = doubted
    if h is None:
        return dict(row, error=np.inf, rms=np.inf, right=False, silent=False, less=None)
    own = displacement(h, size)
    off = np.hypot(*np.moveaxis(own - true, -1, 0))
    right = not checked.any() or np.mean(off[checked] > 2) <= 0.03
    within = lambda e: 100 * np.mean(e[visible] < 1)
    less = None if planar else within(np.hypot(*np.moveaxis(best - true, -1, 0))) - within(off)
    return dict(row, error=float(off[visible].mean()), rms=float(np.sqrt((off[visible] ** 2).mean())), right=bool(right),
                silent=bool(not right and not doubted), less=None if less is None else float(less),
                wrong=float(100 * np.mean(off[checked] > 2)) if checked.any() else 0.0)

def run(binary, case, truth):
    reference = next(f for f in truth["frames"] if f["is_reference"])
    with tempfile.TemporaryDirectory() as folder:
        report = pathlib.Path(folder) / "report.json"
        names = [str(case / f["file"]) for f in truth["frames"]]
        subprocess.run([binary, "align", "--crop", "none", "--threads", "1", "--report", report,
                        "--reference", case / reference["file"], *names], capture_output=True)
        if not report.exists():
            print("no report:", case, file=sys.stderr)
            return []
        frames = json.loads(report.read_text())["frames"]
    got = {pathlib.Path(f["path"]).name: f["alignment"] for f in frames}
    return [measured(case, truth, f, reference, got[f["file"]]) for f in truth["frames"] if not f["is_reference"]]

def percentiles(values, at, form):
    return " ".join(format(v, form) for v in np.percentile(values, at)) if len(values) else "-"

def line(name, rows):
    right = [r for r in rows if r["right"]]
    text = f"{name:12s}{len(rows):5d} silent {sum(r['silent'] for r in rows):2d} doubted {sum(r['doubted'] for r in right):3d} of {len(right):4d}"
    planar = [min(r["error"], 999) for r in rows if r["planar"]]
    if planar:
        text += f" | under 1 px {100 * np.mean(np.array(planar) < 1):5.1f} % {percentiles(planar, [50, 90], '.3f')}"
    static = [r for r in rows if r["static"]]
    if static:
        text += f" | still {sum(r['status'] == 'unmoved' and r['error'] == 0 for r in static)} of {len(static)}"
    local = [r["less"] for r in rows if r["less"] is not None]
    if local:
        text += f" | less {percentiles(local, [50, 75, 100], '.2f')}"
    ratio = [r["stated"] / r["rms"] for r in rows if r["stated"] is not None and r["rms"] > 1e-9 and r["status"] != "rejected"]
    text += f" | ratio {percentiles(ratio, [5, 50, 95], '.2f')} |"
    for low, high in [(0.5, 0.7), (0.7, 0.9), (0.9, 1.01)]:
        some = [r["right"] for r in rows if r["status"] != "rejected" and low <= r["confidence"] < high]
        text += f" {sum(some)}/{len(some)}"
    return text

def main():
    a = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    a.add_argument("binary"), a.add_argument("folders", nargs="+", type=pathlib.Path)
    a.add_argument("--cases", default="*"), a.add_argument("--json"), a.add_argument("--list", action="store_true")
    o = a.parse_args()
    rows = []
    for folder in o.folders:
        if folder.is_file():            # what --json wrote
            rows += json.loads(folder.read_text())
            continue
        for case in sorted(p.parent for p in folder.glob("*/truth.json")):
            if fnmatch(case.name, o.cases):
                rows += [dict(r, folder=folder.name) for r in run(o.binary, case, json.loads((case / "truth.json").read_text()))]
    if not rows:
        sys.exit("no brackets")
    if o.json:
        pathlib.Path(o.json).write_text(json.dumps(rows))
    if o.list:
        for r in rows:
            ratio = r["stated"] / r["rms"] if r["stated"] is not None and r["rms"] > 1e-9 else float("nan")
            print(f"{r['folder']:10s} {r['case']:16s}{r['file']} {r['status']:9s} {r['confidence']:.2f} error {r['error']:8.3f} rms {r['rms']:8.3f} stated {r['stated'] if r['stated'] is not None else float('nan'):8.3f} ratio {ratio:7.2f} {'less %.2f' % r['less'] if r['less'] is not None else ''} {'SILENT' if r['silent'] else ''}")
    for kind in sorted({r["kind"] for r in rows}):
        print(line(kind, [r for r in rows if r["kind"] == kind]))
    print(line("ALL", rows))

if __name__ == "__main__":
    main()
