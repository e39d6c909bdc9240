"""Records what other people's programs measure on the pairs of pictures that tests/oracle.rs also draws.

    pip install numpy scikit-image flip-evaluator
    python oracle.py > values.json

The pictures are integer arithmetic, so that both languages draw the same bytes.
"""

import json
from importlib.metadata import version

import flip_evaluator
import numpy as np
from skimage.metrics import mean_squared_error, peak_signal_noise_ratio, structural_similarity

W, H = 256, 192


def reference():
    y, x = np.mgrid[0:H, 0:W].astype(np.int64)
    r = 255 * x // (W - 1)
    g = 255 * y // (H - 1)
    b = 20 + 200 * ((x // 8 + y // 8) & 1)
    disc = (x - 80) ** 2 + (y - 96) ** 2 < 40 * 40
    r, g, b = (np.where(disc, v, c) for v, c in ((200, r), (40, g), (30, b)))
    chirp = (x >= 150) & (y >= 100)
    stripe = 255 * ((x * x // 64) & 1)
    return np.stack([np.where(chirp, stripe, c) for c in (r, g, b)], axis=-1).astype(np.uint8)


def noisy(picture):
    i = np.arange(picture.size, dtype=np.uint64)
    h = (i * 2654435761) & 0xFFFFFFFF
    h ^= h >> 15
    h = (h * 2246822519) & 0xFFFFFFFF
    h ^= h >> 13
    noise = sum(((h >> s) & 0xFF).astype(np.int64) for s in (0, 8, 16, 24)) - 510
    return np.clip(picture.astype(np.int64) + (noise // 18).reshape(picture.shape), 0, 255).astype(np.uint8)


def shifted(picture):
    return picture[:, np.maximum(np.arange(W) - 1, 0)]


def dimmed(picture):
    return (picture.astype(np.int64) * 3 // 4).astype(np.uint8)


def turned(picture):
    return picture[:, :, [1, 2, 0]]


def measure(ref, test, ppd=67.0):
    a, b = ref.astype(np.float64) / 255, test.astype(np.float64) / 255
    wang = dict(gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=1.0)
    luma = np.array([0.2126, 0.7152, 0.0722])
    _, flip, _ = flip_evaluator.evaluate(
        a.astype(np.float32), b.astype(np.float32), "LDR", applyMagma=False, parameters={"ppd": ppd})
    return {
        "ppd": ppd,
        "rmse": float(np.sqrt(mean_squared_error(a, b))),
        "psnr_db": float(peak_signal_noise_ratio(a, b, data_range=1.0)),
        "ssim": float(structural_similarity(a, b, channel_axis=-1, **wang)),
        "ssim_luma": float(structural_similarity(a @ luma, b @ luma, **wang)),
        "flip": float(flip),
    }


ref = reference()
tests = {"noise": noisy(ref), "shift": shifted(ref), "dim": dimmed(ref), "turn": turned(ref)}
record = {
    "made_with": {p: version(p) for p in ("numpy", "scikit-image", "flip-evaluator")},
    "byte_sums": {name: int(p.astype(np.int64).sum()) for name, p in {"reference": ref, **tests}.items()},
    "pairs": {name: measure(ref, test) for name, test in tests.items()},
}
record["pairs"]["noise_20_ppd"] = measure(ref, tests["noise"], 20.0)
record["pairs"]["shift_20_ppd"] = measure(ref, tests["shift"], 20.0)
print(json.dumps(record, indent=2))
