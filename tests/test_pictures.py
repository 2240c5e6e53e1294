import os
import re
import stat
import sys

import numpy as np
import pyopencl as cl
import pyopencl.array as cl_array
import pytest
from PIL import Image

from mcdenoise_cl import pictures
from mcdenoise_cl.device import context_for
from mcdenoise_cl.errors import FrameError, McdenoiseError, ParameterError
from mcdenoise_cl.frame import Frame

H, W, GAP = 90, 160, 12
ORANGE, BLUE = pictures.CROP_COLORS[:2]


@pytest.fixture
def images():
    rng = np.random.default_rng(3)
    return {name: rng.random((H, W, 3), np.float32) for name in ("noisy", "denoised", "reference")}


def count(picture, color):
    return np.count_nonzero((picture == np.array(color, np.uint8)).all(axis=2))


def cell(picture, column, row_top=GAP):
    """The full image at one place of the grid."""
    left = GAP + column * (W + GAP)
    return picture[row_top : row_top + H, left : left + W]


def test_to_png_is_the_srgb_curve():
    image = np.array([-1, 0, 0.001, 0.0031308, 0.18, 0.5, 1, 7]).repeat(3).reshape(2, 4, 3)
    # By hand: 255 * 12.92 c up to 0.0031308, then 255 * (1.055 c^(1/2.4) - 0.055).
    assert pictures.to_png(image)[..., 0].tolist() == [[0, 0, 3, 10], [118, 188, 255, 255]]
    np.testing.assert_array_equal(pictures.to_png(image / 4, exposure=4), pictures.to_png(image))
    assert pictures.to_png(image.astype(np.float16)).dtype == np.uint8


@pytest.mark.filterwarnings("error")
def test_to_png_shows_what_is_not_a_number():
    image = np.full((2, 2, 3), 0.5)
    image[0, 1, 2], image[1, 0] = np.nan, np.inf
    assert pictures.to_png(image).tolist() == [[[188] * 3, [255, 0, 255]], [[255] * 3, [188] * 3]]


def test_to_png_leaves_pictures_alone():
    picture = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    np.testing.assert_array_equal(pictures.to_png(picture, exposure=3), picture)
    with pytest.raises(FrameError, match="image has dtype int64 but floats are needed"):
        pictures.to_png(picture.astype(np.int64))
    with pytest.raises(FrameError, match="image has dtype uint8"):
        pictures.to_png(picture[..., 0])


def test_write_png_round_trip(tmp_path, images):
    path = tmp_path / "noisy.png"
    pictures.write_png(path, np.zeros((1, 1, 3)))
    pictures.write_png(str(path), images["noisy"], exposure=0.5)
    with Image.open(path) as read:
        assert (read.format, read.mode, read.size) == ("PNG", "RGB", (W, H))
        np.testing.assert_array_equal(np.asarray(read), pictures.to_png(images["noisy"], 0.5))
    assert [file.name for file in tmp_path.iterdir()] == ["noisy.png"]


@pytest.mark.skipif(os.name != "posix", reason="permission bits")
def test_write_png_follows_the_umask(tmp_path):
    old = os.umask(0o027)
    try:
        pictures.write_png(tmp_path / "a.png", np.zeros((1, 1, 3)))
    finally:
        os.umask(old)
    assert stat.S_IMODE((tmp_path / "a.png").stat().st_mode) == 0o640


def test_write_png_leaves_nothing_behind_when_it_fails(tmp_path):
    (tmp_path / "taken.png").mkdir()
    with pytest.raises(McdenoiseError, match=r"taken.png cannot be written \(Is a directory\)"):
        pictures.write_png(tmp_path / "taken.png", np.zeros((1, 1, 3)))
    with pytest.raises(McdenoiseError, match=r"no/a.png cannot be written because its folder does not exist: make"):
        pictures.write_png(tmp_path / "no" / "a.png", np.zeros((1, 1, 3)))
    assert [file.name for file in tmp_path.iterdir()] == ["taken.png"]


def test_pillow_is_asked_for(tmp_path, monkeypatch, images):
    monkeypatch.setitem(sys.modules, "PIL.Image", None)
    for call in (
        lambda: pictures.write_png(tmp_path / "a.png", images["noisy"]),
        lambda: pictures.side_by_side(images),
    ):
        with pytest.raises(McdenoiseError, match=r"need Pillow, .*: pip install 'mcdenoise-cl\[demo\]'"):
            call()
    assert not list(tmp_path.iterdir())


def test_side_by_side_shows_every_image(images):
    picture = pictures.side_by_side(images, exposure=0.7)
    assert picture.dtype == np.uint8
    assert picture.shape[1:] == (3 * W + 4 * GAP, 3)
    for column, image in enumerate(images.values()):
        np.testing.assert_array_equal(cell(picture, column), pictures.to_png(image, 0.7))
    frame = np.ones(picture.shape[:2], bool)
    frame[GAP:-GAP, GAP:-GAP] = False
    assert (picture[frame] == 255).all()


