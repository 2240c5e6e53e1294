"""`render`: frames of our scenes and of XML files, their statistics, and what a user meets when something is wrong."""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from mcdenoise_cl import render as module
from mcdenoise_cl import variant as variants
from mcdenoise_cl.errors import RenderError
from mcdenoise_cl.frame import Frame
from mcdenoise_cl.render import exposure_scale, pick_variant, render, scene_names

FEATURES = ("albedo", "normal", "depth")
CAMERA = """
<sensor type="perspective">
  <transform name="to_world"><lookat origin="1, -4, 2" target="0, 0, 0.4" up="0, 0, 1"/></transform>
  <film type="hdrfilm">
    <integer name="width" value="16"/><integer name="height" value="12"/><rfilter type="gaussian"/>
  </film>
  <sampler type="stratified"><integer name="sample_count" value="64"/></sampler>
</sensor>"""
WORLD = """
<shape type="rectangle">
  <transform name="to_world"><scale value="2"/></transform>
  <bsdf type="diffuse"><texture type="checkerboard" name="reflectance">
    <transform name="to_uv"><scale value="9"/></transform>
  </texture></bsdf>
</shape>
<shape type="sphere"><point name="center" x="0" y="0" z="0.5"/><float name="radius" value="0.5"/></shape>
<shape type="sphere">
  <point name="center" x="-1" y="-1" z="3"/><float name="radius" value="0.4"/>
  <emitter type="area"><rgb name="radiance" value="9, 8, 7"/></emitter>
</shape>"""


@pytest.fixture
def scene_file(tmp_path):
    def write(body=CAMERA + WORLD):
        path = tmp_path / "still.xml"
        path.write_text(f'<scene version="3.0.0">{body}</scene>')
        return path

    return write


def scalar(scene, **options) -> Frame:
    return render(scene, variant="scalar_rgb", **options)


def stack(frames, plane):
    return np.stack([getattr(frame, plane) for frame in frames]).astype(np.float64)


# Our scenes


@pytest.fixture(scope="module", params=["classroom", "room", "staircase"])
def ours(request):
    return render(request.param, spp=8, width=32, halves=True, variant="scalar_rgb")


def test_the_names_of_our_scenes():
    assert scene_names() == ["classroom", "room", "staircase"]


def test_our_scenes_fill_a_frame(ours):
    assert ours.shape == (18, 32)  # the height follows from the scene's own 16:9
    assert len(ours.planes()) == 10
    for name, plane in ours.planes().items():
        assert plane.dtype == np.float32 and np.isfinite(plane).all(), name
    assert (ours.color.max(-1) > 0).mean() > 0.99
    assert (ours.depth > 0).all()  # all three are closed rooms
    assert (np.linalg.norm(ours.normal, axis=-1) <= 1.0001).all()
    assert ours.normal.std((0, 1)).min() > 0.1
    assert ours.albedo.min() >= 0 and np.median(ours.albedo) > 0.05
    assert (ours.color_variance.max(-1) > 0).mean() > 0.95


def test_exposure_makes_our_scenes_presentable(ours):
    shown = np.clip(ours.color * ours.metadata["exposure_scale"], 0, 1)
    assert 0.05 < np.median(shown.mean(-1)) < 0.3
    assert (shown.min(-1) == 1).mean() < 0.3


def test_metadata(ours):
    assert ours.metadata["samples_per_pixel"] == 8 and ours.metadata["seed"] == 0
    assert ours.metadata["scene"] in scene_names() and ours.metadata["variant"] == "scalar_rgb"


def test_our_scenes_repeat(ours):
    """Each load of a scene asks the same light for the same random number."""
    for _ in range(2):
        again = scalar(ours.metadata["scene"], spp=8, width=32, halves=True)
        for name, plane in ours.planes().items():
            np.testing.assert_array_equal(getattr(again, name), plane, err_msg=name)


# Statistics


@pytest.mark.parametrize("pass_paths", [1 << 19, 3 * 16 * 12], ids=["one pass", "passes of three"])
def test_variances_are_those_over_seeds(scene_file, monkeypatch, pass_paths):
    monkeypatch.setattr(module, "PASS_PATHS", pass_paths)
    frames = [scalar(scene_file(), spp=8, seed=seed) for seed in range(60)]
    for plane in ("color", *FEATURES):
        across = stack(frames, plane).var(0, ddof=1).mean()
        told = stack(frames, f"{plane}_variance").mean()
        # 60 seeds x 192 pixels: the ratio strays by about 2 %; a forgotten n / (n - 1) would move it by 14 %.
        assert across / told == pytest.approx(1, abs=0.07), plane


