"""The group schedule, forced on any device: as the equations have it, and as the tile schedule does it."""

from dataclasses import replace

import inputs
import numpy as np
import oracle
import oracle_regression
import pyopencl as cl
import pytest
from test_nlm import C1, C2, prepare, unit_image
from test_stages import close
from transfer import to_array, to_planes

from mcdenoise_cl.device import SCHEDULE_VARIABLE, SCHEDULES, context_for
from mcdenoise_cl.engine import Engine
from mcdenoise_cl.errors import DeviceError
from mcdenoise_cl.stages import nlm as nlm_stage
from mcdenoise_cl.stages.box import box_mean
from mcdenoise_cl.stages.group import LOCAL_BYTES, copy_defines, patch_defines
from mcdenoise_cl.stages.nlm import CENTERS, SsimTerm, nlm
from mcdenoise_cl.stages.pad import pad
from mcdenoise_cl.stages.prefilter import prefilter

SIZES = [(1, 1), (1, 7), (5, 3), (33, 65)]
SMALL_GROUP = (16, 4)  # what devices get that have no room for 32 x 8


@pytest.fixture(scope="module")
def engines(device, tiles_work):
    """An engine of each schedule, and "small", of the group schedule with a group of SMALL_GROUP. Where tiles do not
    work, as upstream/rusticl_loops.py shows, "tile" is a group engine: what is left are the equations and "small"."""
    made = {}
    for schedule in SCHEDULES:
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv(SCHEDULE_VARIABLE, schedule)
            made[schedule] = Engine(cl.CommandQueue(context_for(device), device))
    assert all(engine.shape.schedule == schedule for schedule, engine in made.items())
    if not tiles_work:
        made["tile"] = made["group"]
    made["small"] = Engine(made["group"].queue)
    made["small"].shape = replace(made["group"].shape, group=SMALL_GROUP)
    return made


@pytest.fixture(params=["global", "copy"])
def tone_from(request, monkeypatch):
    """Where nlm reads the other patch: without this, the device decides."""
    forced = (lambda *a: {"COPY_RADIUS": a[-1]}) if request.param == "copy" else (lambda *_: {})
    monkeypatch.setattr(nlm_stage, "copy_defines", forced)


def run_nlm(engine, color, tone, search, patch, center="one", level=0.2, ssim=None):
    out = nlm(
        engine,
        pad(engine, to_planes(engine, tone), search + patch),
        pad(engine, to_planes(engine, color), search),
        search_radius=search,
        patch_radius=patch,
        patch_sigma=max(patch / 2, 0.3),
        noise_level=engine.constant([level]),
        h_factor=1.0,
        center=center,
        ssim=ssim,
    )
    return to_array(engine, out)


def run_ssim_nlm(engine, color, tone, unit_normal, search, patch, stabiliser, center="one"):
    unit, stats = prepare(engine, unit_normal, search, patch)
    return run_nlm(engine, color, tone, search, patch, center, ssim=SsimTerm(unit, stats, C1, C2, stabiliser))


@pytest.mark.parametrize(("height", "width"), SIZES)
@pytest.mark.parametrize("kind", inputs.KINDS)
@pytest.mark.parametrize(("search", "patch"), [(0, 0), (0, 2), (3, 2), (2, 5)])
@pytest.mark.parametrize("center", CENTERS)
def test_nlm(engines, tone_from, height, width, kind, search, patch, center):
    color = inputs.planes(kind, height, width, 3)
    tone = oracle.tonemap(color, 0.5).astype(np.float32)
    actual, other = (run_nlm(engines[s], color, tone, search, patch, center) for s in ("group", "tile"))
    windows = {"search_radius": search, "patch_radius": patch, "patch_sigma": max(patch / 2, 0.3)}
    tolerance = 1e-5 if center == "one" else 3e-5
    close(actual, oracle.nlm(color, tone, **windows, h=np.float32(0.2), center=center), tolerance=tolerance)
    close(actual, other, tolerance=tolerance)


@pytest.mark.parametrize(("search", "patch"), [(3, 2), (10, 3)])
def test_nlm_whatever_the_group(engines, tone_from, search, patch):
    color = inputs.features(70, 67)["color"]
    tone = oracle.tonemap(color, 0.5).astype(np.float32)
    tile, group, small = (run_nlm(engines[s], color, tone, search, patch) for s in ("tile", "group", "small"))
    close(group, tile)
    close(small, tile)


@pytest.mark.parametrize(("patch", "widest"), [(0, 51), (5, 31), (16, 20)])
def test_loops_that_a_device_may_end_early(engines, monkeypatch, patch, widest):
    """The widest windows that are right on a device with 65535 turns, and an error for the next."""
    monkeypatch.setattr(nlm_stage, "most_turns", lambda device: 65535)
    color = inputs.features(9, 11)["color"]
    windows = {"search_radius": widest, "patch_radius": patch, "patch_sigma": max(patch / 2, 0.3)}
    close(
        run_nlm(engines["group"], color, color, widest, patch),
        oracle.nlm(color, color, **windows, h=np.float32(0.2)),
    )
    with pytest.raises(DeviceError, match=f"ends long loops early.* {widest + 1} with .* {patch} may"):
        run_nlm(engines["group"], color, color, widest + 1, patch)


def test_loops_of_ssim_nlm_that_a_device_may_end_early(engines, monkeypatch):
    monkeypatch.setattr(nlm_stage, "most_turns", lambda device: 65535)
    scene = inputs.features(9, 11)
    color, unit = scene["color"], ((scene["normal"] + 1) / 2).astype(np.float32)
    windows = {"search_radius": 23, "patch_radius": 2, "patch_sigma": 1.0}
    expected = oracle.ssim_nlm(color, color, unit, **windows, c1=C1, c2=C2, stabiliser=0.1, h=np.float32(0.2))
    close(run_ssim_nlm(engines["group"], color, color, unit, 23, 2, 0.1), expected)
    with pytest.raises(DeviceError, match="ends long loops early"):
        run_ssim_nlm(engines["group"], color, color, unit, 24, 2, 0.1)


