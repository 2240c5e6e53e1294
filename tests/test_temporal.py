"""Neighbouring frames: the stage against its equations in float64, and what must and must not be merged."""

from dataclasses import replace

import numpy as np
import oracle_temporal as theory
import pyopencl.array as cl_array
import pytest
from moving import frame_at, planes_at
from test_stages import close
from transfer import to_array, to_planes

from mcdenoise_cl import Denoiser, Frame, cli, denoise, read_exr, write_exr
from mcdenoise_cl import neighbours as module
from mcdenoise_cl.errors import FrameError
from mcdenoise_cl.frame import PLANES
from mcdenoise_cl.neighbours import Merged, merge
from mcdenoise_cl.stages import temporal
from mcdenoise_cl.stages.door import door, upload
from mcdenoise_cl.stages.source import Source

SIZES = [(1, 1), (1, 9), (7, 1), (3, 2), (13, 17), (24, 40)]
FEATURES = ("albedo", "normal", "depth")
FULL = (*FEATURES, *(f"{name}_variance" for name in FEATURES), "color_variance", "color_a", "color_b")
SETS = [FULL, FEATURES, ("color_a", "color_b"), ("depth", "depth_variance", "color_variance"), ()]
by_names = pytest.mark.parametrize("names", SETS, ids=lambda names: "+".join(names) or "color alone")
SIZE = (24, 40)


def some(planes, names):
    return {name: plane for name, plane in planes.items() if name in ("color", *names)}


def merged(engine, frame, neighbours, names=None, rows=None):
    """What `merge` makes of dicts of planes: the planes, and the mean of the weights."""
    height, width = frame["color"].shape[:2]
    alive, sources = [], []
    for planes in (frame, *neighbours):
        arrays = {}
        for name, plane in planes.items():
            arrays[name], host = upload(engine, plane)
            alive.append(host)
        bad = engine.zeros(len(PLANES) + 1)
        sources.append(Source(engine, arrays, height, width, bad, rows or height))
    found: Merged = merge(engine, sources[0], sources[1:], names or list(frame))
    unused = engine.zeros(1)
    result = {
        name: to_array(engine, door(engine, array, height, width, unused)) for name, array in found.arrays.items()
    }
    return result, found.mean(engine)