def test_variance_falls_with_samples(scene_file, monkeypatch):
    monkeypatch.setattr(module, "PASS_PATHS", 16 * 12 * 4)
    few, many = ([scalar(scene_file(), spp=spp, seed=100 + seed) for seed in range(30)] for spp in (4, 64))
    ratio = stack(few, "color").var(0, ddof=1).mean() / stack(many, "color").var(0, ddof=1).mean()
    assert ratio == pytest.approx(16, rel=0.2)  # passes that repeated samples would give 1


def test_halves_are_independent_and_average_to_color(scene_file):
    truth = scalar(scene_file(), spp=4096, seed=9).color.astype(np.float64)
    frames = [scalar(scene_file(), spp=16, seed=seed, halves=True) for seed in range(20)]
    for frame in frames:
        np.testing.assert_array_equal(frame.color, (frame.color_a + frame.color_b) / 2)
    a, b = stack(frames, "color_a") - truth, stack(frames, "color_b") - truth
    assert abs((a * b).mean()) < 0.05 * np.sqrt((a**2).mean() * (b**2).mean())
    # Half the samples: twice the variance of the whole.
    assert (a**2).mean() / stack(frames, "color_variance").mean() == pytest.approx(2, rel=0.15)


def test_seeds(scene_file):
    first, again, other = (scalar(scene_file(), spp=2, seed=seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.color, again.color)
    assert (first.color != other.color).mean() > 0.5


def test_one_sample_has_no_variance(scene_file):
    frame = scalar(scene_file(), spp=1)
    assert sorted(frame.planes()) == ["albedo", "color", "depth", "normal"]


def test_features_are_zero_where_rays_leave(scene_file):
    frame = scalar(scene_file(), spp=4)
    left = frame.depth == 0
    assert 0 < left.sum() < left.size
    for plane in ("albedo", "normal", "albedo_variance", "normal_variance", "depth_variance"):
        assert not getattr(frame, plane)[left].any(), plane


def test_variants_agree(scene_file):
    if pick_variant() != "llvm_ad_rgb":
        pytest.skip("no LLVM that Dr.Jit can use")
    one, other = (render(scene_file(), spp=256, seed=5, variant=name) for name in ("scalar_rgb", "llvm_ad_rgb"))
    for plane in ("color", *FEATURES):
        gap = getattr(one, plane) - getattr(other, plane)
        spread = getattr(one, f"{plane}_variance") + getattr(other, f"{plane}_variance")
        assert (gap**2).sum() / spread.sum() == pytest.approx(1, abs=0.35), plane


# XML files


def test_xml_keeps_its_size_or_takes_ours(scene_file):
    path = scene_file()
    assert scalar(path, spp=1).shape == (12, 16)
    assert scalar(path, spp=1, width=10, height=5).shape == (5, 10)
    assert scalar(str(path), spp=1, width=8).shape == (6, 8)
    assert scalar(path, spp=1, height=24).shape == (24, 32)


def test_xml_crop_window(scene_file):
    crop = '<integer name="crop_width" value="5"/><integer name="crop_height" value="4"/><rfilter type="box"/>'
    path = scene_file(CAMERA.replace('<rfilter type="gaussian"/>', crop) + WORLD)
    assert scalar(path, spp=1).shape == (4, 5)
    assert scalar(path, spp=1, width=32).shape == (24, 32)


@pytest.mark.parametrize(
    "nesting", ["{}", '<integrator type="aov"><string name="aovs" value="p:position"/>{}</integrator>']
)
@pytest.mark.parametrize("integrator", ["path", "volpath"])
def test_xml_keeps_its_integrator(scene_file, integrator, nesting):
    own = f'<integrator type="{integrator}"><integer name="max_depth" value="1"/></integrator>'
    given, default = scalar(scene_file(nesting.format(own) + CAMERA + WORLD), spp=16), scalar(scene_file(), spp=16)
    assert (given.color == 0).mean() > 0.9  # only lights themselves are seen at depth 1
    assert (default.color > 0).mean() > 0.5
    np.testing.assert_allclose(given.depth.mean(), default.depth.mean(), rtol=0.1)


def test_xml_finds_its_files(scene_file, tmp_path, monkeypatch):
    mi = variants.import_mitsuba()
    mi.set_variant("scalar_rgb")
    (tmp_path / "maps").mkdir()
    mi.Bitmap(np.full((2, 2, 3), 0.25, np.float32)).write(str(tmp_path / "maps" / "grey.exr"))
    texture = '<texture type="bitmap" name="reflectance"><string name="filename" value="maps/grey.exr"/></texture>'
    start, end = WORLD.index('<texture type="checker'), WORLD.index("</bsdf>")
    path = scene_file(CAMERA + WORLD[:start] + texture + WORLD[end:])
    monkeypatch.chdir(tmp_path.parent)
    frame = scalar(path, spp=4)
    assert np.median(frame.albedo[frame.depth > 0]) == pytest.approx(0.25, abs=0.01)


# Manners


def test_progress(scene_file, monkeypatch):
    monkeypatch.setattr(module, "PASS_PATHS", 16 * 12 * 3)
    for halves in (False, True):
        calls = []
        scalar(scene_file(), spp=16, halves=halves, on_progress=lambda *call, calls=calls: calls.append(call))
        done = [call[0] for call in calls]
        assert len(done) > 4 and done == sorted(set(done)) and done[-1] == 16
        assert {call[1] for call in calls} == {16}


def test_errors_of_the_caller_pass_through(scene_file):
    def stop(done, total):
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match=r"^enough$"):
        scalar(scene_file(), spp=1, on_progress=stop)


