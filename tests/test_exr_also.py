"""Layers of EXR files that are filtered with the colour: found by name or by their sum, and written back."""

from __future__ import annotations

import inputs
import numpy as np
import OpenEXR
import pytest

from mcdenoise_cl import ExrError, denoise, read_also, read_exr, write_exr
from mcdenoise_cl.cli import main
from mcdenoise_cl.job import Job, Recipe, run_job
from mcdenoise_cl.light_groups import find_groups

HEIGHT, WIDTH = 37, 101


def light(parts, seed=0, dtype="f4"):
    """So many layers of light, each somewhere else and with a hue of its own, and their sum."""
    rng = np.random.default_rng(seed)
    x = np.linspace(0, 1, WIDTH)[:, None]
    layers = []
    for i in range(parts):
        shape = np.exp(-(((x - (i + 0.5) / parts) * parts) ** 2)) * rng.random(3)
        layers.append((shape * rng.gamma(2.0, 0.5, (HEIGHT, WIDTH, 1))).astype(dtype))
    return layers, sum(layer.astype("f8") for layer in layers).astype(dtype)


def save(path, layers, attributes=None):
    """An EXR file of these layers, "" for the plain R G B, in the order of the names."""
    channels = {}
    for name, image in layers.items():
        for i, letter in enumerate("RGB"):
            channels[f"{name}.{letter}" if name else letter] = np.ascontiguousarray(image[..., i])
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **(attributes or {})}
    OpenEXR.File(header, channels).write(str(path))
    return path


@pytest.fixture
def arnold(tmp_path):
    """Light split up in two ways that share a layer, features, and a layer that is no light."""
    (direct, indirect, specular, emission), color = light(4)
    room = inputs.features(HEIGHT, WIDTH)
    layers = {"": color, "diffuse": direct + indirect, "diffuse_direct": direct, "diffuse_indirect": indirect}
    layers |= {"specular": specular, "emission": emission, "sss": 0 * color, "albedo": room["albedo"]}
    layers |= {"crypto_object00": np.random.default_rng(1).normal(0, 1e30, color.shape).astype("f4")}
    return save(tmp_path / "arnold.exr", layers), layers


def test_groups_that_sum_to_the_colour(arnold):
    path, layers = arnold
    others = {name: layer for name, layer in layers.items() if name}
    assert find_groups(layers[""], others) == (
        ("diffuse_direct", "diffuse_indirect", "specular", "emission"),
        ("diffuse", "specular", "emission"),
    )
    assert sorted(read_also(path)) == sorted(set(others) - {"sss", "albedo", "crypto_object00"})


@pytest.mark.parametrize("dtype", ["f2", "f4"])
@pytest.mark.parametrize("parts", [2, 7, 20])
def test_a_group_among_layers_that_are_none(parts, dtype):
    layers, color = light(parts, dtype=dtype)
    named = {f"RGBA_{i}": layer for i, layer in enumerate(layers)}
    decoys = {f"decoy_{i}": layer for i, layer in enumerate(light(5, seed=9, dtype=dtype)[0])}
    assert find_groups(color, decoys | named) == (tuple(named),)
    missing = {name: layer for name, layer in (decoys | named).items() if name != "RGBA_1"}
    assert find_groups(color, missing) == ()


def test_groups_bear_a_few_pixels_that_are_off():
    layers, color = light(3)
    named = dict(zip("abc", layers, strict=True))
    color[::10, 5] += 3
    color[3, 7] = np.nan
    named["b"][4, 8] = np.inf
    assert find_groups(color, named) == (("a", "b", "c"),)
    color[:, :20] *= 1.1
    assert find_groups(color, named) == ()


def test_a_small_light_is_not_forgotten():
    layers, color = light(3)
    small = np.zeros_like(color)
    small[3:5, 10:12] = 5
    named = dict(zip("abc", layers, strict=True)) | {"lamp": small}
    assert find_groups(color + small, named) == (("a", "b", "c", "lamp"),)


def test_a_black_picture_and_many_equal_layers_end():
    black = np.zeros((8, 8, 3), np.float32)
    assert find_groups(black, {"a": black, "b": black}) == ()
    same = {str(i): np.full((8, 8, 3), 0.05, np.float32) for i in range(30)}
    assert all(len(group) == 20 for group in find_groups(np.ones((8, 8, 3), np.float32), same))


def test_layers_are_read_and_written_back(arnold, tmp_path):
    path, layers = arnold
    also = read_also(path, ["Diffuse", "specular", "emission"])
    assert list(also) == ["diffuse", "specular", "emission"]
    frame = read_exr(path)
    found = denoise(frame, method="nlm", also=also, details=True)
    write_exr(tmp_path / "clean.exr", found.image, template=path, also=found.also)
    clean = read_also(tmp_path / "clean.exr", [name for name in layers if name])
    for name, layer in found.also.items():
        np.testing.assert_array_equal(clean.pop(name), layer)
    for name, layer in clean.items():
        np.testing.assert_array_equal(layer, layers[name], err_msg=name)
    np.testing.assert_array_equal(read_exr(tmp_path / "clean.exr").color, found.image)


