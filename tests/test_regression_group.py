"""The group schedule of the regression (GPUs) against the equations in float64 and against the tile schedule."""

from dataclasses import replace

import inputs
import numpy as np
import pyopencl as cl
import pytest
from test_regression import RIDGES, both_regressions, full_scene, noise
from test_stages import close
from transfer import to_array, to_planes

from mcdenoise_cl import Frame, denoise
from mcdenoise_cl.device import SCHEDULE_VARIABLE, context_for
from mcdenoise_cl.engine import Engine
from mcdenoise_cl.stages.regression import first_order_regression
from mcdenoise_cl.stages.terms import BLOCK_COLUMNS, BLOCK_ROWS, choose_terms

SIZES = [(1, 1), (1, 7), (5, 3), (33, 65)]
GROUPS = [(32, 8), (16, 4)]

#: Search radius, patch radius, stride, features, colours. Few, and used again below: a kernel with features takes
#: seconds to build for a CPU.
WINDOWS = [
    pytest.param(2, 1, 1, 7, 4, id="7 features"),
    pytest.param(4, 2, 1, 3, 3, id="3 features"),
    pytest.param(3, 0, 1, 0, 4, id="no feature"),
    pytest.param(3, 1, 3, 7, 4, id="stride 3"),
    pytest.param(1, 4, 1, 1, 3, id="1 feature, wide patch"),
    pytest.param(6, 1, 3, 7, 3, id="wide"),  # more rows of components than fit in local memory
    pytest.param(0, 1, 1, 0, 3, id="one pixel"),
]


@pytest.fixture(scope="module")
def engines(device, tiles_work):
    """An engine for each schedule; groups of the smaller size under "small". Where tiles do not work, nothing can be
    compared with them, and "tile" is a group engine: what is left is the comparison with the equations."""
    found = {}
    for schedule in ("tile", "group"):
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv(SCHEDULE_VARIABLE, schedule)
            found[schedule] = Engine(cl.CommandQueue(context_for(device), device))
    if not tiles_work:
        found["tile"] = found["group"]
    small = Engine(found["group"].queue)
    small.shape = replace(found["group"].shape, group=GROUPS[1])
    return found | {"small": small}


def inputs_of(kind, height, width, features, colors):
    """Colour, its variance, features and theirs, and what is fitted; as keywords of `both_regressions`."""
    color = np.minimum(inputs.planes(kind, height, width, 3), 20)
    spread = 20 * noise(color)  # so that a window has many weights above 0
    difference = 0.1 * (inputs.planes("uniform", height, width, 1, seed=5) - 0.5)
    scene = inputs.features(height, width, seed=3)
    given = np.concatenate([scene["albedo"], scene["normal"], np.atleast_3d(scene["depth"]) / 4], axis=-1)
    given = given[..., :features] if features else None
    return {
        "color": color,
        "spread": spread,
        "features": given,
        "left": None if given is None else (0.01 * np.abs(given)).astype(np.float32),
        "fitted": np.concatenate([color, difference], axis=-1)[..., :colors],
    }


def fits_of(engine, planes, *, with_inner=True, search, patch, stride, bandwidth, ridges):
    """What `both_regressions` gives for a device, alone."""
    terms = None
    if planes["features"] is not None:
        features, left = (to_planes(engine, planes[name]) for name in ("features", "left"))
        terms = choose_terms(engine, features, left, search * stride)
    fits = first_order_regression(
        engine,
        to_planes(engine, planes["color"]),
        to_planes(engine, planes["spread"].sum(-1)),
        terms,
        to_planes(engine, planes["fitted"]),
        search_radius=search,
        patch_radius=patch,
        stride=stride,
        bandwidth=bandwidth,
        with_inner=with_inner,
        **ridges,
    )
    return [to_array(engine, fit) for fit in fits]


def window_of(search, patch, stride, ridges=RIDGES):
    return {"search": search, "patch": patch, "stride": stride, "bandwidth": 0.8, "ridges": ridges}


def test_a_group_lies_in_one_block(engines):
    for columns, rows in [*GROUPS, engines["group"].shape.group]:
        assert BLOCK_COLUMNS % columns == 0 and BLOCK_ROWS % rows == 0


