"""Textures made of noise and arithmetic: linear RGB, (H, W, 3), the top row first."""

from __future__ import annotations

import numpy as np


def rgb(code: str) -> np.ndarray:
    """Linear RGB of an sRGB colour such as `c8a27a`."""
    srgb = np.array([int(code[i : i + 2], 16) for i in (0, 2, 4)]) / 255
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def blend(low: str, high: str, amount: np.ndarray) -> np.ndarray:
    """Colours between two sRGB codes."""
    amount = np.clip(amount, 0, 1)[..., None]
    return rgb(low) * (1 - amount) + rgb(high) * amount


def noise(shape: tuple[int, int], down: float, along: float, seed: int) -> np.ndarray:
    """Smooth noise that tiles: zero mean, unit variance, features `down` by `along` pixels in size."""
    fy, fx = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])[None]
    white = np.fft.rfft2(np.random.default_rng(seed).standard_normal(shape))
    field = np.fft.irfft2(white * np.exp(-2 * np.pi**2 * ((fy * down) ** 2 + (fx * along) ** 2)), s=shape)
    return (field - field.mean()) / field.std()


def wood(dark: str, light: str, seed: int = 0, shape: tuple[int, int] = (256, 512)) -> np.ndarray:
    """Boards with their grain along x: growth rings cut at a slant, and fine pores."""
    rings = np.sin(2 * np.pi * (1.6 * noise(shape, 26, 130, seed) + 0.06 * noise(shape, 2, 30, seed + 1)))
    return blend(dark, light, 0.55 + 0.2 * rings + 0.13 * noise(shape, 0.8, 15, seed + 2))