def test_errors_name_what_there_is(arnold, tmp_path):
    path, layers = arnold
    with pytest.raises(ExrError, match=r"sheen is no RGB layer over the pixels of the colour: there are .*diffuse, "):
        read_also(path, ["sheen"])
    with pytest.raises(ExrError, match=r"RGB is the colour itself, which is filtered anyway: leave it out"):
        read_also(path, ["RGB"])
    with pytest.raises(ExrError, match="also is given but template is not"):
        write_exr(tmp_path / "a.exr", layers[""], also={"diffuse": layers[""]})
    with pytest.raises(ExrError, match=r"for the layer diffuse is a float32 of \(3, 4, 3\) but a host array"):
        write_exr(tmp_path / "a.exr", layers[""], template=path, also={"diffuse": np.zeros((3, 4, 3), np.float32)})
    assert not (tmp_path / "a.exr").exists()
    two = save(tmp_path / "two.exr", {"": layers[""], "x.key": layers["diffuse"], "y.key": layers["specular"]})
    with pytest.raises(ExrError, match=r"key could be any of x.key, y.key: give the full name"):
        read_also(two, ["key"])
    assert list(read_also(two, ["y.key"])) == ["y.key"]


@pytest.mark.parametrize("options", [["--also", "diffuse, specular,emission"], ["--layers", "auto"]])
def test_command_line(arnold, tmp_path, options, capfd):
    path, layers = arnold
    target = tmp_path / "clean.exr"
    assert main(["denoise", str(path), "-o", str(target), "--method", "nlm", *options]) == 0
    assert "emission" in "".join(capfd.readouterr())
    clean = read_also(target, [name for name in layers if name])
    color = read_exr(target).color
    total = sum(clean[name].astype("f8") for name in ("diffuse", "specular", "emission"))
    assert (np.abs(total - color) <= 1e-5 * color).mean() > 0.99
    assert np.abs(clean["diffuse"] - layers["diffuse"]).max() > 0.01
    np.testing.assert_array_equal(clean["albedo"], layers["albedo"])
    assert np.array_equal(clean["diffuse_direct"], layers["diffuse_direct"]) == (options[0] == "--also")


def test_command_line_says_what_is_wrong(arnold, tmp_path, capfd):
    path, _ = arnold
    start = ["denoise", str(path), "-o", str(tmp_path / "clean.exr"), "--method", "nlm"]
    for options, code, text in (
        (["--also", "sheen"], 1, "sheen is no RGB layer"),
        (["--also", "diffuse,,specular"], 2, "names of layers separated by commas"),
        (["--also", "diffuse", "--layers", "auto"], 2, "are both given: give one"),
        (["--layers", "all"], 2, "auto"),
    ):
        assert main([*start, *options]) == code
        assert text in "".join(capfd.readouterr())
        assert not (tmp_path / "clean.exr").exists()


def test_a_file_without_groups_is_done_and_says_so(tmp_path):
    _, color = light(2)
    layers = {"": color, "ViewLayer.DiffDir": color * 3, "ViewLayer.DiffCol": 1 - 0 * color}
    job = Job(save(tmp_path / "cycles.exr", layers), tmp_path / "clean.exr")
    outcome = run_job(job, Recipe.of("nlm", also="auto"))
    assert outcome.status == "done", outcome.error
    assert "no group of the layers" in outcome.notes[0] and "multiplied by their colours" in outcome.notes[1]


def test_halves_bring_the_mean_of_their_layers(tmp_path):
    paths, layers = [], []
    for seed in (0, 1):
        (a, b), color = light(2, seed=seed)
        layers.append({"": color, "key": a, "fill": b})
        paths.append(save(tmp_path / f"{seed}.exr", layers[-1], {"samplesPerPixel": 4 << seed}))
    job = Job(paths[0], tmp_path / "clean.exr", halves=tuple(paths))
    outcome = run_job(job, Recipe.of("nlm", also=("key", "fill")))
    assert outcome.status == "done", outcome.error
    assert outcome.layers["also"] == "key,fill"
    mean = {name: layers[0][name] / 3 + layers[1][name] * 2 / 3 for name in layers[0]}
    expected = denoise(mean[""].astype("f4"), method="nlm", also={"key": mean["key"].astype("f4")}, details=True)
    clean = read_also(job.target, ["key", "fill"])
    np.testing.assert_allclose(clean["key"], expected.also["key"], rtol=1e-3, atol=1e-4)
    color = read_exr(job.target).color
    assert (np.abs(clean["key"].astype("f8") + clean["fill"] - color) <= 1e-5 * color).mean() > 0.99