@pytest.mark.parametrize(("height", "width"), SIZES)
@pytest.mark.parametrize("kind", ["uniform", "hdr", "step"])
@pytest.mark.parametrize(("search", "patch", "stride", "features", "colors"), WINDOWS)
def test_equals_the_equations_and_the_tile_schedule(
    engines, kind, height, width, search, patch, stride, features, colors
):
    planes, window = inputs_of(kind, height, width, features, colors), window_of(search, patch, stride)
    tile, expected = both_regressions(engines["tile"], **planes, **window)
    for name in ("group", "small"):
        fits = fits_of(engines[name], planes, **window)
        assert len(fits) == 2  # of the whole window and its middle
        for fit, other, exact in zip(fits, tile, expected, strict=True):
            # The normal equations are solved in float32; their condition multiplies its rounding. The components of a
            # block are the same in both schedules, and so is their error.
            close(fit, other, tolerance=1e-4)
            close(fit, exact, tolerance=3e-4)


@pytest.mark.parametrize("name", ["group", "small"])
def test_the_window_is_fitted_alike_with_and_without_its_middle(engines, name):
    planes, window = inputs_of("textured", 33, 65, 7, 4), window_of(3, 1, 3)
    both, (alone,) = (fits_of(engines[name], planes, **window, with_inner=inner) for inner in (True, False))
    close(alone, both[0], tolerance=2e-5)


@pytest.mark.parametrize("name", ["group", "small"])
def test_features_that_carry_nothing_change_nothing(engines, name):
    """Constant or pure noise everywhere, or in the left blocks only: 64x24 pixels are 2x3 blocks."""
    rng = np.random.default_rng(0)
    planes, window = inputs_of("textured", 24, 64, 7, 4), window_of(2, 1, 1)
    features, left = planes["features"].copy(), np.zeros_like(planes["left"])
    features[..., 0] = 0.7
    features[..., 2] = 0.1 * rng.standard_normal((24, 64))
    left[..., 2] = 0.01
    features[:, :40, 3] = 0.0
    planes |= {"features": features, "left": left}
    tile, expected = both_regressions(engines["tile"], **planes, **window)
    for one, other, exact in zip(fits_of(engines[name], planes, **window), tile, expected, strict=True):
        close(one, exact, tolerance=1e-4)
        close(other, exact, tolerance=3e-4)  # terms about the block's mean round more than those about the pixel

    features[..., [1, 3, 4, 5, 6]] = 0.2
    idle = fits_of(engines[name], planes, **window)
    without = fits_of(engines[name], planes | {"features": None}, **window)
    for one, other in zip(idle, without, strict=True):
        close(one, other, tolerance=1e-6)


@pytest.mark.parametrize("offset", [0.0, 0.9])
def test_a_texture_of_little_contrast_is_told_apart_beside_a_strong_edge(engines, offset):
    rng = np.random.default_rng(1)
    features = np.repeat((0.02 + 0.01 * rng.random((24, 40, 1))), 3, axis=-1).astype(np.float32)
    features[:, 30:] += np.float32(offset)
    color = (features * 5).astype(np.float32)
    planes = {"color": color, "spread": np.full_like(color, 0.01), "fitted": color}
    planes |= {"features": features, "left": 0 * features}
    window = window_of(4, 2, 1, {"ridge": 1e-3, "noise_ridge": 0.0, "position_ridge": 0.1})
    tile, _ = both_regressions(engines["tile"], **planes, **window)
    np.testing.assert_allclose(fits_of(engines["group"], planes, **window)[0], tile[0], rtol=2e-4)


@pytest.mark.parametrize("method", ["regression", "auto"])
@pytest.mark.parametrize(("height", "width"), [(1, 7), (33, 65)])
@pytest.mark.parametrize("names", ["all", "color alone"])
def test_whole_methods_are_the_same_in_both_schedules(monkeypatch, can_be_right, method, height, width, names):
    can_be_right("tile")
    scene = full_scene(height, width)
    frame = Frame(**scene) if names == "all" else Frame(scene["color"])
    images = []
    for schedule in ("tile", "group"):
        monkeypatch.setenv(SCHEDULE_VARIABLE, schedule)
        images.append(denoise(frame, method=method))
    close(images[1], images[0], tolerance=1e-4)