def planks(dark: str, light: str, rows: int = 8, seed: int = 0, shape: tuple[int, int] = (768, 768)) -> np.ndarray:
    """A floor of `rows` boards along x with staggered ends, each board of its own shade."""
    random = np.random.default_rng(seed)
    pixels = wood(dark, light, seed, shape)
    height = shape[0] // rows
    for row in range(rows):
        band = np.roll(pixels[row * height : (row + 1) * height], random.integers(shape[1]), 1)
        ends = np.sort((random.integers(shape[1]) + np.array([0, shape[1] // 2])) % shape[1])
        band[:, : ends[0]] *= random.uniform(0.7, 1.1)
        band[:, ends[0] : ends[1]] *= random.uniform(0.7, 1.1)
        band[:, ends[1] :] *= random.uniform(0.7, 1.1)
        band[:2] *= 0.25
        for end in ends:
            band[:, end : end + 2] *= 0.25
        pixels[row * height : (row + 1) * height] = band
    return np.clip(pixels, 0, 1)


def palette(*codes: str) -> np.ndarray:
    """Broad plain stripes: `Model.box` starts anywhere in texture space, so each box gets one of the colours."""
    return np.repeat([[rgb(code) for code in codes]], 32, axis=1)


def weave(color: str, depth: float = 0.25, seed: int = 0, shape: tuple[int, int] = (256, 256)) -> np.ndarray:
    """Cloth: crossing threads, a little uneven."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    threads = np.where((x // 4 + y // 4) % 2, np.sin(np.pi * (x % 4 + 0.5) / 4), np.sin(np.pi * (y % 4 + 0.5) / 4))
    shade = 1 - depth * (1 - threads) + 0.06 * noise(shape, 1, 12, seed) + 0.06 * noise(shape, 12, 1, seed + 1)
    return np.clip(rgb(color) * shade[..., None], 0, 1)


def checker(dark: str, light: str, seed: int = 0, size: int = 512) -> np.ndarray:
    """Two by two stone tiles with a narrow joint and faint veins."""
    y, x = np.mgrid[:size, :size] * 2 / size
    veins = np.exp(-12 * np.abs(noise((size, size), 24, 24, seed)))
    odd = (x.astype(int) + y.astype(int)) % 2
    pixels = blend(dark, light, odd + np.where(odd, -0.18, 0.16) * veins + 0.02 * noise((size, size), 8, 8, seed))
    joint = np.minimum(np.minimum(x % 1, 1 - x % 1), np.minimum(y % 1, 1 - y % 1)) < 0.012
    return np.where(joint[..., None], rgb("6d675e"), pixels)


def wallpaper(ground: str, motif: str, stripe: str, size: int = 256) -> np.ndarray:
    """Stripes with a row of four-petalled flowers between them; two by two motifs, every other one shifted."""
    y, x = np.mgrid[:size, :size] / size
    column = (x * 2).astype(int)
    px, py = (x * 2) % 1 - 0.5, (y * 2 + 0.5 * column) % 1 - 0.5
    radius, angle = np.hypot(px, py), np.arctan2(py, px)
    flower = radius < 0.2 * (0.62 + 0.38 * np.cos(4 * angle))
    leaf = (np.abs(px - 0.05 * np.sin(2 * np.pi * py)) < 0.012) & (radius > 0.2)
    lines = np.abs(np.abs(px) - 0.44) < 0.018
    pixels = np.broadcast_to(rgb(ground), (size, size, 3)).copy()
    pixels[lines] = rgb(stripe)
    pixels[flower | leaf] = rgb(motif)
    pixels[radius < 0.03] = rgb(ground)
    return pixels


def rug(ground: str, figure: str, accent: str, shape: tuple[int, int] = (512, 768)) -> np.ndarray:
    """A woven rug: two borders around rows of nested diamonds."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    edge = np.minimum(np.minimum(x, shape[1] - 1 - x), np.minimum(y, shape[0] - 1 - y))
    diamond = np.abs(x % 128 - 64) + np.abs(y % 128 - 64)
    pixels = np.broadcast_to(rgb(ground), (*shape, 3)).copy()
    pixels[(diamond // 8 % 3 == 1) & (diamond < 60)] = rgb(figure)
    pixels[diamond < 12] = rgb(accent)
    pixels[edge < 44] = rgb(ground)
    pixels[(edge > 14) & (edge < 30)] = rgb(figure)
    zigzag = np.abs((x + y) % 24 - 12) < 4
    pixels[(edge > 16) & (edge < 28) & zigzag] = rgb(accent)
    return np.clip(pixels * (1 + 0.14 * noise(shape, 0.7, 2.5, 3))[..., None], 0, 1)


def hills(seed: int, size: int = 256) -> np.ndarray:
    """A small landscape painting: a low sun, haze, and ridges that darken towards the viewer."""
    y, x = np.mgrid[:size, :size] / size
    pixels = blend("e9b872", "5f86a3", 1 - y * 1.5 + 0.04 * noise((size, size), 8, 30, seed))
    pixels[np.hypot(x - 0.68, y - 0.36) < 0.085] = rgb("f6e3b4")
    for i, (far, near) in enumerate(
        [("8f9aa0", "7c8a8c"), ("5d7672", "4c6560"), ("3c524a", "30443c"), ("22322c", "18251f")]
    ):
        ridge = 0.46 + 0.13 * i + 0.035 * noise((1, size), 1, 26 - 4 * i, seed + i)[0]
        below = y > ridge[None]
        pixels[below] = blend(far, near, (y - ridge[None]) * 5 + 0.1 * noise((size, size), 2, 6, seed + 9))[below]
    return pixels


def discs(seed: int, size: int = 256) -> np.ndarray:
    """An abstract print: overlapping discs and bars on cream paper."""
    random = np.random.default_rng(seed)
    y, x = np.mgrid[:size, :size] / size
    pixels = np.broadcast_to(rgb("e8dfcc"), (size, size, 3)).copy()
    for code in ("c6533a", "2f4858", "d9a441", "86a59c", "1d1d1d"):
        cx, cy, r = random.uniform(0.25, 0.75), random.uniform(0.2, 0.8), random.uniform(0.08, 0.27)
        half = (np.hypot(x - cx, y - cy) < r) & ((x - cx) * random.choice([-1, 1]) < random.uniform(0, r))
        pixels[half] = pixels[half] * 0.15 + rgb(code) * 0.85
    pixels[(np.abs(y - 0.88) < 0.006) & (np.abs(x - 0.5) < 0.34)] = rgb("1d1d1d")
    return pixels


def script(ink: str, paper: str, lines: int, seed: int = 0, shape: tuple[int, int] = (512, 512)) -> np.ndarray:
    """A page of handwriting that means nothing: words of looping strokes with a ragged right edge."""
    random = np.random.default_rng(seed)
    cover = np.zeros(shape)
    step = shape[0] / (lines + 1)
    for line in range(lines):
        x, end = 0.08 * shape[1], shape[1] * random.uniform(0.55, 0.93)
        while x < end:
            t = np.linspace(0, 1, 400)
            length = step * random.uniform(0.9, 2.6)
            loops = random.uniform(2.5, 3.5) * length / step
            xs = x + t * length + 0.14 * step * np.sin(2 * np.pi * loops * t)
            rise = 0.22 * step * np.sin(2 * np.pi * loops * t + 1) * (0.6 + 0.5 * np.sin(9 * t + random.uniform(0, 6)))
            ys = (line + 1) * step - rise
            inside = (xs > 0) & (xs < shape[1] - 2)
            for dy in (0, 1):
                for dx in (0, 1):
                    cover[ys[inside].astype(int) + dy, xs[inside].astype(int) + dx] = random.uniform(0.75, 1)
            x += length + 0.4 * step
    return blend(paper, ink, cover)


def garden(sky: float, trees: float, horizon: float, seed: int = 0, shape: tuple[int, int] = (160, 320)) -> np.ndarray:
    """The view from a window, as radiance: a bright sky over sunlit leaves from `horizon` (0 top, 1 bottom) down."""
    y = np.linspace(0, 1, shape[0])[:, None] * np.ones(shape[1])
    outline = horizon + 0.04 * noise((1, shape[1]), 1, 11, seed) + 0.02 * noise((1, shape[1]), 1, 2.5, seed + 1)
    leaves = noise(shape, 9, 11, seed + 2) + 0.7 * noise(shape, 1.5, 1.8, seed + 3)
    green = blend("2c451f", "b4c777", 0.4 + 0.28 * leaves) * trees
    return np.where((y > outline)[..., None], green, blend("f4f5f2", "a4c6ec", 1 - 1.3 * y) * sky)
