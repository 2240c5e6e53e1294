"""Fireflies of any strength: they go, leave no block behind, and their light is reported; small lamps stay."""

import numpy as np
import pytest
from sampled import FEATURES, SPP, relative_error, sampled

from mcdenoise_cl import Denoiser, Frame, denoise

SIZE = (64, 96)
PLACE = (20, 45)
FITS = ["regression", "guided", "auto"]
KNOWN = {
    "all": None,
    "variance": ("color", *FEATURES, "color_variance"),
    "halves": ("color", *FEATURES, "color_a", "color_b"),
    "features": ("color", *FEATURES),
    "colour": ("color",),
}
#: Each method with what it may know of the frame.
CASES = [(method, known) for method in FITS for known in KNOWN]
CASES += [("ssim-nlm", "features"), ("nlm", "colour")]


def of_planes(planes, known):
    return Frame(**{name: planes[name] for name in KNOWN[known] or planes})


def with_firefly(planes, times, size=(1, 1)):
    """One sample of one pixel is `times` the mean of the frame; or of each pixel of a block."""
    planes = {name: plane.copy() for name, plane in planes.items()}
    sample = times * planes["color"].mean() * np.float32([1.0, 0.9, 0.8])
    where = tuple(slice(at, at + n) for at, n in zip(PLACE, size, strict=True))
    planes["color"][where] += sample / SPP
    planes["color_a"][where] += sample / (SPP / 2)
    planes["color_variance"][where] += (sample / SPP) ** 2
    return planes


def distance_from_place():
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    return np.maximum(abs(y - PLACE[0]), abs(x - PLACE[1]))


def left_behind(with_it, without_it, truth):
    """What a firefly adds within 7 pixels, the widest first window, beyond what it adds 11 to 13 away: on average, and
    at most to one pixel; in units of the brightness around."""
    added, distance = (with_it - without_it).mean(-1), distance_from_place()
    ring, light = added[(distance >= 11) & (distance <= 13)].mean(), truth[distance <= 13].mean()
    return (added[distance <= 7].mean() - ring) / light, (added[distance <= 7].max() - ring) / light


@pytest.mark.parametrize(("method", "known"), CASES)
@pytest.mark.parametrize("times", [1e2, 1e3, 1e4, 1e5])
def test_a_firefly_leaves_no_block(method, known, times):
    planes, truth = sampled(*SIZE)
    images = [denoise(of_planes(p, known), method=method) for p in (with_firefly(planes, times), planes)]
    block, most = left_behind(*images, truth)
    assert abs(block) < 0.02
    # Non-local means holds no outliers back: the pixel itself stays a bright one, though no longer a thousandfold.
    assert most < (1 / 3 if method in FITS else 2.0)


@pytest.mark.parametrize("method", FITS)
@pytest.mark.parametrize("known", ["all", "variance", "halves"])
@pytest.mark.parametrize("size", [(1, 2), (3, 1), (2, 2)])
def test_a_group_of_fireflies_leaves_no_block(method, known, size):
    planes, truth = sampled(*SIZE)
    images = [denoise(of_planes(p, known), method=method) for p in (with_firefly(planes, 1e4, size), planes)]
    block, most = left_behind(*images, truth)
    assert abs(block) < 0.02 and most < 1 / 3


@pytest.mark.parametrize("method", FITS)
@pytest.mark.parametrize("times", [1e3, 1e5, 1e7])
def test_a_firefly_casts_no_veil(method, times):
    """Its light goes back as far as it does not show: no more than a tenth, all over the frame."""
    planes, truth = sampled(*SIZE)
    images = [denoise(Frame(**p), method=method) for p in (with_firefly(planes, times), planes)]
    away = distance_from_place() > 7
    assert (images[0] - images[1])[away].mean() < 0.1 * truth[away].mean()


def test_the_measure_sees_the_block_of_a_linear_average():
    """Eq. 8 as printed, on a plane: every pixel of the window gets the same share of the firefly."""
    planes, truth = sampled(*SIZE)
    given = {"method": "ssim-nlm", "stabilised": False, "average": "linear"}
    images = [denoise(of_planes(p, "features"), **given) for p in (with_firefly(planes, 1e3), planes)]
    block, most = left_behind(*images, truth)
    assert block > 0.1 and most > 0.5


@pytest.mark.parametrize("method", FITS)
@pytest.mark.parametrize("times", [1e3, 1e5])
def test_the_light_of_a_firefly_is_reported(method, times):
    planes, _ = sampled(*SIZE)
    removed = []
    for p in (with_firefly(planes, times), planes):
        denoiser = Denoiser(*SIZE, method=method)
        denoiser(Frame(**p))
        removed.append(denoiser.report.energy_removed * p["color"].sum())
    struck = with_firefly(planes, times)["color"]
    assert removed[0] - removed[1] == pytest.approx((struck - planes["color"]).sum(), rel=0.05)


def with_lamps(planes, truth, where, times=100.0):
    """Pixels of this many times the mean in every sample, which differ by 2 % of that in the mean."""
    planes, truth = {name: plane.copy() for name, plane in planes.items()}, truth.copy()
    rng = np.random.default_rng(3)
    light = times * truth.mean() * np.float32([1.0, 0.8, 0.5])
    samples = light * (1 + 0.02 * np.sqrt(SPP) * rng.standard_normal((SPP, int(where.sum()), 1)))
    truth[where], planes["color"][where] = light, samples.mean(0)
    planes["color_a"][where], planes["color_b"][where] = samples[::2].mean(0), samples[1::2].mean(0)
    planes["color_variance"][where] = samples.var(0, ddof=1) / SPP
    return planes, truth


def lamp(kind):
    where = np.zeros(SIZE, bool)
    if kind == "filament":
        x = np.arange(30, 60)
        where[np.round(20 + 3 * np.sin(x / 2)).astype(int), x] = True
    else:
        where[PLACE] = True
        if kind == "two by two":
            where[PLACE[0] : PLACE[0] + 2, PLACE[1] : PLACE[1] + 2] = True
    return where


@pytest.mark.parametrize("method", FITS)
@pytest.mark.parametrize(
    ("kind", "known"),
    [
        ("one pixel", "all"),
        ("one pixel", "variance"),
        ("two by two", "all"),
        ("two by two", "variance"),
        ("two by two", "halves"),
        ("filament", "all"),
        ("filament", "variance"),
        ("filament", "halves"),
    ],
)
def test_a_small_lamp_that_every_sample_finds_stays(method, kind, known):
    """A single pixel in two halves alone may be as bright in both by chance, and does not stay among noise."""
    where = lamp(kind)
    planes, truth = with_lamps(*sampled(*SIZE), where)
    out = denoise(of_planes(planes, known), method=method)
    np.testing.assert_allclose(out[where].mean(), truth[where].mean(), rtol=0.05)
    assert relative_error(out, truth, where) < 0.01
    # And it does not spill: the wall beside it is as dark as ever.
    beside = ~where & (distance_from_place() <= 3)
    assert relative_error(out, truth, beside) < 2 * relative_error(planes["color"], truth, beside)
