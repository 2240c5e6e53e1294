"""Small scenes whose features lie: rendered with Mitsuba, or sampled here, once into the cache folder.

A rendered scene is the body of an XML file, seen by `CAMERA`. A sampled one is a function that follows one ray a pixel:
(x, y, t, rng) -> planes, where x and y are pixels with the place inside them, t in [0, 1) is the time of the ray, and
each is (H, W). All frames have features, variances and half buffers.
"""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable
from pathlib import Path

import numpy as np
from frames import rendered

from mcdenoise_cl import Frame
from mcdenoise_cl.exr import read_exr, write_exr

CACHE = Path("bench/cache/effects")
WIDTH, HEIGHT, SPP, REFERENCE_SPP = 160, 120, 4, 1024

CAMERA = """
<sensor type="{kind}"><float name="fov" value="40"/>{lens}
  <transform name="to_world"><lookat origin="0, -6, 2.2" target="0, 0, 0.8" up="0, 0, 1"/></transform>
</sensor>"""
PINHOLE = CAMERA.format(kind="perspective", lens="")
LENS = CAMERA.format(
    kind="thinlens", lens='<float name="aperture_radius" value="0.12"/><float name="focus_distance" value="7.5"/>'
)
SKY = '<emitter type="constant"><rgb name="radiance" value="{0}, {0}, {0}"/></emitter>'
SUN = """<emitter type="directional"><vector name="direction" value="{0}"/>
  <rgb name="irradiance" value="{1}"/></emitter>"""
LAMP = """
<shape type="sphere"><point name="center" x="{0}" y="{1}" z="{2}"/><float name="radius" value="{3}"/>
  <emitter type="area"><rgb name="radiance" value="{4}"/></emitter></shape>"""


def checks(scale: float, dark: str = "0.1, 0.1, 0.15", light: str = "0.8, 0.75, 0.6") -> str:
    """A diffuse chequered surface with that many checks to a unit of texture space."""
    return f"""<bsdf type="twosided"><bsdf type="diffuse"><texture type="checkerboard" name="reflectance">
      <rgb name="color0" value="{dark}"/><rgb name="color1" value="{light}"/>
      <transform name="to_uv"><scale value="{scale}"/></transform></texture></bsdf></bsdf>"""


def matte(color: str) -> str:
    return f'<bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="{color}"/></bsdf></bsdf>'


def sheet(material: str, scale: str, turn: str = "", place: str = "0, 0, 0") -> str:
    """A rectangle of 2 x 2 units in the x-y plane, scaled, turned and put somewhere."""
    return f"""
<shape type="rectangle">
  <transform name="to_world"><scale value="{scale}"/>{turn}<translate value="{place}"/></transform>
  {material}</shape>"""


def ball(material: str, center: str, radius: float) -> str:
    return f"""
<shape type="sphere"><point name="center" value="{center}"/><float name="radius" value="{radius}"/>{material}</shape>"""


UPRIGHT = '<rotate x="1" angle="90"/>'
FLOOR = sheet(matte("0.5, 0.5, 0.5"), "12")
TILES = sheet(checks(24), "12")
LEAVES = """<bsdf type="mask"><texture type="checkerboard" name="opacity">
    <rgb name="color0" value="0"/><rgb name="color1" value="1"/><transform name="to_uv"><scale value="9"/></transform>
  </texture>{}</bsdf>"""

