"""Patch SSIM, NLM and eq. 8 on the device against the equations in float64 and against scikit-image."""

import inputs
import numpy as np
import oracle
import pytest
from skimage.metrics import structural_similarity
from test_stages import close
from transfer import to_array, to_planes

from mcdenoise_cl.stages.nlm import CENTERS, SsimTerm, nlm
from mcdenoise_cl.stages.pad import pad
from mcdenoise_cl.stages.ssim import patch_ssim, patch_statistics

C1, C2 = 1e-4, 9e-4
WINDOWS = [(0, 0), (1, 0), (0, 2), (2, 1), (3, 2), (10, 3)]
SMALL = [size for size in inputs.SIZES if size != (37, 101)]


def unit_image(kind, height, width):
    image = inputs.planes(kind, height, width, 3)
    return (image / max(image.max(), 1)).astype(np.float32)


def prepare(engine, image, search, patch):
    unit = pad(engine, to_planes(engine, image), search + patch)
    return unit, pad(engine, patch_statistics(engine, unit, patch), search + patch)


@pytest.mark.parametrize(("height", "width"), inputs.SIZES)
@pytest.mark.parametrize("kind", inputs.KINDS)
@pytest.mark.parametrize(("patch", "dx", "dy"), [(2, 1, 0), (2, -3, 2), (1, 0, 0), (3, 7, -5), (0, 2, 2)])
def test_patch_ssim(engine, kind, height, width, patch, dx, dy):
    image = unit_image(kind, height, width)
    unit, stats = prepare(engine, image, max(abs(dx), abs(dy)), patch)
    actual = to_array(engine, patch_ssim(engine, unit, stats, dx, dy, patch, C1, C2))
    expected = oracle.patch_ssim(image, dx, dy, patch, C1, C2).reshape(actual.shape)
    # A variance of differences of order 1 is rounded by 1e-7, which is 1e-4 of C2.
    np.testing.assert_allclose(actual, expected, atol=1.2e-4)


def test_patch_ssim_agrees_with_scikit_image(engine):
    image = unit_image("uniform", 37, 101)
    dx, dy, patch = 2, -1, 2
    unit, stats = prepare(engine, image, 2, patch)
    actual = to_array(engine, patch_ssim(engine, unit, stats, dx, dy, patch, C1, C2))
    moved = np.roll(image, (-dy, -dx), (0, 1))
    _, theirs = structural_similarity(
        image, moved, win_size=5, use_sample_covariance=False, data_range=1, channel_axis=-1, full=True
    )
    inner = np.s_[5:-5, 5:-5]
    theirs = theirs.mean(-1)[inner]
    np.testing.assert_allclose(actual[inner], np.clip(theirs, 1e-6, 1), atol=1e-5)


def test_patch_ssim_of_equal_patches_is_one_to_the_last_bit(engine):
    image = np.broadcast_to(np.float32([0.5, 0.2, 0.9]), (20, 70, 3))
    unit, stats = prepare(engine, image, 3, 2)
    assert (to_array(engine, patch_ssim(engine, unit, stats, 3, -2, 2, C1, C2)) == 1.0).all()


@pytest.mark.parametrize(("height", "width"), SMALL)
@pytest.mark.parametrize("kind", inputs.KINDS)
@pytest.mark.parametrize(("search", "patch"), WINDOWS)
@pytest.mark.parametrize("center", CENTERS)
def test_nlm(engine, kind, height, width, search, patch, center):
    color = inputs.planes(kind, height, width, 3)
    tone = oracle.tonemap(color, 0.5).astype(np.float32)
    sigma = max(patch / 2, 0.3)
    out = nlm(
        engine,
        pad(engine, to_planes(engine, tone), search + patch),
        pad(engine, to_planes(engine, color), search),
        search_radius=search,
        patch_radius=patch,
        patch_sigma=sigma,
        noise_level=engine.constant([0.1]),
        h_factor=2.0,
        center=center,
    )
    windows = {"search_radius": search, "patch_radius": patch, "patch_sigma": sigma}
    expected = oracle.nlm(color, tone, **windows, h=0.2, center=center)
    # Weights as small as LEAST_WEIGHT decide a firefly's value; their exponents, up to 9, multiply d's rounding.
    close(to_array(engine, out), expected, tolerance=1e-5 if center == "one" else 3e-5)


