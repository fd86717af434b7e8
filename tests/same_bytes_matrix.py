#!/usr/bin/env python3
"""Merges small brackets with every build, on every kind of processor, on 1 to 16 threads, in shuffled orders, and compares each byte.

    tests/same_bytes_matrix.py [--work FOLDER] [--builds NAME,NAME...] [--threads N] [--brief]

Builds: debug, release, native (-C target-cpu=native), musl, i686 and aarch64, each if its target is installed (rustup target add ...) and a
compiler for C (musl-tools; gcc-multilib or gcc-aarch64-linux-gnu, of which Debian has only one at a time); the release one as well as other processors, from SSE2 to AVX2, and aarch64, by qemu-user. What is not here is said to be left out, and
counted. The standard library of Python 3 is all it needs, and for --work a folder with a gigabyte. Exit code 0: no difference."""

import argparse
import hashlib
import itertools
import json
import os
import pathlib
import random
import shutil
import subprocess
import sys
import tempfile
from math import log2

ROOT = pathlib.Path(__file__).resolve().parent.parent

# Name: target, arguments of cargo, flags of rustc, what runs it.
BUILDS = {
    "release": (None, ["--release"], "", []),
    "debug": (None, [], "", []),
    "native": (None, ["--release"], "-C target-cpu=native", []),
    "musl": ("x86_64-unknown-linux-musl", ["--release"], "", []),
    "i686": ("i686-unknown-linux-gnu", ["--release"], "", []),
    "aarch64": ("aarch64-unknown-linux-gnu", ["--release"], "", ["qemu-aarch64", "-L", "/usr/aarch64-linux-gnu"]),
}
# Processors that qemu can be, for the release build: the widest vectors that each has.
PROCESSORS = {"qemu64": "SSE2", "Nehalem": "SSE4.2", "SandyBridge": "AVX", "Haswell": "AVX2 and FMA"}

OUTPUTS = ["a.exr", "a.hdr", "a.tif", "a.png", "a.jpg", "response.json"]
# What to ask for: everything that has arithmetic of its own, at least once.
ASKED = {
    "default": [],
    "options": "--deghost --flare --weight noise --response-model robertson --colour acescg --absolute --hdr-encoding xyze"
               " --tiff-encoding logluv32 --exr-type float".split(),
    "sift": "--align sift --response-model mitsunaga-nayar --weight gaussian --tmo fattal -C none".split(),
    "mtb": "--align mtb --response-model debevec --tmo mertens --max-memory 64MB --tiff-encoding logluv24".split(),
    **{tmo: ["--tmo", tmo, "--align", "none", "--response-model", "srgb"]
       for tmo in "reinhard02 reinhard02-local drago durand mantiuk06 mantiuk08".split()},
}


def built(name, work):
    """The program of a build and what runs it, or why there is none."""
    target, arguments, flags, runner = BUILDS[name]
    if runner and not shutil.which(runner[0]):
        return None, f"{runner[0]} is not installed"
    folder = work / "target" / name if flags or target else pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    environment = dict(os.environ, CARGO_TARGET_DIR=str(folder))
    if flags or target:
        # Quicker to build, and one way more in which the compiler may go.
        environment.update(CARGO_PROFILE_RELEASE_LTO="off", CARGO_PROFILE_RELEASE_CODEGEN_UNITS="16")
    if flags:
        environment["RUSTFLAGS"] = flags
    if name == "aarch64":
        environment["CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER"] = "aarch64-linux-gnu-gcc"
    command = ["cargo", "build", "--locked", "--bin", "hdralign", *arguments] + (["--target", target] if target else [])
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    if done.returncode:
        return None, done.stderr.strip().splitlines()[-1]
    profile = "release" if "--release" in arguments else "debug"
    program = folder / (target or "") / profile / "hdralign"
    # Later builds replace it.
    kept = work / f"hdralign-{name}"
    shutil.copy2(program, kept)
    return [*runner, str(kept)], None


def brackets(work):
    """Photographs of several kinds: three and nine JPEG frames with EXIF, and 16-bit TIFF frames that are told by -e."""
    made = work / "brackets"
    if not made.exists():
        for frames, width in ((3, 240), (9, 160)):
            subprocess.run(["cargo", "run", "--quiet", "--locked", "--release", "--example", "card_dump", "--", str(made / f"jpeg{frames}"), "--brackets", "1",
                            "--frames", str(frames), "--width", str(width)], cwd=ROOT, check=True)
        tiffs = made / "tiff"
        tiffs.mkdir()
        images = photographs(made / "jpeg3")
        subprocess.run([str(work / "hdralign-release"), "align", *map(str, images), "--save-aligned", str(tiffs / "frame"), "-q"],
                       check=True, stdout=subprocess.DEVNULL)
        for tiff in photographs(tiffs):
            # Results of the program are no photographs to it: the tag that tells them has another name.
            tiff.write_bytes(tiff.read_bytes().replace(b"hdralign ", b"a camera "))
    return {"jpeg3": (photographs(made / "jpeg3"), []), "jpeg9": (photographs(made / "jpeg9"), []),
            "tiff": (photographs(made / "tiff"), None)}