def test_labels_stand_under_their_images(images):
    blank = {name: np.ones((H, W, 3)) for name in images}
    picture = pictures.side_by_side(blank)
    ink = picture[GAP + H :].min(axis=(0, 2))
    for column in range(3):
        here = np.flatnonzero(ink[GAP + column * (W + GAP) :][:W] < 128)
        assert here.size, "a label is missing"
        assert abs((here[0] + here[-1]) / 2 - W / 2) < 4, "a label is not centred"
    lines = pictures.side_by_side(blank, labels={"noisy": "4 spp\n12.3 dB"})
    assert lines.shape[0] > picture.shape[0] + 10
    third = slice(2 * (W + GAP), None)
    np.testing.assert_array_equal(lines[: picture.shape[0], third], picture[:, third])


def test_a_long_label_widens_its_column():
    picture = pictures.side_by_side(
        {"a": np.ones((8, 8, 3)), "non-local means with albedo and normal": np.ones((8, 8, 3))}
    )
    columns = np.flatnonzero(picture.min(axis=(0, 2)) < 128)
    assert picture.shape[1] > 400
    assert columns.min() > GAP and columns.max() < picture.shape[1] - GAP


def test_a_long_label_is_drawn_smaller_where_that_is_enough():
    blank = np.full((8, 640, 3), 255, np.uint8)
    label = "non-local means with albedo"
    picture = pictures.side_by_side({"a": blank, "b": blank, "c": blank, label: blank})
    longer = pictures.side_by_side({"a": blank, "b": blank, "c": blank, f"{label}, normal and depth": blank})
    assert longer.shape[1] == picture.shape[1] == 4 * (640 + GAP) + GAP
    assert longer.shape[0] < picture.shape[0]


