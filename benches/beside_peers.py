#!/usr/bin/env python3
"""Measure wall time, CPU time and peak memory of whole runs of hdralign and other programs.

    benches/beside_peers.py [IMAGES...]             compare with the installed programs
    benches/beside_peers.py --scaling [IMAGES...]   compare frames, megapixels, threads and memory with their goals

IMAGES are photographs of one bracket with EXIF data, by rising exposure; the default is testdata/window. The programs run alternately
(A B C A B C ...), so that other load affects all of them; figures are medians, after one round to warm up. Both tables are Markdown.

Programs that are not installed are skipped with a message:
  OpenCV        AlignMTB, CalibrateDebevec, MergeDebevec, Reinhard to .hdr and .png (python3 with cv2; only shifts); the exposure times
                are given, other programs have to read them
  luminance-hdr luminance-hdr-cli with MTB to .exr and .png (only shifts)
  Hugin         align_image_stack and enfuse (a fused picture, no radiance)

--scaling makes brackets from three of IMAGES (needs Pillow and numpy): scaled to 3, 12 and 48 MP, with a little noise because scaling
removes it, and at 12 MP copied under other names to 6, 9 and 12 frames, with EXIF data. Growth is the cost of an additional frame
(megapixel) in the second half of the range, divided by that in the first half: 1 if the time is linear, whatever the constant part.

Needs a release build (cargo build --release), or --program. Peak memory is the largest resident set, in 2^20 bytes."""
import argparse
import importlib.util
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
EXPOSURE_TIME, EXIF_IFD = 33434, 0x8769
# Unit of the resident memory reported by wait4, in bytes.
RESIDENT_UNIT = 1 if sys.platform == "darwin" else 1024

OPENCV = """
import sys
import cv2
import numpy as np
folder, times, files = sys.argv[1], np.float32(sys.argv[2].split(",")), sys.argv[3:]
images = [cv2.imread(f) for f in files]
cv2.createAlignMTB(6).process(images, images)
radiance = cv2.createMergeDebevec().process(images, times, cv2.createCalibrateDebevec().process(images, times))
cv2.imwrite(folder + "/o.hdr", radiance)
picture = cv2.createTonemapReinhard(1.5).process(radiance)
cv2.imwrite(folder + "/o.png", np.clip(picture * 255, 0, 255).astype(np.uint8))
"""


@dataclass
class Figures:
    """Figures of one run, or medians of several: seconds, seconds, megabytes (of 2^20 bytes)."""

    wall: float
    cpu: float
    peak: float


@dataclass
class Job:
    """A job to measure: its name, and its commands in order; `{out}` in them stands for its own folder."""

    name: str
    commands: list


def run(job):
    """Run `job` once; return its figures, or the reason of the failure."""
    figures = Figures(0.0, 0.0, 0.0)
    with tempfile.TemporaryDirectory(dir=SCRATCH) as out:
        for command in job.commands:
            argv = [part.replace("{out}", out) for part in command]
            # The files of the previous command, by name, as `align_image_stack` numbers them itself.
            argv = [p for part in argv for p in (sorted(map(str, Path(out).glob(part[2:]))) if part.startswith("*:") else [part])]
            with open(os.path.join(out, "stderr"), "w+") as stderr:
                start = time.perf_counter()
                process = subprocess.Popen(argv, stdout=subprocess.DEVNULL, stderr=stderr, env={**os.environ, "QT_QPA_PLATFORM": "offscreen"})
                _, status, usage = os.wait4(process.pid, 0)
                figures.wall += time.perf_counter() - start
                process.returncode = os.waitstatus_to_exitcode(status)
                if process.returncode != 0:
                    stderr.seek(0)
                    said = (stderr.read().strip().splitlines() or ["no word"])[-1]
                    return f"{Path(argv[0]).name} failed with {process.returncode}: {said}"
            figures.cpu += usage.ru_utime + usage.ru_stime
            figures.peak = max(figures.peak, usage.ru_maxrss * RESIDENT_UNIT / 2**20)
    return figures


def medians(jobs, rounds):
    """Return the medians of `jobs` over `rounds` alternating rounds, by name; report and skip those that fail."""
    results = {job.name: [] for job in jobs}
    left = list(jobs)
    for number in range(rounds + 1):
        for job in list(left):
            result = run(job)
            if isinstance(result, str):
                print(f"skipped: {job.name}: {result}", file=sys.stderr)
                left.remove(job)
                del results[job.name]
            elif number > 0:
                results[job.name].append(result)
    middle = lambda runs, key: statistics.median(getattr(r, key) for r in runs)
    return {name: Figures(*(middle(runs, key) for key in ("wall", "cpu", "peak"))) for name, runs in results.items()}


