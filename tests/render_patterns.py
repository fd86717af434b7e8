#!/usr/bin/env python3
"""Renders pairs of exposures with known motion that mislead an alignment: patterns that stay at the same pixels while
the scene moves, scenes that repeat, scenes with a weave near the limit of what the pixels resolve, and scenes without
sharp detail.

    tests/render_patterns.py OUT PICTURE_OR_FOLDER... [--cases N] [--seed S] [--width W] [--kinds NAME,NAME...]

Each case is a folder as `tests/measure_alignment.py` expects it: img_00.jpg and img_01.jpg with exposure times, and
truth.json. The pictures are photographs, whose range is stretched, or radiance maps (.hdr). Needs Python 3, NumPy,
OpenCV (pip install numpy opencv-python-headless) and ExifTool."""
import argparse, json, pathlib, subprocess
import cv2
import numpy as np

cv2.setNumThreads(1)
# Supersampling of a frame: its pixels are means of UP x UP samples.
UP = 2

def text(rng, height):
    """A mask of a line of text, `height` pixels high."""
    words = "".join(chr(rng.integers(65, 91)) for _ in range(rng.integers(4, 12)))
    mask = np.zeros((64, 900), np.uint8)
    cv2.putText(mask, words, (4, 48), int(rng.choice([0, 2, 3, 4])), 1.6, 255, 3, cv2.LINE_AA)
    mask = mask[:, : int(np.flatnonzero(mask.any(0)).max()) + 12]
    return cv2.resize(mask, None, fx=height / 64, fy=height / 64, interpolation=cv2.INTER_AREA).astype(np.float32) / 255

def scene(paths, rng, w, h):
    """Linear radiance, 1.25 times the frame, from a random part of a random picture."""
    while True:
        image = cv2.imread(str(paths[rng.integers(len(paths))]), cv2.IMREAD_UNCHANGED | cv2.IMREAD_ANYDEPTH)
        if image is None or image.ndim != 3:
            continue
        image = image[..., :3]
        if image.dtype == np.uint8:
            v = image.astype(np.float32) / 255
            v = np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)
            image = v * np.maximum(v.mean(-1, keepdims=True), 1e-3) ** 0.7
        w2, h2 = int(w * 1.25), int(h * 1.25)
        least = max(w2 / image.shape[1], h2 / image.shape[0])
        k = rng.uniform(least, min(1.0, 1.6 * least)) if least < 1 else 1.01 * least
        image = cv2.resize(np.nan_to_num(image.astype(np.float32)), None, fx=k, fy=k, interpolation=cv2.INTER_AREA if k < 1 else cv2.INTER_CUBIC)
        y, x = rng.integers(max(1, image.shape[0] - h2 + 1)), rng.integers(max(1, image.shape[1] - w2 + 1))
        part = image[y : y + h2, x : x + w2].clip(1e-6)
        light = part @ np.array([0.0722, 0.7152, 0.2126], np.float32)
        middle = np.exp(np.log(light + np.percentile(light, 2)).mean())
        if np.log(light / middle + 1e-2)[::4, ::4].std() > 0.3:
            return part * (0.18 / middle * 2 ** rng.uniform(-0.7, 0.7)).astype(np.float32)

