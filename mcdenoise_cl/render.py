"""A Mitsuba scene -> `Frame`: noisy colour with the features, variances and half buffers a denoiser asks for."""

from __future__ import annotations

import importlib
import os
import sys
import types
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from .errors import RenderError
from .frame import Frame
from .variant import import_mitsuba, pick_variant

DEFAULT_SIZE = (640, 360)
#: Camera paths of one pass: bounds the memory of a wavefront (under 1 GB in `llvm_ad_rgb`) and paces `on_progress`.
PASS_PATHS = 1 << 19
#: The median brightness that `exposure_scale` leads to.
MIDDLE_GREY = 0.18
AOVS = "albedo:albedo,normal:sh_normal,depth:depth"
VECTORS = ("color", "albedo", "normal")
CHANNELS = [f"{name}.{axis}" for name, axes in zip(VECTORS, ("RGB", "RGB", "XYZ"), strict=True) for axis in axes]
CHANNELS += ["depth.T"]


def scene_names() -> list[str]:
    """Names of the scenes that come with the package.

    Example:
        >>> scene_names()
        ['classroom', 'room', 'staircase']
    """
    return sorted(path.stem for path in _scene_folder().glob("[!_]*.py"))


def render(
    scene: str | os.PathLike[str],
    *,
    spp: int,
    width: int | None = None,
    height: int | None = None,
    seed: int = 0,
    halves: bool = False,
    move: Sequence[float] = (0.0, 0.0, 0.0),
    variant: str | None = None,
    on_progress: Callable[[int, int], None] | None = None,
) -> Frame:
    """Path-trace a scene into a `Frame` with features and variances.

    The scene's own integrator is used (`path` with max_depth 9 where it has none) and its first camera. The film always
    gets a box filter and the independent sampler, whatever the file says: pixels then share no samples, and the
    variance of a pixel's mean is the variance of its samples divided by their number.

    Args:
        scene: one of `scene_names()`, or the path of a Mitsuba XML file.
        spp: samples per pixel.
        width, height: pixels; None takes 640 x 360, or what the XML file says. One alone keeps the aspect ratio.
        seed: the same seed repeats the same samples, on the same variant; a reference wants another seed.
        halves: also give `color_a` and `color_b`, of spp / 2 samples each, whose mean `color` is.
        move: how far the camera is moved to its right, up and forward, in scene units: for sequences.
        variant: see `pick_variant`. The caller's current variant is restored.
        on_progress: called with (samples per pixel done, samples per pixel in all) after each pass.

    Returns:
        A float32 frame: color (H, W, 3); albedo (H, W, 3), diffuse reflectance; normal (H, W, 3), world space;
        depth (H, W), distance from the camera; and, from 2 spp on, the variance of each pixel mean. Features are 0
        where a ray leaves the scene. Depth and normal variances are exact to about 1e-7 of the squared mean, because
        Mitsuba sums in single precision. `metadata` holds `samples_per_pixel`, `scene`, `seed`, `variant` and
        `exposure_scale`, which brings the median over blocks of 8 x 8 pixels to 0.18, black blocks left out.

    Raises:
        RenderError: no such scene, spp or a size that cannot be used, or Mitsuba is missing or reports an error.

    Example:
        >>> frame = render("room", spp=2, width=16, height=9, variant="scalar_rgb")
        >>> frame.shape, frame.depth_variance.dtype.name
        ((9, 16), 'float32')
    """
    _check(spp, width, height, seed, halves, move)
    name, load = _locate(scene)
    mi = import_mitsuba()
    variant = pick_variant(variant)
    parts = [_Moments() for _ in range(2 if halves else 1)]
    with _quiet(mi, variant):
        with _explained(name):
            loaded, integrator = load(mi, width, height, move)
        passes = _passes(mi, loaded, integrator, spp, len(parts), seed)
        done = 0
        while done < spp:
            with _explained(name):
                part, size, mean, square = next(passes)
            # A ray that leaves the scene has no albedo, normal or depth.
            mean[..., 3:], square[..., 3:] = (np.nan_to_num(x[..., 3:], posinf=0, neginf=0) for x in (mean, square))
            parts[part].add(size, mean, size * np.maximum(square - mean**2, 0))
            done += size
            if on_progress is not None:
                on_progress(done, spp)
    return _frame(parts, {"samples_per_pixel": spp, "scene": name, "seed": seed, "variant": variant})


def _check(spp: int, width: int | None, height: int | None, seed: int, halves: bool, move: Sequence[float]) -> None:
    if spp < 1:
        raise RenderError(f"spp is {spp} but at least one sample per pixel is needed: pass spp=1 or more")
    if halves and spp % 2:
        raise RenderError(f"spp is {spp} but two halves need an even number: pass spp={spp + 1}")
    for name, value in (("width", width), ("height", height)):
        if value is not None and value < 1:
            raise RenderError(f"{name} is {value} but a frame needs at least one pixel: pass {name}=1 or more")
    if seed < 0:
        raise RenderError(f"seed is {seed} but it cannot be negative: pass 0 or more")
    if np.shape(move) != (3,) or not np.isfinite(move).all():
        raise RenderError(f"move is {move!r} but three numbers are needed: how far to the right, up and forward")