def exposure_times(images):
    """Return the exposure time of each photograph from EXIF, in seconds."""
    from PIL import Image

    return [float(Image.open(path).getexif().get_ifd(EXIF_IFD)[EXPOSURE_TIME]) for path in images]


def merge(program, outputs, images, *options):
    """Return the command that merges `images`."""
    return [program, "merge", "-q", *options, *(part for name in outputs for part in ("-o", "{out}/" + name)), *images]


def ours(program, images):
    """Return the jobs of hdralign."""
    align = [program, "align", "-q", "--report", "{out}/r.json", *images]
    return [
        Job("hdralign, .exr + .png", [merge(program, ["a.exr", "a.png"], images)]),
        Job("hdralign, .hdr", [merge(program, ["a.hdr"], images)]),
        Job("hdralign align", [align]),
    ]


def peers(images):
    """Return the jobs of the installed programs."""
    found = []
    script = [sys.executable, "-c", OPENCV, "{out}"]
    stack = [["align_image_stack", "-a", "{out}/h_", *images], ["enfuse", "-o", "{out}/e.tif", "*:h_*.tif"]]
    luminance = ["luminance-hdr-cli", "-a", "MTB", "-s", "{out}/l.exr", "-o", "{out}/l.png", "--tmo", "reinhard02", *images]
    has_opencv = importlib.util.find_spec("cv2") and importlib.util.find_spec("PIL")
    if has_opencv:
        times = ",".join(map(str, exposure_times(images)))
        found.append(Job("OpenCV, MTB, Debevec, .hdr + .png", [[*script, times, *images]]))
    if shutil.which("luminance-hdr-cli"):
        found.append(Job("luminance-hdr, MTB, .exr + .png", [luminance]))
    if all(map(shutil.which, ("align_image_stack", "enfuse"))):
        found.append(Job("Hugin align_image_stack + enfuse", stack))
    missing = {"OpenCV": has_opencv, "luminance-hdr": shutil.which("luminance-hdr-cli"), "Hugin": shutil.which("align_image_stack") and shutil.which("enfuse")}
    for name in (name for name, there in missing.items() if not there):
        print(f"skipped: {name}: not installed", file=sys.stderr)
    return found


def beside(program, images, rounds):
    """Print the comparison with other programs."""
    jobs = [*ours(program, images), *peers(images)]
    found = medians(jobs, rounds)
    base = found.get(jobs[0].name)
    print("| program | wall, s | CPU, s | peak, MB | times the wall of the first |\n|---|---|---|---|---|")
    for name, f in found.items():
        print(f"| {name} | {f.wall:.2f} | {f.cpu:.2f} | {f.peak:.0f} | {f.wall / base.wall if base else float('nan'):.1f} |")


def scaled(path, megapixels, target):
    """Scale the photograph `path` to a number of megapixels and save it as the JPEG `target`, with EXIF data and profile."""
    import numpy as np
    from PIL import Image

    picture = Image.open(path)
    kept = {key: picture.info[key] for key in ("exif", "icc_profile") if key in picture.info}
    factor = (megapixels * 1e6 / (picture.width * picture.height)) ** 0.5
    picture = picture.convert("RGB").resize((round(picture.width * factor), round(picture.height * factor)), Image.LANCZOS)
    pixels = np.asarray(picture).astype(np.float32)
    noise = np.random.default_rng(os.path.getsize(path)).standard_normal(pixels.shape[:2], np.float32)[..., None]
    Image.fromarray(np.clip(pixels + 1.5 * noise + 0.5, 0, 255).astype(np.uint8)).save(target, quality=93, **kept)


def brackets(images, folder):
    """Make brackets of three frames by megapixels, and of 12 MP by frames."""
    middle = (len(images) - 3) // 2
    three = images[middle : middle + 3]
    by_size = {}
    for megapixels in (3, 12, 48):
        by_size[megapixels] = [f"{folder}/{megapixels}mp-{i + 1}.jpg" for i in range(3)]
        for path, target in zip(three, by_size[megapixels]):
            scaled(path, megapixels, target)
    by_frames = {3: by_size[12]}
    for frames in (6, 9, 12):
        by_frames[frames] = list(by_size[12])
        for i in range(3, frames):
            copy = f"{folder}/12mp-{i + 1}.jpg"
            if not os.path.exists(copy):
                shutil.copy(by_size[12][i % 3], copy)
            by_frames[frames].append(copy)
    return by_size, by_frames