@pytest.mark.parametrize(("height", "width"), SMALL)
@pytest.mark.parametrize("kind", inputs.KINDS)
@pytest.mark.parametrize("stabiliser", [0.0, 0.1, 1.0])
@pytest.mark.parametrize(("search", "patch"), [(2, 1), (3, 2)])
def test_ssim_nlm(engine, kind, height, width, stabiliser, search, patch):
    color = inputs.planes(kind, height, width, 3)
    tone = oracle.tonemap(color, 0.5).astype(np.float32)
    scene = inputs.features(height, width, seed=1)
    unit_normal = ((scene["normal"] + 1) / 2).astype(np.float32)
    unit, stats = prepare(engine, unit_normal, search, patch)
    windows = {"search_radius": search, "patch_radius": patch, "patch_sigma": 1.0}
    out = nlm(
        engine,
        pad(engine, to_planes(engine, tone), search + patch),
        pad(engine, to_planes(engine, color), search),
        **windows,
        noise_level=engine.constant([0.2]),
        h_factor=1.0,
        ssim=SsimTerm(unit, stats, C1, C2, stabiliser),
    )
    terms = {"c1": C1, "c2": C2, "stabiliser": stabiliser}
    close(to_array(engine, out), oracle.ssim_nlm(color, tone, unit_normal, **windows, h=0.2, **terms))


def test_printed_form_blurs_whatever_lies_on_a_plane(engine):
    """Eq. 8 as printed: equal normals, so a box blur across a shadow's edge; stabilised, the edge stays."""
    color = inputs.planes("step", 31, 64, 3)
    flat = np.full_like(color, 0.5)
    unit, stats = prepare(engine, flat, 3, 2)
    padded = pad(engine, to_planes(engine, color), 5)
    windows = {"search_radius": 3, "patch_radius": 2, "patch_sigma": 1.0}
    level = {"noise_level": engine.constant([0.05]), "h_factor": 1.0}
    printed = to_array(engine, nlm(engine, padded, padded, **windows, **level, ssim=SsimTerm(unit, stats, C1, C2, 0.0)))
    stable = to_array(engine, nlm(engine, padded, padded, **windows, **level, ssim=SsimTerm(unit, stats, C1, C2, 0.1)))
    close(printed, oracle.box_mean(color, 3))
    assert np.abs(printed - color).max() > 0.2
    assert np.abs(stable - color).max() < 0.01


def test_an_outlier_that_resembles_nothing_goes_with_the_largest_weight(engine):
    color = np.full((31, 64, 3), 0.2, np.float32)
    color[15, 30] = 50.0
    tone = oracle.tonemap(color, 1.0).astype(np.float32)
    padded = pad(engine, to_planes(engine, tone), 5), pad(engine, to_planes(engine, color), 5)
    windows = {"search_radius": 3, "patch_radius": 2, "patch_sigma": 1.0}
    level = {"noise_level": engine.constant([0.1]), "h_factor": 1.0}
    kept, gone = (to_array(engine, nlm(engine, *padded, **windows, **level, center=c))[15, 30, 0] for c in CENTERS)
    assert kept > 20 and gone < 3


def test_a_constant_stays_itself_to_the_last_bit(engine):
    color = inputs.planes("constant", 31, 64, 3)
    padded = pad(engine, to_planes(engine, color), 5)
    windows = {"search_radius": 3, "patch_radius": 2, "patch_sigma": 1.0}
    out = nlm(engine, padded, padded, **windows, noise_level=engine.constant([0.1]), h_factor=1.0)
    np.testing.assert_array_equal(to_array(engine, out), color.astype(np.float64))