@pytest.mark.parametrize(("number", "columns", "rows"), [(1, 1, 1), (4, 4, 1), (5, 3, 2), (8, 4, 2), (9, 3, 3)])
def test_more_than_four_images_make_a_grid(number, columns, rows):
    greys = {str(i): np.full((H, W, 3), 25 * i, np.uint8) for i in range(number)}
    picture = pictures.side_by_side(greys)
    assert picture.shape[1] == columns * (W + GAP) + GAP
    row_height = picture.shape[0] // rows
    for i in range(number):
        assert (cell(picture, i % columns, GAP + i // columns * row_height) == 25 * i).all()


def test_columns_can_be_chosen(images):
    assert pictures.side_by_side(images, columns=1).shape[1] == W + 2 * GAP


def test_crops_are_magnified_and_outlined(images):
    crops = [(20, 30, 16), (W - 16, 0, 16)]
    plain, picture = pictures.side_by_side(images), pictures.side_by_side(images, crops=crops)
    for column in range(3):
        changed = (cell(plain, column) != cell(picture, column)).any(axis=2)
        assert changed.any() == (column == 0), "the first image alone has outlines"
        # Two frames in half of the width less a gap, 74 pixels, with lines of 2 pixels: 70 // 16 is 4.
        below = picture[plain.shape[0] - GAP :, GAP // 2 + column * (W + GAP) :][:, : W + GAP]
        for (x, y, size), color in zip(crops, (ORANGE, BLUE), strict=True):
            ys, xs = np.nonzero((below == np.array(color, np.uint8)).all(axis=2))
            framed = below[ys.min() : ys.max() + 1, xs.min() : xs.max() + 1]
            shown = pictures.to_png(list(images.values())[column])[y : y + size, x : x + size]
            np.testing.assert_array_equal(framed[2:-2, 2:-2], np.kron(shown, np.ones((4, 4, 1), np.uint8)))
    first = cell(picture, 0)
    assert (first[30:46, 18:20] == ORANGE).all() and (first[28:30, 20:36] == ORANGE).all()
    np.testing.assert_array_equal(first[30:46, 20:36], cell(plain, 0)[30:46, 20:36])
    assert (first[0:16, W - 18 : W - 16] == BLUE).all()


def test_many_or_large_crops_go_into_rows(images):
    crops = [(0, 0, 60), (60, 0, 60), (100, 30, 60)]
    picture = pictures.side_by_side(images, crops=crops)
    assert picture.shape[1] == 3 * W + 4 * GAP
    assert picture.shape[0] > H + 3 * 2 * 60
    whole = pictures.side_by_side({"one": np.zeros((32, 32, 3))}, crops=[(0, 0, 32)])
    assert count(whole, ORANGE) > 4 * 32


def test_wide_pictures_are_reduced_but_not_their_crops(images):
    stripes = {name: np.zeros((H, W, 3), np.uint8) for name in images}
    for picture in stripes.values():
        picture[:, ::2] = 200
    wide = pictures.side_by_side(stripes, max_width=300, crops=[(0, 0, 8)])
    assert wide.shape[1] == 3 * W // 2 + 4 * GAP
    assert (wide[GAP + H // 2 - 5, GAP + W // 2 - 5] == 100).all()
    assert count(wide, (200, 200, 200)) and not count(pictures.side_by_side(stripes, max_width=300), (200, 200, 200))


def test_side_by_side_errors(images):
    with pytest.raises(ParameterError, match="images is empty: pass at least one image by name"):
        pictures.side_by_side({})
    with pytest.raises(FrameError, match=r"b is \(90, 159, 3\) but noisy is \(90, 160, 3\): pass images of the same"):
        pictures.side_by_side({**images, "b": images["noisy"][:, 1:]})
    for crop in ((-1, 0, 8), (0, -1, 8), (W - 7, 0, 8), (0, H - 7, 8), (0, 0, 0)):
        with pytest.raises(ParameterError, match=re.escape(f"crop {crop} is not inside images of (90, 160, 3): pass")):
            pictures.side_by_side(images, crops=[crop])


def test_find_crops_seeks_structure_and_noise():
    rng = np.random.default_rng(5)
    reference, noise = np.full((100, 200, 3), 0.4), np.zeros((100, 200, 3))
    reference[20:40:4, 20:60] = 0.6  # structure, no noise
    noise[20:40, 80:120] = rng.normal(0, 0.2, (20, 40, 3))  # noise, no structure
    reference[60:80:4, 130:150], noise[60:80, 130:150] = 0.6, rng.normal(0, 0.2, (20, 20, 3))  # both
    reference[70:90:4, 20:40], noise[70:90, 20:40] = 0.5, rng.normal(0, 0.2, (20, 20, 3))  # both, weaker
    (x, y, size), second = pictures.find_crops(reference + noise, reference, n=2, size=24)
    assert size == 24
    assert 126 <= x <= 130 and 56 <= y <= 60
    assert 16 <= second[0] <= 20 and 65 <= second[1] <= 70


def test_find_crops_rather_goes_elsewhere_than_right_beside():
    rng = np.random.default_rng(5)
    reference, noise = np.full((60, 200, 3), 0.4), rng.normal(0, 0.1, (60, 200, 3))
    reference[20:40:4, 20:60], reference[20:40:4, 160:180] = 0.6, 0.57
    crops = pictures.find_crops(reference + noise, reference, n=2, size=20)
    assert sorted(x > 120 for x, _, _ in crops) == [False, True]


def test_find_crops_never_overlap(images):
    crops = pictures.find_crops(images["noisy"], images["reference"], n=50, size=30)
    assert 4 <= len(crops) <= 15
    covered = np.zeros((H, W), int)
    for x, y, size in crops:
        assert x + size <= W and y + size <= H
        covered[y : y + size, x : x + size] += 1
    assert covered.max() == 1
    assert pictures.find_crops(images["noisy"], images["noisy"], n=1, size=H) == [(0, 0, H)]


def test_find_crops_survives_what_is_not_finite(images):
    images["noisy"][5, 5] = np.nan
    images["reference"][6, 6] = np.inf
    assert len(pictures.find_crops(images["noisy"], images["reference"], size=20)) == 2


def test_find_crops_errors(images):
    with pytest.raises(FrameError, match=r"noisy is .* but reference is"):
        pictures.find_crops(images["noisy"][1:], images["reference"])
    for size in (1, H + 1):
        with pytest.raises(ParameterError, match=rf"size is {size} but .*: pass a size from 2 to {H}"):
            pictures.find_crops(images["noisy"], images["reference"], size=size)


def feature_frame():
    normal = np.zeros((H, W, 3), np.float16)
    normal[..., 2], normal[0, 0] = 1, -1
    depth = np.linspace(1, 5, H * W, dtype=np.float32).reshape(H, W)
    depth[0, 0] = 0
    albedo = np.full((H, W, 3), 0.5)
    return Frame(np.full((H, W, 3), 0.18), albedo, normal, depth, metadata={"exposure_scale": 1.0})


def check_sheet(sheet):
    assert sheet.shape[1] == 2 * (W + GAP) + GAP
    assert (cell(sheet, 0) == 118).all() and (cell(sheet, 1) == 188).all()
    normal, depth = (cell(sheet, column, GAP + sheet.shape[0] // 2) for column in (0, 1))
    assert normal[1, 1].tolist() == [128, 128, 255] and normal[0, 0].tolist() == [0, 0, 0]
    assert depth[0, 0, 0] == 0 and depth[0, 1, 0] == 255 and depth[-1, -1, 0] == 40
    assert (np.diff(depth[:, 7, 0].astype(int)) <= 0).all()


def test_feature_sheet():
    check_sheet(pictures.feature_sheet(feature_frame()))


def test_feature_sheet_of_device_arrays(device):
    queue = cl.CommandQueue(context_for(device), device)
    frame = feature_frame()
    planes = {name: cl_array.to_device(queue, plane) for name, plane in frame.planes().items()}
    check_sheet(pictures.feature_sheet(Frame(**planes, metadata=frame.metadata)))


def test_feature_sheet_leaves_absent_planes_out():
    assert pictures.feature_sheet(Frame(np.ones((H, W, 3)))).shape[1] == W + 2 * GAP
    flat = Frame(np.full((H, W, 3), np.nan), depth=np.zeros((H, W)))
    sheet = pictures.feature_sheet(flat)
    assert (cell(sheet, 0) == pictures.NAN_COLOR).all() and (cell(sheet, 1) == 0).all()
