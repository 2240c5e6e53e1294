"""NaN and infinity in any plane: none comes out, and none does more than the mean of its neighbours would."""

import inputs
import numpy as np
import oracle
import oracle_regression
import pyopencl.array as cl_array
import pytest
from sampled import FEATURES, relative_error, sampled
from test_stages import close
from transfer import scalars, to_array, to_planes

from mcdenoise_cl import Denoiser, Frame, FrameError, denoise, methods
from mcdenoise_cl.stages import door, exposure, variance
from mcdenoise_cl.stages.variance import UNKNOWN

METHODS = [method.name for method in methods()]
SIZE = (32, 56)
PLANES = tuple(sampled(*SIZE)[0])
#: What a bad sample of the colour is seen in.
SAMPLES = ("color", "color_a", "color_variance")
PATTERNS = ("pixel", "one percent", "row", "half")


def pattern(name):
    hit = np.zeros(SIZE, bool)
    if name == "one percent":
        return np.random.default_rng(3).random(SIZE) < 0.01
    hit[{"pixel": np.s_[20, 30], "row": np.s_[25], "half": np.s_[:, 30:]}[name]] = True
    return hit


def with_value(scene, names, where, value):
    planes = {name: plane.copy() for name, plane in scene.items()}
    for name in names:
        planes[name][where] = value
    return planes


def as_the_door_fills(planes):
    """Every plane with its bad pixels replaced, as the equations have it."""
    return {name: oracle.fill_nonfinite(plane)[0].astype(np.float32) for name, plane in planes.items()}


#: Each method with each of the planes that it looks at, and with all that a bad sample of the colour is seen in.
USED = [
    pytest.param(method.name, names, id=f"{method.name} {'+'.join(names)}")
    for method in methods()
    for names in (SAMPLES, *((name,) for name in method.takes(PLANES)))
]


@pytest.mark.parametrize(("method", "names"), USED)
@pytest.mark.parametrize("kind", PATTERNS)
def test_the_result_is_that_of_the_neighbours_mean(method, names, kind):
    scene, _ = sampled(*SIZE)
    where = pattern(kind)
    value = {"pixel": np.nan, "one percent": np.inf, "row": -np.inf, "half": np.nan}[kind]
    planes = with_value(scene, names, where, value)
    denoiser = Denoiser(*SIZE, method=method)
    out = denoiser(Frame(**planes))
    assert np.isfinite(out).all()
    used = denoiser.method.takes(planes)
    assert denoiser.report.replaced == {name: where.sum() for name in used if name in names}
    filled = as_the_door_fills(planes)
    if kind == "half" and "color_variance" in names:  # where all around is lost, too: as if it were said to be unknown
        filled["color_variance"][:, 30 + 8 :] = UNKNOWN
    close(out, denoise(Frame(**filled), method=method), tolerance=1e-4)


#: Pixels from a bad one to the last that it can change, in the colours and in the features, for default parameters and
#: what is global (exposure, noise level, thresholds) given: windows, patches and what is smoothed before and after. A
#: regression decides in blocks of 32 columns which features it uses, and `auto` fits the result of one once more.
FIXED = {
    "nlm": ({"h": 0.1}, 5, 0),
    "ssim-nlm": ({"h": 0.1, "canny_low": 0.3, "canny_high": 0.3}, 5, 16),
    "regression": ({"outliers": False}, 14, 45),
    "guided": ({"outliers": False}, 17, 17),
    "auto": ({"outliers": False}, 70, 90),
}


@pytest.fixture(scope="module")
def wide_scene():
    return sampled(40, 240)[0]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("names", [SAMPLES, ("albedo", "albedo_variance"), ("normal",)], ids="+".join)
def test_a_bad_pixel_changes_nothing_outside_its_window(wide_scene, method, names):
    given, reach_of_color, reach_of_features = FIXED[method]
    given = {"method": method, "exposure": 1.0, **given}
    reach = reach_of_color if "color" in names else reach_of_features
    before = denoise(Frame(**wide_scene), **given)
    after = denoise(Frame(**with_value(wide_scene, names, np.s_[20, 100], np.nan)), **given)
    beyond = np.abs(np.arange(240) - 100) > reach
    np.testing.assert_array_equal(after[:, beyond], before[:, beyond])
    if names != ("albedo", "albedo_variance"):  # an albedo matters to `ssim-nlm` only at edges
        assert (after != before).any() == ("color" in names or method != "nlm")


@pytest.mark.parametrize("method", ["regression", "guided", "auto"])
def test_a_bad_pixel_changes_nothing_beyond_where_light_is_spread(wide_scene, method):
    """Three boxes of a radius of 5, and one pixel for who is an outlier."""
    _, reach, _ = FIXED[method]
    given = {"method": method, "exposure": 1.0, "spread_radius": 5}
    before = denoise(Frame(**wide_scene), **given)
    after = denoise(Frame(**with_value(wide_scene, SAMPLES, np.s_[20, 100], np.inf)), **given)
    beyond = (
        np.abs(np.arange(240) - 100) > reach + 1 + 2 * 3 * 5
    )  # removed light, and the brightness of what it is put on
    np.testing.assert_array_equal(after[:, beyond], before[:, beyond])


@pytest.mark.parametrize("method", METHODS)
def test_far_away_a_bad_pixel_changes_the_exposure_alone(wide_scene, method):
    before = denoise(Frame(**wide_scene), method=method)
    after = denoise(Frame(**with_value(wide_scene, SAMPLES, np.s_[20, 20], -np.inf)), method=method)
    np.testing.assert_allclose(after[:, 200:], before[:, 200:], rtol=2e-3)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", [name for name in PLANES if name != "color"])