def growth(at):
    """Return the increase per unit in the second half of three points, divided by that in the first half."""
    (x0, a), (x1, b), (x2, c) = sorted(at.items())
    return ((c - b) / (x2 - x1)) / ((b - a) / (x1 - x0))


def scaling(program, images, rounds):
    """Print the table of frames, megapixels, threads and memory."""
    if len(images) < 3:
        sys.exit("--scaling needs three photographs")
    with tempfile.TemporaryDirectory(dir=SCRATCH) as folder:
        by_size, by_frames = brackets(images, folder)
        outputs = ["a.exr", "a.png"]
        job = lambda name, images, *options: Job(name, [merge(program, outputs, images, *options)])
        jobs = [job(f"{n} frames", files) for n, files in by_frames.items()]
        jobs += [job(f"{size} MP", files) for size, files in by_size.items() if size != 12]
        jobs += [job(f"{n} threads", by_frames[3], "--threads", str(n)) for n in (1, 2)]
        jobs += [Job("align", [[program, "align", "-q", "--report", "{out}/r.json", *by_frames[3]]])]
        has_limit = "--max-memory" in subprocess.run([program, "merge", "--help"], capture_output=True, text=True).stdout
        if has_limit:
            jobs.append(job("9 frames in 256MB", by_frames[9], "--max-memory", "256MB"))
        found = medians(jobs, rounds)
    wall = lambda name: found[name].wall if name in found else float("nan")
    peak = lambda name: found[name].peak if name in found else float("nan")
    frames = {n: wall(f"{n} frames") for n in (3, 6, 12)}
    sizes = {3: wall("3 MP"), 12: frames[3], 48: wall("48 MP")}
    listed = lambda at: ", ".join(f"{t:.2f}" for t in at.values())
    rows = [
        ("growth with frames (3, 6, 12 of 12 MP)", growth(frames), "<", 1.15, f"{listed(frames)} s"),
        ("growth with megapixels (3, 12, 48)", growth(sizes), "<", 1.15, f"{listed(sizes)} s"),
        ("1 thread over 2", wall("1 threads") / wall("2 threads"), ">", 1.7, f"{wall('1 threads'):.2f}, {wall('2 threads'):.2f} s"),
        ("`align`, s a frame of 12 MP", wall("align") / 3, "<", 0.15, f"{wall('align'):.2f} s"),
        ("peak of 3 frames, MB", peak("3 frames"), "<", 350, ""),
        ("peak of 9 frames, MB", peak("9 frames"), "<", 600, f"{wall('9 frames'):.2f} s"),
    ]
    if has_limit:
        limited = "9 frames in 256MB"
        rows.append(("peak of 9 frames, `--max-memory 256MB`, MB", peak(limited), "<", 256, f"{wall(limited):.2f} s"))
    print("| figure | measured | goal | reached | wall |\n|---|---|---|---|---|")
    for what, value, sense, goal, walls in rows:
        reached = value <= goal if sense == "<" else value >= goal
        print(f"| {what} | {value:.2f} | {'at most' if sense == '<' else 'at least'} {goal:.4g} | {'yes' if reached else 'no'} | {walls} |")


def arguments():
    summary, _, rest = __doc__.partition("\n\n")
    parser = argparse.ArgumentParser(description=summary, epilog=rest, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("images", nargs="*", metavar="IMAGES", help="photographs of one bracket, by rising exposure [default: testdata/window]")
    parser.add_argument("-n", "--rounds", type=int, default=5, help="number of measured rounds [default: 5]")
    parser.add_argument("--scaling", action="store_true", help="compare frames, megapixels, threads and memory with their goals")
    parser.add_argument("--program", default=str(ROOT / "target/release/hdralign"), help="the program [default: target/release/hdralign]")
    parser.add_argument("--scratch", default=None, metavar="FOLDER", help="folder for temporary files [default: that of the system]")
    given = parser.parse_args()
    if given.rounds < 1:
        parser.error("--rounds: give 1 or more")
    if not os.access(given.program, os.X_OK):
        parser.error(f"{given.program} is no program; make it by `cargo build --release`, or give --program")
    return given


if __name__ == "__main__":
    given = arguments()
    SCRATCH = given.scratch
    images = given.images or [str(ROOT / f"testdata/window/window_{i}.jpg") for i in range(1, 6)]
    (scaling if given.scaling else beside)(os.path.abspath(given.program), [os.path.abspath(path) for path in images], given.rounds)
