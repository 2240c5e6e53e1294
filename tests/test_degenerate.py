"""Features that say nothing, or mislead: about as good as without them, and never worse than the input."""

import numpy as np
import oracle
import pytest
from sampled import FEATURES, relative_error, sampled

from mcdenoise_cl import Frame, denoise, methods

METHODS = [method.name for method in methods()]
FITS = ["regression", "guided", "auto"]
SIZE = (64, 96)
VARIANCES = tuple(f"{name}_variance" for name in FEATURES)


def error(planes, truth, **given):
    out = denoise(Frame(**planes), **given)
    assert np.isfinite(out).all()
    return relative_error(out, truth)


def constant(**values):
    """Features that are the same everywhere, and known to be."""

    def change(planes):
        for name, value in values.items():
            planes[name][:] = value
            planes[f"{name}_variance"][:] = 0

    return change


def scaled(name, factor):
    def change(planes):
        planes[name] *= np.float32(factor)
        planes[f"{name}_variance"] *= np.float32(factor) ** 2

    return change


def noise_alone(planes):
    """Features that hold nothing but noise, and variances that say so."""
    rng = np.random.default_rng(4)
    for name, low, high in (("albedo", 0, 1), ("normal", -1, 1), ("depth", 1, 5)):
        planes[name][:] = rng.uniform(low, high, planes[name].shape)
        planes[f"{name}_variance"][:] = (high - low) ** 2 / 12


def alternating(planes):
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    planes["normal"] *= np.where((x + y) % 2, 1, -1)[..., None].astype(np.float32)