@pytest.mark.parametrize("outputs", [1, 2, 3])
def test_nlm_with_other_numbers_of_outputs(engines, monkeypatch, outputs):
    color = inputs.features(70, 67)["color"]
    tile = run_nlm(engines["tile"], color, color, 2, 1)
    monkeypatch.setattr(nlm_stage, "GROUP_OUTPUTS", (outputs, outputs))
    close(run_nlm(engines["group"], color, color, 2, 1), tile)


@pytest.mark.parametrize(("height", "width"), SIZES)
@pytest.mark.parametrize("kind", inputs.KINDS)
@pytest.mark.parametrize("normals", ["features", "step", "uniform"])
@pytest.mark.parametrize(
    ("search", "patch", "stabiliser", "center"),
    [(1, 0, 0.1, "one"), (2, 1, 1.0, "largest"), (3, 2, 0.0, "one"), (3, 2, 0.1, "one")],
)
def test_ssim_nlm(engines, height, width, kind, normals, search, patch, stabiliser, center):
    color = inputs.planes(kind, height, width, 3)
    tone = oracle.tonemap(color, 0.5).astype(np.float32)
    if normals == "features":
        unit = ((inputs.features(height, width, seed=1)["normal"] + 1) / 2).astype(np.float32)
    else:
        unit = unit_image(normals, height, width)
    arguments = color, tone, unit, search, patch, stabiliser, center
    actual, other = (run_ssim_nlm(engines[s], *arguments) for s in ("group", "tile"))
    windows = {"search_radius": search, "patch_radius": patch, "patch_sigma": max(patch / 2, 0.3)}
    terms = {"c1": C1, "c2": C2, "stabiliser": stabiliser}
    expected = oracle.ssim_nlm(color, tone, unit, **windows, **terms, h=np.float32(0.2), center=center)
    tolerance = 1e-5 if center == "one" else 3e-5
    close(actual, expected, tolerance=tolerance)
    close(actual, other, tolerance=tolerance)


def test_ssim_nlm_with_a_copy_and_a_small_group(engines, tone_from):
    scene = inputs.features(70, 67)
    tone = oracle.tonemap(scene["color"], 0.5).astype(np.float32)
    arguments = scene["color"], tone, ((scene["normal"] + 1) / 2).astype(np.float32), 3, 2, 0.1
    tile, group, small = (run_ssim_nlm(engines[s], *arguments) for s in ("tile", "group", "small"))
    close(group, tile)
    close(small, tile)


def test_a_constant_stays_itself_to_the_last_bit(engines):
    color = inputs.planes("constant", 33, 65, 3)
    unit = np.full_like(color, np.float32([0.5, 0.2, 0.9]))
    for group in ("group", "small"):
        np.testing.assert_array_equal(run_nlm(engines[group], color, color, 3, 2), color)
        np.testing.assert_array_equal(run_ssim_nlm(engines[group], color, color, unit, 3, 2, 0.0), color)


def test_local_memory_is_shared_out(engines):
    engine = engines["group"]
    columns, rows = engine.shape.group
    for radius in (0, 1, 2, 8, 16):
        n = patch_defines(engine, radius, 4)["OUTPUTS"]
        assert n == 4 or radius > 8
        assert 8 * (columns + 2 * radius) * (rows * n + 2 * radius) <= LOCAL_BYTES
    assert copy_defines(engine, patch_defines(engine, 2, 4), 40) == {}  # no copy of that size fits


@pytest.mark.parametrize(("height", "width"), [*SIZES, (600, 5), (5, 600)])
@pytest.mark.parametrize("kind", inputs.KINDS)
@pytest.mark.parametrize("radius", [0, 1, 4, 50])
def test_box_mean(engines, height, width, kind, radius):
    image = inputs.planes(kind, height, width, 3)
    tile, group, small = (
        to_array(engines[s], box_mean(engines[s], to_planes(engines[s], image), radius))
        for s in ("tile", "group", "small")
    )
    expected = oracle.box_mean(image, radius)
    for actual in (group, small):
        close(actual, expected)
        close(actual, tile)


def test_box_mean_forgets_a_bright_light(engines):
    image = inputs.planes("uniform", 300, 40)
    image[100:103, 10:12] = 1e7
    engine = engines["group"]
    actual, expected = to_array(engine, box_mean(engine, to_planes(engine, image), 3)), oracle.box_mean(image, 3)
    dark = expected < 2
    assert dark.mean() > 0.9
    np.testing.assert_allclose(actual[dark], expected[dark], rtol=1e-5)


@pytest.mark.parametrize(("height", "width"), SIZES)
@pytest.mark.parametrize("plane", ["normal", "depth", "step"])
def test_prefilter(engines, height, width, plane):
    scene = inputs.features(height, width, seed=2)
    feature = inputs.planes("step", height, width, 3) if plane == "step" else scene[plane]
    spread = np.full_like(feature, 0.003) * (1 + np.random.default_rng(0).random(feature.shape).astype("f4"))
    tile, group, small = (
        [
            to_array(engines[s], out)
            for out in prefilter(engines[s], *(to_planes(engines[s], p) for p in (feature, spread)))
        ]
        for s in ("tile", "group", "small")
    )
    expected = oracle_regression.prefilter(feature, spread)
    for actual in (group, small):
        for mine, other, theory in zip(actual, tile, expected, strict=True):
            close(mine, theory, tolerance=2e-5)
            close(mine, other, tolerance=2e-5)