@by_names
@pytest.mark.parametrize(("height", "width"), SIZES)
def test_the_whole_stage(engine, height, width, names):
    frame, *neighbours = (
        some(planes_at(height, width, move, seed=seed)[0], names) for seed, move in enumerate([(0, 0), (2, -1), (0, 1)])
    )
    frame["color"][height // 2, width // 2] *= 30  # an outlier in each
    neighbours[0]["color"][height // 3, width // 3] *= 30
    exposure = theory.oracle.auto_exposure(frame["color"])
    looks = [theory.look(planes, exposure) for planes in (frame, *neighbours)]
    for look in looks[1:]:
        costs = theory.match_costs(looks[0][1], look[1], look[0])
        assert theory.find_motion(costs, height, width)[1].min() > 1e-5  # float32 decides as float64 does
    expected, total = theory.merge(frame, neighbours, list(frame))
    found, mean = merged(engine, frame, neighbours)
    assert mean == pytest.approx(total.mean(), rel=1e-3)
    for name, plane in expected.items():
        close(found[name], plane, tolerance=2e-4)


@pytest.mark.parametrize("names", [FEATURES, ()], ids=["features", "colour"])
def test_what_is_searched(engine, names):
    """Costs, and the motion that follows from them."""
    own, other = (some(planes_at(29, 43, move, seed=seed)[0], names) for seed, move in enumerate([(0, 0), (3, -2)]))
    looks = [theory.look(planes, 1.0) for planes in (own, other)]
    on_device = []
    for planes, (groups, _, light, factor) in zip((own, other), looks, strict=True):
        color, variance = light[..., :3], theory.oracle_regression.variance_from_image(planes["color"])
        variance = variance * factor[..., None] ** 2
        features = {name: (to_planes(engine, planes[name]), None) for name in groups if name in FEATURES}
        arguments = (to_planes(engine, image) for image in (color, variance, factor))
        on_device.append(temporal.look_at(engine, features, *arguments, guessed=True))
    expected = theory.match_costs(looks[0][1], looks[1][1], looks[0][0])
    costs = temporal.match_costs(engine, *on_device)
    close(to_array(engine, costs), expected, tolerance=1e-4)
    motion, margin = theory.find_motion(expected, 29, 43)
    found = to_array(engine, temporal.find_motion(engine, *on_device))
    sure = margin > 1e-4
    assert sure.mean() > 0.9
    close(found[sure, :2], motion[sure], tolerance=1e-3)
    least = theory.offset_costs(expected, 29, 43).min((1, 2)).reshape(sure.shape)
    close(found[..., 2], least, tolerance=1e-4)
    if names:
        assert (np.rint(found[..., :2]) == (-3, 2)).all(-1).mean() > 0.6  # most blocks show which way


def test_motion_vectors_are_followed_to_a_part_of_a_pixel(engine):
    frame, neighbour = (planes_at(*SIZE, move, seed=seed)[0] for seed, move in enumerate([(0, 0), (6, -5)]))
    rng = np.random.default_rng(0)
    neighbour["motion"] = ((-6, 5) + 0.3 * rng.standard_normal((*SIZE, 2))).astype(np.float32)
    neighbour["motion"][3, 4] = (0, 70)  # further than is followed
    neighbour["motion"][5, 6] = (-90, 0)  # out of the picture
    expected, total = theory.merge(frame, [neighbour], list(frame))
    found, mean = merged(engine, frame, [neighbour], list(frame))
    assert mean == pytest.approx(total.mean(), rel=1e-4) and total[3, 4] == total[5, 6] == 1
    for name, plane in expected.items():
        close(found[name], plane, tolerance=2e-4)


def test_vectors_that_fit_worse_than_the_search_are_replaced(engine):
    """In blocks: on the left they are right, in the middle anything, on the right they lead out of the picture."""
    frame, neighbour = (
        some(planes_at(29, 43, move, seed=seed)[0], FULL) for seed, move in enumerate([(0, 0), (3, -2)])
    )
    given = np.empty((29, 43, 2), np.float32)
    given[:, :16], given[:, 32:] = (-3, 2), (90, 0)
    given[:, 16:32] = np.random.default_rng(0).uniform(-9, 9, (29, 16, 2))
    looks = [theory.look(planes, 1.0) for planes in (frame, neighbour)]
    expected, margin = theory.choose_motion(looks[0][1], looks[1][1], looks[0][0], given)
    assert abs(margin[margin != 0]).min() > 1e-2  # 0 where none stays in the picture
    found, mean = merged(engine, frame, [neighbour | {"motion": given}], ["color"])
    theirs, total = theory.merge(frame, [neighbour | {"motion": given}], ["color"])
    assert mean == pytest.approx(total.mean(), rel=1e-4)
    close(found["color"], theirs["color"], tolerance=2e-4)
    np.testing.assert_array_equal(expected[:, :8], given[:, :8])
    np.testing.assert_array_equal(expected[:, 40:], given[:, 40:])
    assert (np.rint(expected[:, 16:32]) == (-3, 2)).all(-1).mean() > 0.6


def error(image, truth):
    return float(((image - truth) ** 2 / (truth**2 + 0.01)).mean())


@pytest.mark.parametrize("move", [(0, 0), (1, 0), (-2, 1)], ids=["still", "slow", "moving"])
@by_names
def test_the_same_room_again_takes_noise_away(engine, names, move):
    """Two neighbours that show the same take more than a third of the error of the input away; it could be two thirds.
    The variance that is left tells how large it is."""
    frame, truth = planes_at(48, 64)
    near = [some(planes_at(48, 64, at, seed=seed)[0], names) for seed, at in ((1, move), (2, (-move[0], -move[1])))]
    found, mean = merged(engine, some(frame, names), near)
    assert 1.8 < mean <= 3
    assert error(found["color"], truth) < 0.65 * error(frame["color"], truth)
    if "color_variance" in names:
        squares = ((found["color"] - truth) ** 2).mean()
        assert 0.5 < found["color_variance"].mean() / squares < 1.3
        halves = ((found["color_a"] - found["color_b"]) ** 2 / 4).mean() if "color_a" in names else squares
        assert 0.6 < halves / squares < 1.5


@by_names
@pytest.mark.parametrize("light", [0.2, 0.6, 1.5, 4.0])
def test_a_light_that_is_switched_on_is_not_merged(engine, names, light):
    """Nor one that is turned up by half: what it adds is less than the noise of a pixel, but all pixels share it."""
    frame, truth = planes_at(48, 64)
    neighbour = some(planes_at(48, 64, seed=1, light=light)[0], names)
    found, mean = merged(engine, some(frame, names), [neighbour])
    assert mean < (1.1 if light in (0.2, 4.0) else 1.25)
    assert error(found["color"], truth) < 1.05 * error(frame["color"], truth)


@by_names
@pytest.mark.parametrize("move", [5, 7, 12, 20])
def test_what_moves_too_far_to_be_followed_does_no_harm(engine, names, move):
    """Whatever is merged by mistake costs less than the noise that merging takes away."""
    frame, truth = planes_at(48, 64, margin=24)
    near = [some(planes_at(48, 64, (k * move, 0), seed=2 + k, margin=24)[0], names) for k in (-1, 1)]
    found, _ = merged(engine, some(frame, names), near)
    assert error(found["color"], truth) < error(frame["color"], truth)


def lamp(left, seed, spp, height=32, width=48):
    """A lamp a hundred times as bright as the wall behind it, whose edges have parts of pixels: planes, and the truth.

    Each sample sees the one or the other, so that pixels of the edge are noisy in every plane and those beside it not.
    """
    rng = np.random.default_rng([seed, spp])
    covers = np.zeros((height, width))
    columns = np.arange(width)
    covers[8:24] = np.clip(np.minimum(columns + 1, left + 10) - np.maximum(columns, left), 0, 1)
    sees = rng.random((spp, height, width)) < covers
    lit = 0.1 * rng.gamma(2.0, 0.5, sees.shape)
    samples = {
        "color": np.where(sees, 10.0, lit)[..., None] * np.ones(3),
        "albedo": np.where(sees, 0.9, 0.5)[..., None] * np.ones(3),
        "normal": np.where(sees[..., None], (0.0, 0.6, 0.8), (0.0, 0.0, 1.0)),
        "depth": np.where(sees, 2.0, 3.0),
    }
    planes = {}
    for name, values in samples.items():
        planes[name], planes[f"{name}_variance"] = values.mean(0), values.var(0, ddof=1) / spp
    planes["color_a"], planes["color_b"] = samples["color"][::2].mean(0), samples["color"][1::2].mean(0)
    truth = (10.0 * covers + 0.1 * (1 - covers))[..., None] * np.ones(3)
    return {name: plane.astype(np.float32) for name, plane in planes.items()}, truth


@pytest.mark.parametrize("spp", [4, 16])
def test_a_lamp_that_moves_by_part_of_a_pixel_does_not_light_the_wall(engine, spp):
    """At its edges the error, relative as that of a wall a hundred times darker is, stays about what it was; elsewhere
    it falls."""
    alone, together, wall = [], [], []
    for seed in range(8):
        frames = [lamp(18.5 + 0.3 * k, 3 * seed + k, spp) for k in range(3)]
        (frame, truth), near = frames[1], [frames[0][0], frames[2][0]]
        found, _ = merged(engine, frame, near)
        edges = np.s_[8:24, 15:31]
        alone.append(error(frame["color"][edges], truth[edges]))
        together.append(error(found["color"][edges], truth[edges]))
        wall.append(error(found["color"][:, 34:], truth[:, 34:]) / error(frame["color"][:, 34:], truth[:, 34:]))
    assert np.mean(together) < 1.5 * np.mean(alone)
    assert np.mean(wall) < 0.6


def test_a_cut_is_not_merged(engine):
    frame, truth = planes_at(48, 64)
    other = {name: np.ascontiguousarray(plane[::-1, ::-1]) for name, plane in planes_at(48, 64, seed=1)[0].items()}
    found, mean = merged(engine, frame, [other])
    assert mean < 1.2
    assert error(found["color"], truth) < error(frame["color"], truth)


def test_what_has_come_into_view_is_not_merged(engine):
    """A box stands before the wall in the frame and not in its neighbour."""
    (frame, truth), (neighbour, _) = planes_at(48, 64), planes_at(48, 64, seed=1)
    box = np.s_[10:25, 30:45]
    rng = np.random.default_rng(0)
    for planes in (frame,):
        planes["albedo"][box], planes["normal"][box], planes["depth"][box] = (0.7, 0.1, 0.1), (0.0, 0.0, 1.0), 1.5
        planes["color"][box] = (0.7, 0.1, 0.1) * rng.gamma(8, 1 / 8, (15, 15, 1))
    found, _ = merged(engine, frame, [neighbour])
    np.testing.assert_array_equal(found["color"][12:23, 32:43], frame["color"][12:23, 32:43])
    away = np.s_[:, :20]
    assert error(found["color"][away], truth[away]) < 0.8 * error(frame["color"][away], truth[away])


def test_a_firefly_stays_a_pixel(engine):
    """Half of it comes from the neighbour, and it is not spread over four pixels that would no longer stand out."""
    frame, neighbour = planes_at(*SIZE)[0], planes_at(*SIZE, seed=1)[0]
    frame, neighbour = some(frame, FEATURES), some(neighbour, FEATURES)
    clean, _ = merged(engine, frame, [neighbour | {"motion": np.full((*SIZE, 2), 0.4, np.float32)}])
    neighbour["color"] = neighbour["color"].copy()
    neighbour["color"][12, 20] *= 1000
    found, _ = merged(engine, frame, [neighbour | {"motion": np.full((*SIZE, 2), 0.4, np.float32)}])
    change = np.abs(found["color"] - clean["color"]).max(-1)
    assert (change > 5).sum() == 1 and change[12, 20] > 100


def test_what_is_not_finite_in_a_neighbour_reaches_nothing():
    frame, neighbour = frame_at(*SIZE), planes_at(*SIZE, seed=1)[0]
    for i, plane in enumerate(neighbour.values()):
        plane[3 * i % 24, 5 * i % 40] = (np.nan, np.inf, -np.inf)[i % 3]
    neighbour["motion"] = np.zeros((*SIZE, 2), np.float32)
    neighbour["motion"][4, 4] = np.nan
    assert np.isfinite(denoise(frame, method="guided", neighbours=[Frame(**neighbour)])).all()


def test_nothing_known_of_a_variance_stays_so(engine):
    """A hole of the variance, which the door marks with -1, is marked after the merge as well."""
    frame, neighbour = planes_at(*SIZE)[0], planes_at(*SIZE, seed=1)[0]
    neighbour["color_variance"][:, :30] = np.nan
    found, mean = merged(engine, frame, [neighbour])
    assert mean > 1.5 and set(np.unique(np.sign(found["color_variance"]))) == {-1, 1}
    whole = denoise(Frame(**frame), method="guided", neighbours=[Frame(**neighbour)])
    assert np.isfinite(whole).all()


@pytest.mark.parametrize("method", ["nlm", "guided"])
def test_without_neighbours_no_bit_changes(method):
    frame = frame_at(*SIZE)
    denoiser = Denoiser(*SIZE, method=method)
    alone = denoiser(frame)
    assert denoiser.report.merged == 1
    better = denoiser(frame, neighbours=[frame_at(*SIZE, seed=1)])
    assert 1.5 < denoiser.report.merged <= 2 and (better != alone).any()
    np.testing.assert_array_equal(denoiser(frame, neighbours=[]), alone)
    assert denoiser.report.merged == 1


def test_device_arrays_give_the_same_bits():
    frame, neighbour = frame_at(*SIZE), replace(frame_at(*SIZE, seed=1), motion=np.zeros((*SIZE, 2), np.float32))
    denoiser = Denoiser(*SIZE, method="guided")
    expected = denoiser(frame, neighbours=[neighbour])

    def there(frame):
        planes = frame.planes() | ({} if frame.motion is None else {"motion": frame.motion})
        return Frame(**{name: cl_array.to_device(denoiser.queue, plane) for name, plane in planes.items()})

    np.testing.assert_array_equal(denoiser(there(frame), neighbours=[there(neighbour)]).get(), expected)
    with pytest.raises(FrameError, match=r"neighbours\[0\] is in host memory but the frame is in device memory"):
        denoiser(there(frame), neighbours=[neighbour])


@pytest.mark.parametrize("with_motion", [False, True], ids=["searched", "known"])
def test_bands_change_no_bit(engine, with_motion):
    height, width = 470, 41
    frame, neighbour, last = (planes_at(height, width, (0, 3 * seed), seed=seed)[0] for seed in range(3))
    frame["color"][[127, 128, 300], [3, 4, 5]] = np.nan
    if with_motion:
        rng = np.random.default_rng(0)
        last["motion"] = rng.uniform((-2, -80), (2, 80), (height, width, 2)).astype(np.float32)
    whole, mean = merged(engine, frame, [neighbour, last])
    least = module.least_rows_to_merge(engine)
    assert least < height
    banded, mean_of_bands = merged(engine, frame, [neighbour, last], rows=least)
    assert mean_of_bands == pytest.approx(mean, rel=1e-5)
    for name, plane in whole.items():
        np.testing.assert_array_equal(banded[name], plane, err_msg=name)


@pytest.mark.parametrize("plane", [*PLANES, "motion"])
@pytest.mark.parametrize("of_neighbour", [False, True])
def test_what_a_row_depends_on_lies_within_reach(engine, plane, of_neighbour, monkeypatch):
    """As far as a change of one row changes another, exposure aside."""
    if plane == "motion" and not of_neighbour:
        return
    monkeypatch.setattr(module, "exposure_of", lambda engine, source, given: engine.constant([1.0]))
    height, width = 300, 24
    frames = [planes_at(height, width, seed=seed)[0] for seed in range(2)]
    if plane == "motion":
        frames[1]["motion"] = (
            np.random.default_rng(0).uniform((-1, -70), (1, 70), (height, width, 2)).astype(np.float32)
        )
    names = [name for name in frames[0] if name in PLANES]
    before, _ = merged(engine, frames[0], frames[1:], names)
    farthest = -1
    for row in (0, 147, 153, height - 1):
        changed = [dict(planes) for planes in frames]
        changed[of_neighbour][plane] = frames[of_neighbour][plane].copy()
        changed[of_neighbour][plane][row] = frames[of_neighbour][plane][row] * (0.5 if plane == "motion" else 3) + 0.5
        after, _ = merged(engine, changed[0], changed[1:], names)
        for name in names:
            rows = np.flatnonzero((after[name] != before[name]).reshape(height, -1).any(1))
            farthest = max(farthest, abs(rows - row).max(initial=-1))
    assert 0 <= farthest <= (module.FAR_REACH if plane == "motion" else module.REACH)


def test_a_sequence_of_files(tmp_path):
    """`--temporal 1` is `neighbours` of the frames beside, whose numbers are in the names of the files."""
    paths = [tmp_path / f"shot.{number:04d}.exr" for number in (8, 9, 10)]
    for seed, path in enumerate(paths):
        write_exr(path, frame_at(*SIZE, seed=seed))
    command = [str(tmp_path / "shot.####.exr"), "-o", str(tmp_path / "out"), "--method", "guided", "--temporal"]
    frames = [read_exr(path) for path in paths]
    for count, near in (("1", frames[::2]), ("0", [])):
        assert cli.main(["denoise", *command, count, "--force"]) == 0
        written = read_exr(tmp_path / "out" / paths[1].name).color
        np.testing.assert_array_equal(written, denoise(frames[1], method="guided", neighbours=near))


@pytest.mark.parametrize(
    ("neighbour", "message"),
    [
        (lambda: frame_at(24, 41), r"neighbours\[1\] is \(24, 41\) but the frame is \(24, 40\): all frames of a seq"),
        (lambda: frame_at(*SIZE, names=("albedo",)), r"neighbours\[1\] has no normal but the frame has: pass it, or"),
        (lambda: np.ones((*SIZE, 3), np.float32), r"neighbours\[1\] is a ndarray but a Frame is needed"),
    ],
)
def test_neighbours_that_do_not_fit(neighbour, message):
    frame = frame_at(*SIZE, names=FEATURES)
    with pytest.raises(FrameError, match=message):
        denoise(frame, method="guided", neighbours=[frame_at(*SIZE, seed=1), neighbour()])


def test_a_frame_is_no_neighbour_of_itself():
    frame = frame_at(*SIZE)
    with pytest.raises(FrameError, match=r"neighbours\[0\] is the frame itself"):
        denoise(frame, method="guided", neighbours=[frame])


@pytest.mark.parametrize(
    ("motion", "message"),
    [
        (
            np.zeros((24, 40, 4), np.float32),
            r"motion is \(24, 40, 4\) but \(24, 40, 2\) is needed.*two channels that bel",
        ),
        (np.zeros((12, 40, 2), np.float32), r"motion is \(12, 40, 2\) but \(24, 40, 2\) is needed"),
        (np.zeros((24, 40, 2), int), "motion has dtype int64"),
        ([1, 2], "motion is a list"),
    ],
)
def test_motion_that_does_not_fit(motion, message):
    with pytest.raises(FrameError, match=message):
        frame = frame_at(*SIZE)
        Frame(**frame.planes(), motion=motion)