def _scene_folder() -> Path:
    """Inside the installed package, or beside it in a checkout."""
    here = Path(__file__).parent
    return next(folder for folder in (here / "scenes", here.parent / "scenes") if folder.is_dir())


def _locate(scene: str | os.PathLike[str]) -> tuple[str, Callable]:
    """The scene's name, and what loads it: (mi, width, height, move) -> (scene, integrator)."""
    ours = scene_names()
    if str(scene) in ours:
        return str(scene), lambda mi, *how: _load_ours(mi, str(scene), *how)
    path = Path(scene)
    if path.suffix.lower() == ".xml" and path.is_file():
        return path.stem, lambda mi, *how: _load_xml(mi, path, *how)
    raise RenderError(
        f"scene is {str(scene)!r} but it is none of {', '.join(ours)} and no .xml file: "
        "pass one of these names or the path of a Mitsuba .xml"
    )


def _load_ours(mi: Any, name: str, width: int | None, height: int | None, move: Sequence[float]) -> tuple[Any, Any]:
    # A scene imports its helpers from the same folder, which is a package only here.
    package = types.ModuleType("mcdenoise_cl_scenes")
    package.__path__ = [str(_scene_folder())]
    sys.modules.setdefault(package.__name__, package)
    build = importlib.import_module(f"{package.__name__}.{name}").build
    config = mi.parser.ParserConfig(mi.variant())
    size = _size(DEFAULT_SIZE, width, height)
    return _instantiate(mi, config, mi.parser.parse_dict(config, build(*size)), *size, move)


def _load_xml(mi: Any, path: Path, width: int | None, height: int | None, move: Sequence[float]) -> tuple[Any, Any]:
    config = mi.parser.ParserConfig(mi.variant())
    before = mi.file_resolver()
    # Textures and meshes are named relative to the scene file.
    resolver = mi.FileResolver(before)
    resolver.prepend(str(path.resolve().parent))
    mi.set_file_resolver(resolver)
    try:
        return _instantiate(mi, config, mi.parser.parse_file(config, str(path)), width, height, move)
    finally:
        mi.set_file_resolver(before)


def _instantiate(
    mi: Any, config: Any, state: Any, width: int | None, height: int | None, move: Sequence[float]
) -> tuple[Any, Any]:
    """Build the parsed scene with our film and sampler in its first camera, and its integrator wrapped for features."""
    # Merged meshes stand in an order that changes from one load to the next, and with it which light a path asks.
    config.merge_meshes = False
    mi.parser.transform_all(config, state)
    cameras = [node for node in state.nodes if node.type == mi.ObjectType.Sensor]
    if not cameras:
        raise RenderError("the scene has no sensor but a camera is needed: add a <sensor> with a position to the file")
    _replace_film(mi, state, cameras[0].props, width, height)
    if any(move):
        _move(mi, cameras[0].props, move)
    given = any(node.type == mi.ObjectType.Integrator for node in state.nodes)
    scene = mi.parser.instantiate(config, state)
    scene = scene[0] if isinstance(scene, list) else scene
    inner = scene.integrator() if given else {"type": "path", "max_depth": 9}
    # `aov` by itself traces every path twice, once for colour and once for the features; inside `moment` only once.
    wrapped = {"type": "moment", "image": {"type": "aov", "aovs": AOVS, "color": inner}}
    return scene, mi.load_dict(wrapped)


def _move(mi: Any, camera: Any, move: Sequence[float]) -> None:
    """Move a camera in its own frame, in which Mitsuba looks along z with x to the left."""
    right, up, forward = (float(value) for value in move)
    place = camera["to_world"] if "to_world" in camera else mi.ScalarAffineTransform4d()
    camera["to_world"] = place @ type(place)().translate([-right, up, forward])


def _replace_film(mi: Any, state: Any, camera: Any, width: int | None, height: int | None) -> None:
    """Give a camera a box-filtered film, as large as its own or as asked for, and the independent sampler."""
    film = {}
    for key, value in list(camera.items()):
        node = state.nodes[value.index()] if isinstance(value, mi.Properties.ResolvedReference) else None
        if node is not None and node.type in (mi.ObjectType.Film, mi.ObjectType.Sampler):
            film |= dict(node.props.items()) if node.type == mi.ObjectType.Film else {}
            del camera[key]
    natural = (film.get("width", 768), film.get("height", 576))  # Mitsuba's own default
    size = _size(natural, width, height)
    # A crop window counts pixels, so it means nothing at another size.
    crop = {key: film[key] for key in film if key.startswith("crop_") and size == natural}
    ours = {"type": "hdrfilm", "pixel_format": "rgb", "component_format": "float32", "rfilter": {"type": "box"}}
    camera["film"] = mi.load_dict(ours | {"width": size[0], "height": size[1]} | crop)
    camera["sampler"] = mi.load_dict({"type": "independent"})