def in_stripes(planes):
    """Normals that turn round every three pixels: patches three pixels apart are opposites."""
    stripes = np.where(np.arange(SIZE[1]) // 3 % 2, 1, -1)[:, None]
    planes["normal"][:] = stripes * np.float32([1, 1, 1]) / np.sqrt(3)
    planes["normal_variance"][:] = 0


def uneven(planes):
    scaled("normal", np.random.default_rng(5).uniform(0.2, 5, (*SIZE, 1)))(planes)


def exchanged(planes):
    for end in ("", "_variance"):
        planes[f"albedo{end}"], planes[f"normal{end}"] = planes[f"normal{end}"], planes[f"albedo{end}"]


def mirrored(planes):
    for name in (*FEATURES, *VARIANCES):
        planes[name] = np.ascontiguousarray(planes[name][:, ::-1])


#: What is done, and the features that are of no use then; none where the same is told in another way.
DAMAGE = {
    "equal normals": (constant(normal=(0, 0, 1)), ("normal",)),
    "normals of 0": (constant(normal=0), ("normal",)),
    "normals that alternate": (alternating, ("normal",)),
    "normals in stripes": (in_stripes, ("normal",)),
    "normals of uneven lengths": (uneven, ("normal",)),
    "albedo of 0": (constant(albedo=0), ("albedo",)),
    "albedo up to 4": (scaled("albedo", 5.0), ("albedo",)),
    "depth of 0": (constant(depth=0), ("depth",)),
    "depth of 1e9": (constant(depth=1e9), ("depth",)),
    "negative depth": (scaled("depth", -1), ("depth",)),
    "features of 0": (constant(albedo=0, normal=0, depth=0), FEATURES),
    "noise, known": (noise_alone, FEATURES),
    "normals of length 10": (scaled("normal", 10), ()),
    "exchanged": (exchanged, ()),
    "mirrored": (mirrored, FEATURES),
}
#: What changes from pixel to pixel with variances that call it exact: fits follow some of it.
MISLEADING = ("normals that alternate", "normals in stripes", "normals of uneven lengths", "mirrored")


def damaged(kind):
    planes, truth = sampled(*SIZE)
    DAMAGE[kind][0](planes)
    return planes, truth


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", DAMAGE)
def test_never_worse_than_the_input(kind, method):
    planes, truth = damaged(kind)
    assert error(planes, truth, method=method) < 0.6 * relative_error(planes["color"], truth)


@pytest.mark.parametrize("method", METHODS)
def test_noise_that_nothing_tells_from_a_feature(method):
    """Features of noise without a variance: fits follow them, and still leave less error than there was."""
    planes, truth = damaged("noise, known")
    planes = {name: plane for name, plane in planes.items() if name not in VARIANCES}
    assert error(planes, truth, method=method) < 0.7 * relative_error(planes["color"], truth)


@pytest.mark.parametrize("method", FITS)
@pytest.mark.parametrize("kind", [kind for kind, (_, useless) in DAMAGE.items() if useless])
def test_about_as_good_as_without_the_feature(kind, method):
    planes, truth = damaged(kind)
    useless = DAMAGE[kind][1]
    dropped = {n: p for n, p in planes.items() if n.removesuffix("_variance") not in useless}
    most = 1.4 if kind in MISLEADING else 1.1
    assert error(planes, truth, method=method) < most * error(dropped, truth, method=method)


@pytest.mark.parametrize("method", FITS)
@pytest.mark.parametrize("kind", [kind for kind, (_, useless) in DAMAGE.items() if not useless])
def test_the_same_told_in_another_way(kind, method):
    healthy, truth = sampled(*SIZE)
    assert error(damaged(kind)[0], truth, method=method) < 1.1 * error(healthy, truth, method=method)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("scale", [1e-9, 1e9])
def test_the_unit_of_depth_does_not_matter(scale, method):
    planes, _ = sampled(*SIZE)
    expected = denoise(Frame(**planes), method=method)
    scaled("depth", scale)(planes)
    np.testing.assert_allclose(denoise(Frame(**planes), method=method), expected, rtol=2e-3)


@pytest.mark.parametrize("method", FITS)
@pytest.mark.parametrize("value", [np.inf, 1e9, 1e30, 0.0, -1.0])
def test_what_stands_for_the_depth_of_the_sky_does_not_matter(value, method):
    planes, truth = sampled(*SIZE)
    before = error(planes, truth, method=method)
    sky = np.s_[:20, 60:]
    for name in ("albedo", "normal"):
        planes[name][sky] = 0
    planes["depth"][sky], planes["depth_variance"][sky] = value, 0
    assert error(planes, truth, method=method) < 1.5 * before


def on_one_plane():
    """A wall with stripes and the edge of a shadow: every normal is the same, and so every SSIM is 1."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    albedo = (0.5 + 0.3 * (x // 6 % 2))[..., None] * np.float32([1, 0.9, 0.8])
    truth = (albedo * np.where(x + y > 80, 0.3, 1.0)[..., None]).astype(np.float32)
    rng = np.random.default_rng(8)
    samples = truth * rng.gamma(4.0, 1 / 4.0, (16, *SIZE, 1))
    planes = {"albedo": albedo.astype(np.float32), "normal": np.zeros_like(truth) + np.float32([0, 0, 1])}
    planes |= {"color": samples.mean(0), "color_variance": samples.var(0, ddof=1) / 16}
    return {name: plane.astype(np.float32) for name, plane in planes.items()}, truth


@pytest.mark.parametrize("strength", [0.1, 0.75, 3.0])
def test_on_a_plane_eq_8_as_printed_is_a_box_blur(strength):
    """Whatever its strength: ln(1 / SSIM) is 0 and multiplies every distance. Worse than its input."""
    planes, truth = on_one_plane()
    given = {"method": "ssim-nlm", "stabilised": False, "average": "linear", "h_factor": strength}
    out = denoise(Frame(**planes), **given)
    np.testing.assert_allclose(out, oracle.box_mean(planes["color"], 3), rtol=1e-4)
    assert relative_error(out, truth) > 2 * relative_error(planes["color"], truth)


@pytest.mark.parametrize("method", ["ssim-nlm", *FITS])
def test_on_a_plane_our_methods_keep_shadows_and_stripes(method):
    planes, truth = on_one_plane()
    assert error(planes, truth, method=method) < 0.6 * relative_error(planes["color"], truth)


@pytest.mark.parametrize("stabilised", [True, False])
def test_patches_that_are_opposites(stabilised):
    """Where SSIM is below 0 the logarithm of eq. 8 has no value: SSIM is held at 1e-6."""
    planes, truth = damaged("normals in stripes")
    unit = oracle.normal_to_unit(oracle.box_mean(oracle.box_mean(planes["normal"], 1), 1))
    ssim = oracle.patch_ssim(unit, 3, 0, 2, 1e-4, 9e-4)
    assert (ssim == 1e-6).mean() > 0.5
    out = denoise(Frame(**planes), method="ssim-nlm", stabilised=stabilised)
    assert np.isfinite(out).all()
    if stabilised:  # as printed, pixels six apart and those above and below are averaged whatever their colours
        assert relative_error(out, truth) < 0.5 * relative_error(planes["color"], truth)


@pytest.mark.parametrize("method", METHODS)
def test_a_frame_without_noise_whose_variances_are_0(method):
    """Patches without any variance: a difference is a difference, and nothing is divided by 0."""
    planes, truth = sampled(*SIZE)
    for name in ("color", "color_a", "color_b"):
        planes[name][:] = truth
    planes["color_variance"][:] = 0
    for name in FEATURES:
        planes[f"{name}_variance"][:] = 0
    out = denoise(Frame(**planes), method=method)
    assert relative_error(out, truth) < (1e-6 if method in FITS else 2e-3)


@pytest.mark.parametrize("method", FITS)
@pytest.mark.parametrize("names", [(), ("albedo",), ("normal",), ("depth",), ("albedo", "depth")], ids="+".join)
def test_features_may_be_missing(names, method):
    planes, truth = sampled(*SIZE)
    given = {n: p for n, p in planes.items() if n.startswith("color") or n.removesuffix("_variance") in names}
    assert error(given, truth, method=method) < 0.6 * relative_error(planes["color"], truth)