def photographs(folder):
    return sorted(p for p in folder.rglob("*") if p.suffix.lower() in (".jpg", ".tif"))


def exposures(program, images):
    """Those of the photographs that TIFF frames were made of, as -e wants them."""
    told = subprocess.run([*program, "align", *map(str, images), "--json"], capture_output=True, text=True, check=True).stdout
    return [log2(f["relative_exposure"]) for f in sorted(json.loads(told)["frames"], key=lambda f: f["path"])]


def digest(program, images, arguments):
    """Of all files that one run writes, and of its report without what a clock wrote."""
    with tempfile.TemporaryDirectory() as folder:
        outputs = [part for name in OUTPUTS[:-1] for part in ("-o", name)]
        command = [*program, "merge", *images, *outputs, "--save-response", OUTPUTS[-1], "--report", "r.json", "-q", *arguments]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(f"{' '.join(command)}\n{done.stderr}")
        report = json.loads(pathlib.Path(folder, "r.json").read_text())
        report.pop("time_s")
        found = {name: hashlib.sha256(pathlib.Path(folder, name).read_bytes()).hexdigest() for name in OUTPUTS}
        found["report"] = hashlib.sha256(json.dumps(report, sort_keys=True).encode()).hexdigest()
        return found


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--work", type=pathlib.Path, help="where builds and brackets are kept; a temporary folder by default")
    parser.add_argument("--builds", default=",".join(BUILDS), help="some of: " + ", ".join(BUILDS))
    parser.add_argument("--threads", type=int, default=16, help="the most threads that are tried")
    parser.add_argument("--brief", action="store_true", help="two sets of options on qemu instead of all")
    args = parser.parse_args()
    work = args.work or pathlib.Path(tempfile.mkdtemp(prefix="same-bytes-"))
    work.mkdir(parents=True, exist_ok=True)
    shuffle = random.Random(8)
    runs, differences, left_out = 0, [], []

    programs = {}
    for name in ["release"] + [n for n in args.builds.split(",") if n != "release"]:
        print(f"build: {name}", file=sys.stderr, flush=True)
        program, reason = built(name, work)
        if program:
            programs[name] = program
        else:
            left_out.append(f"{name}: {reason}")
    if "release" not in programs:
        sys.exit("\n".join(left_out))
    reference = programs["release"]
    scenes = brackets(work)
    e = exposures(reference, scenes["jpeg3"][0])
    asked = [(scene, name) for name in ASKED for scene in (scenes if name in ("default", "options") else ["jpeg3"])]

    def arguments(scene, name, order=None):
        images, extra = scenes[scene]
        order = order or list(range(len(images)))
        extra = ["--ev=" + ",".join(repr(e[i]) for i in order)] if extra is None else extra
        return [str(images[i]) for i in order], [*ASKED[name], *extra]

    expected = {}
    for key in asked:
        images, options = arguments(*key)
        expected[key] = digest(reference, images, [*options, "--threads", "1"])
    runs += len(expected)

    def check(what, program, key, more, order=None):
        nonlocal runs
        images, options = arguments(*key, order)
        found = digest(program, images, [*options, *more])
        runs += 1
        wrong = [name for name, value in found.items() if value != expected[key][name]]
        if wrong:
            differences.append(f"{what}, {'/'.join(key)}, {' '.join(more)}, order {order}: {', '.join(wrong)}")
            print(differences[-1], file=sys.stderr, flush=True)

    def shuffled(key):
        order = list(range(len(scenes[key[0]][0])))
        shuffle.shuffle(order)
        return order

    counts = {}
    before = runs
    for key, threads in itertools.product(asked, range(1, args.threads + 1)):
        check("release", reference, key, ["--threads", str(threads)], shuffled(key))
    counts[f"release, 1 to {args.threads} threads, shuffled"] = runs - before
    for name in [n for n in programs if n != "release"]:
        before = runs
        few = asked[:6] if BUILDS[name][3] and args.brief else asked
        for key, threads in itertools.product(few, ("1",) if BUILDS[name][3] else ("1", "3")):
            check(name, programs[name], key, ["--threads", threads], shuffled(key))
        counts[name] = runs - before
    for processor, vectors in PROCESSORS.items():
        if not shutil.which("qemu-x86_64"):
            left_out.append(f"{processor}: qemu-x86_64 is not installed")
            continue
        before = runs
        for key in asked[:6] if args.brief else asked:
            check(processor, ["qemu-x86_64", "-cpu", processor, *reference], key, ["--threads", "2"], shuffled(key))
        counts[f"release as {processor} ({vectors})"] = runs - before

    print(json.dumps({"runs": runs, "files_compared": runs * (len(OUTPUTS) + 1), "differences": len(differences), "by_build": counts,
                      "left_out": left_out}, indent=2))
    sys.exit(1 if differences else 0)


if __name__ == "__main__":
    main()