def tiled(rng, source, period):
    """One tile of the source over and over, turned by up to 6 degrees; each tile is `period` pixels wide and high."""
    h, w = source.shape[:2]
    y, x = rng.integers(h - period), rng.integers(w - period)
    tile = source[y : y + period, x : x + period]
    big = np.tile(tile, (2 * h // period + 2, 2 * w // period + 2, 1))
    turn = cv2.getRotationMatrix2D((big.shape[1] / 2, big.shape[0] / 2), rng.uniform(-6, 6), 1)
    big = cv2.warpAffine(big, turn, big.shape[1::-1], flags=cv2.INTER_LINEAR)
    y, x = (big.shape[0] - h) // 2, (big.shape[1] - w) // 2
    return big[y : y + h, x : x + w]

# What changes the radiance of the scene: (rng, radiance) -> radiance.

def periodic(rng, r):
    return tiled(rng, r, int(rng.integers(20, 90)))

def shaded(rng, r):
    """Repeats exactly, under light that falls off."""
    h, w = r.shape[:2]
    y, x = np.mgrid[:h, :w]
    light = 2.0 ** (rng.uniform(-1.5, 1.5) * (x / w - 0.5) + rng.uniform(-1.5, 1.5) * (y / h - 0.5))
    return periodic(rng, r) * light[..., None].astype(np.float32)

def facade(rng, r):
    """Repeats, but each tile has its own brightness, and some tiles show something else."""
    h, w = r.shape[:2]
    p = int(rng.integers(40, 110))
    y, x = np.mgrid[:h, :w] // p
    own = 2.0 ** rng.normal(0, rng.uniform(0.05, 0.5), (h // p + 1, w // p + 1)).astype(np.float32)
    other = rng.random(own.shape) < rng.uniform(0.02, 0.15)
    y0, x0 = rng.integers(h - p), rng.integers(w - p)
    out = np.tile(r[y0 : y0 + p, x0 : x0 + p], (h // p + 1, w // p + 1, 1))[:h, :w] * own[y, x][..., None]
    return np.where(other[y, x][..., None], r, out)

def moire(rng, r):
    """A fine weave on the scene, near the limit of what the pixels resolve."""
    y, x = np.mgrid[: r.shape[0], : r.shape[1]].astype(np.float32)
    a, f = rng.uniform(0, np.pi), rng.uniform(0.3, 0.48)
    wave = np.sin(2 * np.pi * f * (x * np.cos(a) + y * np.sin(a))) * np.sin(2 * np.pi * f * (y * np.cos(a) - x * np.sin(a)))
    return r * (1 + rng.uniform(0.3, 0.8) * wave)[..., None]

def upsampled(rng, r):
    k = rng.uniform(3, 6)
    small = cv2.resize(r, None, fx=1 / k, fy=1 / k, interpolation=cv2.INTER_AREA)
    return cv2.resize(small, r.shape[1::-1], interpolation=cv2.INTER_CUBIC).clip(1e-6)

def defocused(rng, r):
    n = int(rng.integers(4, 13))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * n + 1, 2 * n + 1)).astype(np.float32)
    return cv2.filter2D(r, -1, disc / disc.sum(), borderType=cv2.BORDER_REPLICATE)

# What stays at the same pixels: (rng, w, h) -> what is done to the exposure, and what to the values (0 to 1).

def nothing(rng, w, h):
    return (lambda e: e), (lambda v: v)

def watermark(rng, w, h):
    mask, mark = np.zeros((h, w), np.float32), text(rng, int(rng.uniform(0.03, 0.08) * h))
    turn = cv2.getRotationMatrix2D((mark.shape[1] / 2, mark.shape[1] / 2), rng.uniform(0, 45), 1)
    mark = cv2.warpAffine(np.pad(mark, (((mark.shape[1] - mark.shape[0]) // 2,) * 2, (0, 0))), turn, (mark.shape[1],) * 2)
    step = int(mark.shape[0] * rng.uniform(0.8, 1.6))
    for y in range(int(rng.integers(step)) - step, h, step):
        for x in range(int(rng.integers(step)) - step, w, step):
            y0, x0 = max(y, 0), max(x, 0)
            part = mark[y0 - y : h - y, x0 - x : w - x]
            mask[y0 : y0 + part.shape[0], x0 : x0 + part.shape[1]] = np.maximum(mask[y0 : y0 + part.shape[0], x0 : x0 + part.shape[1]], part)
    mask, light = mask[..., None] * rng.uniform(0.1, 0.35), rng.choice([0.0, 1.0])
    return (lambda e: e), (lambda v: v * (1 - mask) + light * mask)

def lettered(rng, w, h, mask, ground, light):
    return lambda v: np.where(mask > 0, ground * (1 - np.maximum(mask - 1, 0)) + light * np.maximum(mask - 1, 0), v)

def caption(rng, w, h):
    mask, bar = np.zeros((h, w, 1), np.float32), int(rng.uniform(0.05, 0.13) * h)
    top = 0 if rng.random() < 0.3 else h - bar
    mask[top : top + bar] = 1
    x = int(rng.uniform(0.02, 0.2) * w)
    while x < rng.uniform(0.5, 0.95) * w:
        line = text(rng, int(bar * 0.6))
        line = line[:, : max(0, w - x)]
        mask[top + bar // 5 : top + bar // 5 + line.shape[0], x : x + line.shape[1], 0] += line
        x += line.shape[1] + bar // 2
    ground = rng.choice([0.0, 1.0])
    return (lambda e: e), lettered(rng, w, h, mask, ground, 1 - ground)

def stamp(rng, w, h):
    mask, line = np.zeros((h, w, 1), np.float32), text(rng, int(rng.uniform(0.03, 0.06) * h))[:, : w // 2]
    y, x = h - int(1.8 * line.shape[0]), w - line.shape[1] - int(0.03 * w)
    mask[y : y + line.shape[0], x : x + line.shape[1], 0] = line
    colour = np.array([0.1, 0.6, 1.0], np.float32)
    return (lambda e: e), (lambda v: v * (1 - mask) + colour * mask)

def dust(rng, w, h):
    mask = np.ones((h, w), np.float32)
    for _ in range(rng.integers(5, 25)):
        spot = np.zeros((h, w), np.float32)
        cv2.circle(spot, (int(rng.integers(w)), int(rng.integers(h))), int(rng.uniform(0.003, 0.015) * w), 1, -1)
        mask *= 1 - rng.uniform(0.15, 0.6) * cv2.GaussianBlur(spot, (0, 0), rng.uniform(1, 4))
    return (lambda e: e * mask[..., None]), (lambda v: v)

def columns(rng, w, h):
    """Each column has its own gain and offset, and each row a smaller one."""
    k = rng.uniform(0.01, 0.05)
    line = lambda n: rng.normal(0, k, n).astype(np.float32)
    gain = (line((1, w)) + 0.3 * line((h, 1)))[..., None]
    return (lambda e: e * (1 + gain) + 0.05 * gain), (lambda v: v)

def fixed_noise(rng, w, h):
    """Each pixel has its own gain and offset."""
    k = rng.uniform(0.02, 0.08)
    gain, offset = (rng.normal(0, s, (h, w, 3)).astype(np.float32) for s in (k, 0.05 * k))
    return (lambda e: e * (1 + gain) + offset), (lambda v: v)

same = lambda rng, r: r
KINDS = dict(
    watermark=(same, watermark), caption=(same, caption), stamp=(same, stamp), dust=(same, dust), columns=(same, columns),
    fixed_noise=(same, fixed_noise), periodic=(periodic, nothing), shaded=(shaded, nothing), facade=(facade, nothing),
    moire=(moire, nothing), upsampled=(upsampled, nothing), defocused=(defocused, nothing),
)

def motion(rng, w, h):
    """Reference pixel -> frame pixel: a shift of up to 3 % of the width, a roll of up to 2 degrees, a pan of up to 0.4."""
    k = np.array([[1.2 * w, 0, (w - 1) / 2], [0, 1.2 * w, (h - 1) / 2], [0, 0, 1.0]])
    turn = cv2.Rodrigues(np.deg2rad([rng.uniform(-0.4, 0.4), rng.uniform(-0.4, 0.4), rng.uniform(-2, 2)]))[0]
    angle, length = rng.uniform(0, 2 * np.pi), 0.03 * w * np.sqrt(rng.uniform(0.02, 1))
    shift = np.array([[1, 0, length * np.cos(angle)], [0, 1, length * np.sin(angle)], [0, 0, 1.0]])
    return shift @ k @ turn @ np.linalg.inv(k)

def render(out, paths, kind, rng, w):
    w, h = (w, int(w * 2 / 3)) if rng.random() < 0.8 else (int(w * 2 / 3), w)
    change, stays = KINDS[kind]
    radiance = change(rng, scene(paths, rng, w, h)).astype(np.float32)
    on_exposure, on_values = stays(rng, w, h)
    power, curve, noise = rng.uniform(1.8, 2.4), rng.uniform(0, 0.5), 10 ** rng.uniform(3.5, 4.3)
    step, quality = rng.uniform(1, 3) * rng.choice([-1, 1]), int(rng.integers(86, 97))
    time = 1 / float(rng.choice([15, 30, 60, 125]))
    h_true, frames = [np.eye(3), motion(rng, w, h)], []
    out.mkdir(parents=True, exist_ok=True)
    y, x = (radiance.shape[0] - h) / 2, (radiance.shape[1] - w) / 2
    samples = np.array([[1 / UP, 0, 0.5 / UP - 0.5], [0, 1 / UP, 0.5 / UP - 0.5], [0, 0, 1.0]])
    for i in range(2):
        m = np.array([[1, 0, x], [0, 1, y], [0, 0, 1.0]]) @ np.linalg.inv(h_true[i]) @ samples
        e = cv2.warpPerspective(radiance, m, (w * UP, h * UP), flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REPLICATE)
        e = on_exposure(cv2.resize(e.clip(0), (w, h), interpolation=cv2.INTER_AREA) * 2.0 ** (step * i))
        e = e + rng.standard_normal(e.shape) * np.sqrt(np.maximum(e, 0) / noise + (4 / noise) ** 2)
        v = e.clip(0, 1) ** (1 / power)
        v = on_values((1 - curve) * v + curve * (3 * v * v - 2 * v**3))
        path = out / f"img_{i:02d}.jpg"
        cv2.imwrite(str(path), np.round(255 * v).clip(0, 255).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, quality])
        frames.append(dict(file=path.name, exposure=time * 2.0 ** (step * i), is_reference=i == 0, homography=h_true[i].tolist()))
    (out / "truth.json").write_text(json.dumps(dict(kind=kind, width=w, height=h, frames=frames)))
    return [(out / f["file"], f["exposure"]) for f in frames]

def useful(path):
    """Whether it is a radiance map, or a photograph that is not small and not dark or bright (their stretched range has steps)."""
    small = cv2.imread(str(path), cv2.IMREAD_REDUCED_GRAYSCALE_4)
    return path.suffix.lower() == ".hdr" or small is not None and min(small.shape) >= 120 and 75 < small.mean() < 165

def main():
    a = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    a.add_argument("out", type=pathlib.Path), a.add_argument("pictures", nargs="+", type=pathlib.Path)
    a.add_argument("--cases", type=int, default=8), a.add_argument("--seed", type=int, default=1)
    a.add_argument("--width", type=int, default=1200), a.add_argument("--kinds", default=",".join(KINDS))
    o = a.parse_args()
    paths = sorted(p for q in o.pictures for p in ([q] if q.is_file() else q.rglob("*")) if p.suffix.lower() in (".jpg", ".jpeg", ".png", ".hdr"))
    paths = [p for p in paths if useful(p)]
    if not paths:
        a.error("no pictures")
    written = []
    for kind in o.kinds.split(","):
        for case in range(o.cases):
            rng = np.random.default_rng([o.seed, list(KINDS).index(kind), case])
            written += render(o.out / f"{kind}_{case:03d}", paths, kind, rng, o.width)
        print(kind, flush=True)
    lines = [f"-ExposureTime={time:.8g}\n-FNumber=8\n-ISO=100\n-overwrite_original\n-q\n{path}" for path, time in written]
    subprocess.run(["exiftool", "-@", "-"], input="\n-execute\n".join(lines), text=True, check=True, stdout=subprocess.DEVNULL)

if __name__ == "__main__":
    main()