SCENES = {
    "defocus": LENS
    + SKY.format(0.3)
    + LAMP.format(3, -3, 6, 1, "30, 28, 24")
    + TILES
    + ball(checks(8, "0.6, 0.1, 0.1"), "-0.55, -3, 1.1", 0.45)
    + ball(checks(8, "0.1, 0.5, 0.1"), "1.4, 1.4, 0.8", 0.8)
    + sheet(checks(6), "4, 2, 1", UPRIGHT, "0, 4, 2"),
    "mirror and glass": PINHOLE
    + SKY.format(0.3)
    + LAMP.format(-3, -4, 6, 1.2, "25, 24, 20")
    + TILES
    + sheet(
        '<bsdf type="twosided"><bsdf type="conductor"/></bsdf>',
        "1.3, 1.1, 1",
        UPRIGHT + '<rotate z="1" angle="-25"/>',
        "-1.2, 2, 1.2",
    )
    + ball(matte("0.7, 0.15, 0.1"), "-1, -0.6, 0.4", 0.4)
    + ball('<bsdf type="dielectric"/>', "1, -0.5, 0.75", 0.75)
    + sheet(checks(6, "0.1, 0.2, 0.5"), "4, 2, 1", UPRIGHT, "0, 5, 2"),
    "alpha": PINHOLE
    + SKY.format(1)
    + SUN.format("0.3, 0.6, -1", "2.5, 2.3, 2")
    + FLOOR
    + sheet(LEAVES.format(matte("0.2, 0.5, 0.1")), "1.4, 1, 1", UPRIGHT, "-0.2, 0.5, 1.1")
    + sheet(
        LEAVES.format(matte("0.5, 0.4, 0.1")),
        "0.9, 0.8, 1",
        UPRIGHT + '<rotate z="1" angle="40"/>',
        "0.9, -1, 0.9",
    ),
    "shadow": PINHOLE
    + SKY.format(0.25)
    + SUN.format("0.5, 0.7, -1", "3, 2.8, 2.4")
    + FLOOR
    + "".join(sheet(matte("0.5, 0.5, 0.5"), "0.1, 3, 1", UPRIGHT, f"{x - 3.4}, -3.4, 4.4") for x in range(4)),
    "caustic": PINHOLE
    + SKY.format(0.15)
    + LAMP.format(-2, 2, 5, 0.9, "40, 38, 34")
    + FLOOR
    + ball('<bsdf type="dielectric"/>', "-0.1, 0.4, 1", 0.7),
}


def rendering(name: str, spp: int, seed: int) -> Frame:
    """One of `SCENES`; another description of it is another file, so that no stale frame comes back."""
    body = f'<scene version="3.0.0">{SCENES[name]}</scene>'
    path = CACHE / f"{name.replace(' ', '-')}-{hashlib.sha256(body.encode()).hexdigest()[:8]}.xml"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(body)
    return read_exr(rendered(CACHE, path, spp, WIDTH, HEIGHT, seed, folder=path.stem))


Shade = Callable[[np.ndarray, np.ndarray, np.ndarray, np.random.Generator], dict[str, np.ndarray]]


def sampling(shade: Shade, spp: int, seed: int) -> Frame:
    """A frame of `spp` rays a pixel, an even number; kept like renderings, as long as the function stays the same."""
    version = hashlib.sha256(inspect.getsource(shade).encode()).hexdigest()[:8]
    path = CACHE / f"{shade.__name__}-{version}" / f"spp{spp:04d}.exr"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_exr(path, sampled(shade, spp, seed))
    return read_exr(path)


def sampled(shade: Shade, spp: int, seed: int, width: int = WIDTH, height: int = HEIGHT) -> Frame:
    """Means, variances of the means and half buffers over `spp` rays a pixel."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width]
    sums: dict[str, np.ndarray] = {}
    half: np.ndarray | float = 0.0
    for i in range(spp):
        dx, dy, t = rng.random((3, height, width))
        planes = shade(x + dx, y + dy, t, rng)
        for name, value in planes.items():
            sums[name] = sums.get(name, 0.0) + value
            sums[f"{name}_variance"] = sums.get(f"{name}_variance", 0.0) + value**2
        half = half + planes["color"] * (i % 2)
    means = {name: total / spp for name, total in sums.items()}
    for name in [name for name in means if name.endswith("_variance")]:
        mean = means[name.removesuffix("_variance")]
        means[name] = np.maximum(means[name] - mean**2, 0.0) / max(spp - 1, 1)
    means["color_b"] = half / (spp / 2)
    means["color_a"] = 2 * means["color"] - means["color_b"]
    planes = {name: plane.astype(np.float32) for name, plane in means.items()}
    return Frame(**planes, metadata={"samples_per_pixel": spp})
