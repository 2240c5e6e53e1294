"""Effects that features do not show, or show wrongly: `auto` is no worse than its input, and edges survive.

The scenes are those of `bench/stability_scenes.py`, smaller or with fewer samples.
"""

import sys
from pathlib import Path

import numpy as np
import pytest

from mcdenoise_cl import Frame, denoise
from mcdenoise_cl.metrics import frame_exposure, relmse_map
from mcdenoise_cl.render import render

sys.path.insert(0, str(Path(__file__).parent.parent / "bench"))
import effects
import stability_scenes as scenes


def errors(result, frame, reference, mask):
    """Mean relative squared error over the mask, of the result and of its input, without the reference's own noise."""
    exposure = frame_exposure(reference)
    return [
        relmse_map(image, reference.color, exposure, reference.color_a, reference.color_b)[mask].mean()
        for image in (result, frame.color)
    ]


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """(name, samples) -> a frame of a rendered scene, at 120 x 90."""
    made = {}

    def frame_of(name, spp, seed):
        if (name, spp) not in made:
            path = tmp_path_factory.mktemp("scene") / "scene.xml"
            path.write_text(f'<scene version="3.0.0">{effects.SCENES[name]}</scene>')
            made[name, spp] = render(path, spp=spp, width=120, height=90, seed=seed, halves=True)
        return made[name, spp]

    return frame_of


@pytest.mark.parametrize(
    ("name", "judged", "least"),
    [
        ("shadow", scenes.color_edges, 0.7),
        ("alpha", scenes.color_edges, 0.7),
        ("defocus", scenes.mixed_features, 0.8),
        # Of what mirror and glass show, 4 samples do not tell more than that; the rest comes with the samples.
        ("mirror and glass", scenes.mirrored_edges, 0.3),
    ],
)
def test_edges_that_no_feature_shows_survive(seen, name, judged, least):
    frame, reference = seen(name, 4, seed=1), seen(name, 64, seed=2)
    mask = judged(reference)
    out = denoise(frame)
    error, before = errors(out, frame, reference, mask)
    assert mask.sum() > 500 and np.isfinite(out).all()
    assert error < before
    assert scenes.contrast_kept(out, reference, mask) > least


@pytest.mark.parametrize(
    ("shade", "least"), [(scenes.foliage, 0.8), (scenes.moving_card, 0.1)], ids=["foliage", "motion blur"]
)
def test_features_that_are_mixtures_do_no_harm(shade, least):
    frame, reference = effects.sampled(shade, 4, seed=1), effects.sampled(shade, 128, seed=2)
    mask = scenes.mixed_features(reference)
    out = denoise(frame)
    error, before = errors(out, frame, reference, mask)
    assert np.isfinite(out).all() and error < before / 2
    assert scenes.contrast_kept(out, reference, mask) > least


def test_blur_comes_out_with_its_contrast_once_there_are_samples():
    """What is lost at 4 spp is not in the input: at 64 it is, and stays."""
    frame, reference = effects.sampled(scenes.moving_card, 64, seed=1), effects.sampled(scenes.moving_card, 256, seed=2)
    mask = scenes.mixed_features(reference)
    out = denoise(frame)
    error, before = errors(out, frame, reference, mask)
    assert error < before / 2
    assert scenes.contrast_kept(out, reference, mask) > 0.75


@pytest.fixture(scope="module")
def sunlit():
    return effects.sampled(scenes.sun, 4, seed=1), effects.sampled(scenes.sun, 64, seed=2)


@pytest.mark.parametrize("known", ["nothing", "halves", "variances", "all"])
@pytest.mark.parametrize("method", ["auto", "regression", "guided", "ssim-nlm", "nlm"])
def test_a_sun_sheds_no_light_on_what_is_beside_it(method, known, sunlit):
    """A million times as bright: what leaks of it would be the whole of the error there."""
    frame, reference = sunlit
    kept = {
        "nothing": ("color", "albedo", "normal", "depth"),
        "halves": ("color", "albedo", "normal", "depth", "color_a", "color_b"),
        "variances": [name for name in frame.planes() if name not in ("color_a", "color_b")],
        "all": list(frame.planes()),
    }[known]
    out = denoise(Frame(**{name: frame.planes()[name] for name in kept}), method=method)
    error, before = errors(out, frame, reference, scenes.beside_the_sun(reference))
    assert np.isfinite(out).all() and error < 0.8 * before
    inside = reference.color.max(-1) > 3.9e5
    # Where colours are averaged as x / (1 + x), a dark neighbour counts for more than a sun.
    least = 0.3 if method in ("nlm", "ssim-nlm") else 0.95
    assert out[inside].mean() > least * reference.color[inside].mean()


@pytest.mark.parametrize(
    "left_out", [(), ("color_a", "color_b"), ("color_variance",)], ids=["all", "variances", "halves"]
)
def test_beside_a_sun_the_mix_is_as_good_as_the_regression(sunlit, left_out):
    """A few pixels that the sun touches bring no noise back around them."""
    frame, reference = sunlit
    frame = Frame(**{name: plane for name, plane in frame.planes().items() if name not in left_out})
    mask = scenes.beside_the_sun(reference)
    mixed, alone = (
        errors(denoise(frame, method=method), frame, reference, mask)[0] for method in ("auto", "regression")
    )
    assert mixed < 2 * alone


def test_half_floats_that_overflow(sunlit):
    """Infinity counts as missing: the result is finite, and what lies around is as with 32 bits."""
    frame, reference = sunlit
    with np.errstate(over="ignore"):
        half = Frame(**{name: plane.astype(np.float16) for name, plane in frame.planes().items()})
    assert np.isinf(half.color).any()
    out = denoise(half)
    error, before = errors(out.astype(np.float32), frame, reference, scenes.beside_the_sun(reference))
    assert out.dtype == np.float16 and np.isfinite(out).all() and error < before


def test_half_floats_at_their_largest_stay_there(sunlit):
    """A renderer that clips writes 65504: a lamp of that is kept, and rounding makes no infinity of it."""
    frame, _ = sunlit
    half = Frame(**{name: np.minimum(plane, 65504).astype(np.float16) for name, plane in frame.planes().items()})
    out = denoise(half)
    inside = (half.color == 65504).all(-1) & (frame.color_variance.max(-1) == 0)
    assert inside.sum() > 50 and np.isfinite(out).all()
    np.testing.assert_allclose(out[inside].astype(np.float32), 65504, rtol=0.02)
