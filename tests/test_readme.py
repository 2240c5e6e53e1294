"""The README's examples for pipelines, run as they are printed, but on one device and with a smaller rendering."""

import re
from pathlib import Path

import inputs
import numpy as np
import pytest

from mcdenoise_cl import read_exr
from mcdenoise_cl.exr_file import Part, load, save

TEXT = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")
SECTION = TEXT.partition("### In a pipeline\n")[2].partition("\n## ")[0]
EXAMPLES = re.findall(r"^```python\n(.*?)^```$", SECTION, re.MULTILINE | re.DOTALL)


def example(word, **changes):
    [code] = [code for code in EXAMPLES if word in code]
    for old, new in changes.items():
        assert old in code
        code = code.replace(old, new)
    names = {"small": small}
    exec(compile(code, f"the README's example with {word}", "exec"), names)
    return names


def small(scene):
    scene["sensor"]["film"] |= {"width": 32, "height": 24}
    return scene


def test_there_are_four():
    assert len(EXAMPLES) == 4


def test_mitsuba_without_a_file():
    pytest.importorskip("mitsuba")
    names = example("mitsuba", **{"spp=16": "spp=2", "mi.cornell_box()": "small(mi.cornell_box())"})
    clean, mean = names["clean"], names["mean"]
    assert mean.shape == (24, 32, 10), "colour and the three features"
    assert clean.shape == (24, 32, 3) and np.isfinite(clean).all() and clean.std() < mean[..., :3].std()
    assert names["planes"]["albedo"].min() >= 0 and names["planes"]["albedo"].max() <= 1


def write_like_blender(path, seed):
    """Layers as Cycles calls them in a multilayer EXR, with one that is none of ours."""
    planes = inputs.features(9, 12, seed=seed)
    letters = {"Combined": "RGBA", "Denoising Albedo": "RGB", "Denoising Normal": "XYZ", "Mist": "Z"}
    color = np.concatenate([planes["color"], np.ones((9, 12, 1), np.float32)], axis=2)
    pixels = [color, planes["albedo"], planes["normal"], planes["depth"][..., None]]
    channels = {
        f"ViewLayer.{layer}.{letter}": (np.ascontiguousarray(plane[..., c]), False)
        for (layer, suffix), plane in zip(letters.items(), pixels, strict=True)
        for c, letter in enumerate(suffix)
    }
    channels["ViewLayer.Denoising Depth.Z"] = channels["ViewLayer.Mist.Z"]
    save(path, [Part({"cycles.ViewLayer.samples": "16"}, channels, False)])


def test_a_shot_from_blender(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "render").mkdir()
    for number in (1, 2):
        write_like_blender(tmp_path / "render" / f"{number:04d}.exr", number)
    names = example("render/####.exr", **{'device="all"': "device=None"})
    assert [outcome.status for outcome in names["outcomes"]] == ["done"] * 2 + ["failed"] * 248
    assert names["failed"][0] == Path("render/0003.exr")
    assert "done clean/0001.exr new\n" in capsys.readouterr().out
    outcome = names["outcomes"][0]
    assert outcome.layers["albedo"] == "ViewLayer.Denoising Albedo" and len(outcome.layers) == 4
    noisy, clean = (load(tmp_path / folder / "0001.exr")[0].channels for folder in ("render", "clean"))
    assert set(noisy) == set(clean)
    for name, (pixels, _) in noisy.items():
        assert np.array_equal(pixels, clean[name][0]) == (name[-1:] not in "RGB" or "Combined" not in name), name
    assert read_exr(tmp_path / "clean" / "0001.exr").metadata["samples_per_pixel"] == 16


def test_arrays_on_the_host_and_on_a_device():
    color = example("for _ in range(3)")["color"]
    assert color.shape == (270, 480, 3) and color.std() < 0.5
    names = example("create_some_context")
    assert names["clean"].queue is names["queue"]
    np.testing.assert_allclose(names["clean"].get(), 0.5, rtol=1e-6)
