"""A frame that needs no denoiser any more is not harmed by one, and more samples never make the result worse."""

import sys
from pathlib import Path

import inputs
import numpy as np
import pytest

from mcdenoise_cl import Frame, denoise
from mcdenoise_cl.render import render

sys.path.insert(0, str(Path(__file__).parent.parent / "bench"))
import convergence

SAMPLES = (16, 64, 256, 1024, 4096, 16384)


def relative_error(image, truth):
    return float(np.mean((image.astype(np.float64) - truth) ** 2 / (truth**2 + 0.01)))


def hidden_texture():
    """(truth, exact features): a grain of 3 % that no feature shows, which a fit would smooth away."""
    planes = inputs.features(72, 96, noise=0.0)
    grain = 1 + 0.03 * np.random.default_rng(3).standard_normal((72, 96, 1))
    return planes.pop("color").astype(np.float64) * grain, planes


def with_samples(truth, features, spp, seed):
    """Noise of one sample as strong as the pixel, falling as 1 / sqrt(n), known from variance and half buffers."""
    rng = np.random.default_rng([seed, spp])
    sigma = truth * np.sqrt(2.0 / spp)  # of each half
    a, b = ((truth + sigma * rng.standard_normal((*truth.shape[:2], 1))).astype(np.float32) for _ in range(2))
    # A variance from n samples is itself uncertain by sqrt(2 / n).
    known = sigma**2 / 2 * rng.gamma(spp / 2, 2 / spp, (*truth.shape[:2], 1))
    return Frame((a + b) / 2, color_a=a, color_b=b, color_variance=known.astype(np.float32), **features)


@pytest.mark.parametrize("method", ["auto", "regression", "guided"])
def test_errors_fall_with_the_samples(method):
    planes = inputs.features(72, 96, noise=0.0)
    truth = planes.pop("color").astype(np.float64)
    frames = [with_samples(truth, planes, spp, seed=1) for spp in SAMPLES]
    before = [relative_error(frame.color, truth) for frame in frames]
    after = [relative_error(denoise(frame, method=method), truth) for frame in frames]
    found = convergence.faults(SAMPLES, before, after)
    if method != "auto":  # the others do not know when to stop
        found = [fault for fault in found if "rises" in fault]
    assert found == []


@pytest.mark.parametrize("spp", [1024, 4096, 16384])
@pytest.mark.parametrize(
    "known", [("color_variance",), ("color_a", "color_b"), ("color_variance", "color_a", "color_b")]
)
def test_auto_is_never_worse_than_its_input_by_more_than_a_percent(known, spp):
    truth, planes = hidden_texture()
    after = before = 0.0
    for seed in range(2):
        frame = with_samples(truth, planes, spp, seed)
        kept = {name: plane for name, plane in frame.planes().items() if not name.startswith("color") or name in known}
        after += relative_error(denoise(frame.color, **kept), truth)
        before += relative_error(frame.color, truth)
    assert after <= convergence.MOST * before


def test_a_sum_of_renders_is_a_render_of_their_samples():
    parts = [
        render("room", spp=spp, width=32, height=18, seed=spp, halves=True, variant="scalar_rgb") for spp in (4, 12)
    ]
    whole = convergence.added_up(parts, (4, 12))
    np.testing.assert_allclose(whole.color, (4 * parts[0].color + 12 * parts[1].color) / 16, rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose((whole.color_a + whole.color_b) / 2, whole.color, rtol=1e-5, atol=1e-6)
    assert whole.metadata["samples_per_pixel"] == 16 and whole.shape == (18, 32)
    # The variance falls as the number of samples rises; its own noise is large here, so over the frame.
    ratio = np.median(
        whole.albedo_variance[parts[0].albedo_variance > 0] / parts[0].albedo_variance[parts[0].albedo_variance > 0]
    )
    assert 0.1 < ratio < 0.5


def test_faults_are_found():
    assert convergence.faults((1, 2, 3), (4.0, 2.0, 1.0), (3.0, 1.0, 0.5)) == []
    found = convergence.faults((1, 2, 3), (4.0, 2.0, 1.0), (3.0, 1.0, 1.02))
    assert found == ["3 spp: 1.020 times the error of the input", "3 spp: error rises from 1 to 1.02"]