def _size(natural: tuple[int, int], width: int | None, height: int | None) -> tuple[int, int]:
    if width is None and height is None:
        return natural
    if height is None:
        return width, max(1, round(width * natural[1] / natural[0]))
    return (max(1, round(height * natural[0] / natural[1])) if width is None else width), height


@contextmanager
def _quiet(mi: Any, variant: str) -> Iterator[None]:
    """Mitsuba with our variant and without its own messages; both as before afterwards."""
    variant_before, level_before = mi.variant(), mi.logger().log_level()
    mi.set_variant(variant)
    mi.set_log_level(mi.LogLevel.Error)
    try:
        yield
    finally:
        mi.set_log_level(level_before)
        if variant_before:
            mi.set_variant(variant_before)


@contextmanager
def _explained(name: str) -> Iterator[None]:
    try:
        yield
    except RenderError:
        raise
    except (RuntimeError, ValueError, TypeError, KeyError, ImportError) as error:
        raise RenderError(f"Mitsuba cannot render {name!r}: {' '.join(str(error).split())}") from error


def _passes(mi, scene, integrator, spp, parts, seed) -> Iterator[tuple[int, int, np.ndarray, np.ndarray]]:
    """Render in passes of bounded size, the parts in turn: (part, samples, means, mean squares) in `CHANNELS` order."""
    width, height = scene.sensors()[0].film().crop_size()
    share = spp // parts
    count = -(-share // max(1, PASS_PATHS // (width * height)))
    sizes = [share // count + (i < share % count) for i in range(count)]
    # Seeds in a row would let a frame of seed 1 repeat samples of a longer one of seed 0.
    seeds = iter(np.random.SeedSequence(seed).generate_state(count * parts))
    names = integrator.aov_names()
    means, squares = ([names.index(f"{prefix}image.{channel}") for channel in CHANNELS] for prefix in ("", "m2_"))
    for size in sizes:
        for part in range(parts):
            image = np.array(mi.render(scene, integrator=integrator, spp=size, seed=int(next(seeds))), np.float64)
            # The film's own R, G and B come before the channels that the integrator names.
            image = image[..., -len(names) :]
            yield part, size, image[..., means], image[..., squares]


class _Moments:
    """Running mean and sum of squared deviations of each channel, pass by pass, in float64."""

    def __init__(self) -> None:
        self.count, self.mean, self.deviations = 0, 0.0, 0.0

    def add(self, count: int, mean: np.ndarray, deviations: np.ndarray) -> None:
        """Merge another group of samples (Chan, Golub and LeVeque 1979)."""
        total, step = self.count + count, mean - self.mean
        self.deviations = self.deviations + deviations + step**2 * (self.count * count / total)
        self.mean = self.mean + step * (count / total)
        self.count = total


def _frame(parts: list[_Moments], metadata: dict[str, Any]) -> Frame:
    whole = _Moments()
    for part in parts:
        whole.add(part.count, part.mean, part.deviations)
    planes = _split(whole.mean)
    if whole.count > 1:
        variances = _split(whole.deviations / (whole.count - 1) / whole.count)
        planes |= {f"{name}_variance": plane for name, plane in variances.items()}
    if len(parts) == 2:
        planes["color_a"], planes["color_b"] = (_split(part.mean)["color"] for part in parts)
        planes["color"] = (planes["color_a"] + planes["color_b"]) / 2
    return Frame(**planes, metadata={**metadata, "exposure_scale": exposure_scale(planes["color"])})


def _split(channels: np.ndarray) -> dict[str, np.ndarray]:
    channels = channels.astype(np.float32)
    planes = {name: np.ascontiguousarray(channels[..., 3 * i : 3 * i + 3]) for i, name in enumerate(VECTORS)}
    return planes | {"depth": np.ascontiguousarray(channels[..., 9])}


def exposure_scale(color: np.ndarray) -> float:
    """The factor that brings a scene-linear image, (H, W, 3), to a middling brightness for display.

    The median luminance over blocks of 8 x 8 pixels becomes 0.18. Blocks, so that noise does not move the median;
    black blocks are left out, so that an object before nothing is not overexposed. An all-black image gives 1.

    Example:
        >>> round(exposure_scale(np.full((16, 16, 3), 0.36, np.float32)), 3)
        0.5
    """
    luminance = np.nan_to_num(color.astype(np.float64) @ (0.2126, 0.7152, 0.0722), posinf=0, neginf=0)
    rows, columns = (np.arange(0, size, 8) for size in luminance.shape)
    sums = np.add.reduceat(np.add.reduceat(luminance, rows, 0), columns, 1)
    areas = np.outer(np.diff([*rows, luminance.shape[0]]), np.diff([*columns, luminance.shape[1]]))
    blocks = sums / areas
    return float(MIDDLE_GREY / np.median(blocks[blocks > 0])) if (blocks > 0).any() else 1.0