def test_a_plane_without_any_finite_pixel_is_no_reason_to_fail(method, name):
    scene, truth = sampled(*SIZE)
    out = denoise(Frame(**with_value(scene, [name], ..., np.inf)), method=method)
    assert np.isfinite(out).all()
    # Black for one of two halves makes the other look like noise, and all that is left is the input.
    most = 0.95 if method == "auto" and name in ("color_a", "color_b") else 0.6
    assert relative_error(out, truth) < most * relative_error(scene["color"], truth)


@pytest.mark.parametrize("method", METHODS)
def test_a_colour_without_any_finite_pixel_is_an_error(method):
    scene, _ = sampled(*SIZE)
    with pytest.raises(FrameError, match="color has no finite pixel: there is nothing to denoise"):
        denoise(Frame(**with_value(scene, ["color"], ..., np.nan)), method=method)


@pytest.mark.parametrize("method", METHODS)
def test_on_the_device_such_a_frame_comes_out_black(engine, method):
    planes = with_value(sampled(*SIZE)[0], ["color"], ..., np.nan)
    on_device = {name: cl_array.to_device(engine.queue, plane) for name, plane in planes.items()}
    denoiser = Denoiser(*SIZE, method=method, queue=engine.queue)
    np.testing.assert_array_equal(denoiser(Frame(**on_device)).get(), np.zeros((*SIZE, 3)))
    assert denoiser.report.replaced["color"] == SIZE[0] * SIZE[1]


@pytest.mark.parametrize("method", ["regression", "guided", "auto"])
def test_noise_is_found_where_its_variance_is_lost(method):
    """Half the frame without a variance that is known: that half is filtered, and not taken for free of noise."""
    scene, truth = sampled(*SIZE)
    lost = pattern("half")
    out = denoise(Frame(**with_value(scene, ["color_variance"], lost, np.nan)), method=method)
    assert relative_error(out, truth, lost) < 0.5 * relative_error(scene["color"], truth, lost)


def test_a_variance_below_0_comes_from_the_image(engine):
    given, color = inputs.planes("uniform", 31, 64, 3) - 0.3, inputs.planes("textured", 31, 64, 3)
    factor = engine.constant([0.5])
    out = variance.known_variance(engine, to_planes(engine, given), to_planes(engine, color), factor)
    close(to_array(engine, out), np.where(given >= 0, 0.25 * given, oracle_regression.variance_from_image(color)))


def test_the_door_says_where_all_around_is_lost(engine):
    image = np.full((30, 40, 3), 7.0, np.float32)
    image[:, 10:] = np.inf
    source, _alive = door.upload(engine, image)
    out = to_array(engine, door.door(engine, source, 30, 40, engine.zeros(1), lost=-1.0))
    assert (out[:, :18] == 7).all() and (out[:, 18:] == -1).all()


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("value", [1e10, 1e19, 1e20, 1e30, np.finfo("f4").max, -1e20, -np.finfo("f4").max])
def test_a_huge_value_makes_no_other(method, value):
    scene, _ = sampled(*SIZE)
    planes = with_value(scene, ["color", "color_a"], np.s_[20, 30], value)
    planes["color_variance"][20, 30] = min(abs(float(value)) ** 2, float(np.finfo("f4").max))
    for names in (PLANES, ("color", *FEATURES)):
        assert np.isfinite(denoise(Frame(**{name: planes[name] for name in names}), method=method)).all()


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("scale", [1e-42, 1e-38, 1e-30, 1e18, 1e36])
def test_no_scale_of_the_light_is_too_small_or_too_large(method, scale):
    scene, truth = sampled(*SIZE)
    planes = {"color": (scale * scene["color"].astype(np.float64)).astype(np.float32)}
    planes |= {name: scene[name] for name in FEATURES}
    out = denoise(Frame(**planes), method=method).astype(np.float64) / scale
    assert np.isfinite(out).all()
    if scale >= 1e-30:  # what is less is left alone
        assert relative_error(out, truth) < 0.7 * relative_error(scene["color"], truth)


def test_exposure_has_an_end(engine):
    dark = np.full((5, 6, 3), 1e-41, np.float32)
    one_pixel = np.zeros_like(dark)
    one_pixel[2, 3] = 1e-44
    for image in (dark, one_pixel):
        assert scalars(engine, exposure.auto_exposure(engine, to_planes(engine, image)))[0] == np.float32(1e30)


@pytest.mark.parametrize("method", METHODS)
def test_light_below_0_stays(method):
    """The negative lobes of a reconstruction filter, here a whole stripe of them, filtered like any other light."""
    scene, truth = sampled(*SIZE)
    truth = truth.copy()
    dark = np.s_[:, 24:32]
    rng = np.random.default_rng(6)
    halves = {name: scene[name] for name in ("color_a", "color_b")}
    truth[dark] = -0.2
    for half in halves.values():
        half[dark] = -0.2 + 0.04 * rng.standard_normal((SIZE[0], 8, 1))
    scene["color"] = (halves["color_a"] + halves["color_b"]) / 2
    scene["color_variance"][dark] = 0.04**2 / 2
    scene["albedo"][dark] = 0.0
    out = denoise(Frame(**scene), method=method)
    middle = np.s_[:, 26:30]
    assert out[middle].max() < -0.05
    np.testing.assert_allclose(out[middle].mean(), -0.2, rtol=0.1)
    assert np.std(out[middle]) < np.std(scene["color"][middle])