def test_silence_and_state(scene_file, capfd):
    mi = variants.import_mitsuba()
    mi.set_variant("scalar_spectral")
    level = mi.logger().log_level()
    scalar(scene_file(), spp=2)
    with pytest.raises(RenderError):
        scalar(scene_file("<nonsense/>"), spp=2)
    assert mi.variant() == "scalar_spectral" and mi.logger().log_level() == level
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scene": "kitchen"}, "'kitchen'.*classroom, room, staircase.*xml"),
        ({"scene": "kitchen.xml"}, "'kitchen.xml'.*xml"),
        ({"spp": 0}, "spp is 0"),
        ({"spp": 3, "halves": True}, "spp is 3.*even.*spp=4"),
        ({"width": 0}, "width is 0"),
        ({"height": -2}, "height is -2"),
        ({"seed": -1}, "seed is -1"),
        ({"variant": "scalar_rbg"}, "'scalar_rbg'.*scalar_rgb"),
    ],
)
def test_errors(options, message):
    with pytest.raises(RenderError, match=message):
        render(**({"scene": "room", "spp": 2, "variant": "scalar_rgb"} | options))


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (WORLD, "no sensor"),
        ("<nonsense/>", "'still'.*nonsense"),
        (CAMERA + '<integrator type="ptracer"/>' + WORLD, "'still'.*SamplingIntegrator"),
        (CAMERA + '<shape type="ply"><string name="filename" value="lost.ply"/></shape>', "lost.ply"),
    ],
)
def test_errors_in_a_file(scene_file, body, message):
    with pytest.raises(RenderError, match=message):
        scalar(scene_file(body), spp=1)


def test_without_mitsuba(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(RenderError, match=r"pip install 'mcdenoise-cl\[render\]'"):
        scalar("room", spp=1)


def test_importing_needs_no_mitsuba():
    command = "import sys, mcdenoise_cl.render; assert not {'mitsuba', 'drjit'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", command], check=True)


def test_an_llvm_that_does_not_load_means_scalar():
    command = """
from mcdenoise_cl.render import RenderError, pick_variant
assert pick_variant() == "scalar_rgb" == pick_variant("scalar_rgb")
try:
    pick_variant("llvm_ad_rgb")
except RenderError as error:
    assert "DRJIT_LIBLLVM_PATH" in str(error)
else:
    raise AssertionError
"""
    environment = os.environ | {"DRJIT_LIBLLVM_PATH": "/nowhere/libLLVM.so"}
    subprocess.run([sys.executable, "-c", command], check=True, env=environment, capture_output=True)


def test_llvm_libraries_are_recent(tmp_path, monkeypatch):
    (tmp_path / "lib").mkdir()
    for name in ("libLLVM-15.so.1", "libLLVM-17.so.1", "libLLVM.so.19.1", "libLLVMSPIRVLib.so.15", "libLLVMCore.a"):
        (tmp_path / "lib" / name).touch()
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    mine = [Path(path).name for path in variants._llvm_libraries() if path.startswith(str(tmp_path))]
    assert mine == ["libLLVM.so.19.1", "libLLVM-17.so.1"]


# Exposure


def test_exposure_does_not_move_with_noise_or_fireflies():
    random = np.random.default_rng(0)
    smooth = np.full((40, 50, 3), 0.5)
    noisy = smooth * random.exponential(size=(40, 50, 1))
    noisy[random.uniform(size=(40, 50)) < 0.002] = 1e4
    assert exposure_scale(smooth) == pytest.approx(0.36)
    assert exposure_scale(noisy) == pytest.approx(0.36, rel=0.15)


def test_exposure_leaves_black_and_broken_pixels_out():
    color = np.zeros((32, 32, 3), np.float32)
    assert exposure_scale(color) == 1
    color[:8, :8] = 0.9
    color[20, 20] = np.nan
    assert exposure_scale(color) == pytest.approx(0.2)
