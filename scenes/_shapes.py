"""Building blocks of the scenes: a `Model` collects boxes, turned parts, cushions, lights and a camera (metres, z up).

Small parts are gathered into one mesh per material, so that a room of a thousand boxes loads in a moment.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise

import mitsuba as mi
import numpy as np

Vector = Sequence[float]


def matte(color) -> dict:
    """Diffuse paint or cloth; `color` is an RGB triple or a texture."""
    return {"type": "diffuse", "reflectance": _spectrum(color)}


def varnish(color, roughness: float = 0.1) -> dict:
    """A diffuse base under a clear coat: lacquer, ceramic, polished floors."""
    return {"type": "roughplastic", "diffuse_reflectance": _spectrum(color), "alpha": roughness, "nonlinear": True}


def metal(name: str, roughness: float = 0.15) -> dict:
    """A rough conductor by Mitsuba's material name, for instance `Cu` or `Al`."""
    return {"type": "roughconductor", "material": name, "alpha": roughness}


def glass() -> dict:
    """Clear glass for closed bodies: it refracts."""
    return {"type": "dielectric", "int_ior": 1.5}


def pane() -> dict:
    """Clear glass for single sheets: light passes straight on."""
    return {"type": "thindielectric", "int_ior": 1.5}


def texture(pixels: np.ndarray, size: Vector = (1.0, 1.0)) -> dict:
    """Linear RGB pixels repeated every `size` units of texture space (metres, except on a `picture`)."""
    return {
        "type": "bitmap",
        "bitmap": mi.Bitmap(np.ascontiguousarray(pixels[::-1], dtype=np.float32)),
        "raw": True,
        "to_uv": mi.ScalarTransform4f().scale([1 / size[0], 1 / size[1], 1]),
    }


def _spectrum(color) -> dict:
    return color if isinstance(color, dict) else {"type": "rgb", "value": list(color)}


class Model:
    """A scene under construction. Coordinates are taken in the current frame, which `at` moves."""

    def __init__(self, **materials: dict) -> None:
        self.materials = materials
        self._frame = np.eye(4)
        self._grids: dict[str, list[tuple[np.ndarray, ...]]] = {name: [] for name in materials}
        self._shapes: dict[str, dict] = {}
        self._random = np.random.default_rng(7)

    @contextmanager
    def at(self, x: float = 0, y: float = 0, z: float = 0, turn: float = 0, tilt: float = 0) -> Iterator[None]:
        """Move the frame to a point, turn it about z, then tilt it about its own y (degrees)."""
        outer = self._frame
        cz, sz, cy, sy = (f(np.radians(a)) for a in (turn, tilt) for f in (np.cos, np.sin))
        about_z = np.array([[cz, -sz, 0, x], [sz, cz, 0, y], [0, 0, 1, z], [0, 0, 0, 1]])
        about_y = np.array([[cy, 0, sy, 0], [0, 1, 0, 0], [-sy, 0, cy, 0], [0, 0, 0, 1]])
        self._frame = outer @ about_z @ about_y
        try:
            yield
        finally:
            self._frame = outer

    def box(self, material: str, low: Vector, high: Vector) -> None:
        """A box between two corners; its texture runs along each face's longer side, from a random start."""
        low, high = np.minimum(low, high), np.maximum(low, high)
        start = self._random.uniform(0, 64, size=2)
        for axis in range(3):
            across, along = sorted((i for i in range(3) if i != axis), key=lambda i: high[i] - low[i])
            u, v = np.zeros(3), np.zeros(3)
            u[along], v[across] = (high - low)[along], (high - low)[across]
            outward = np.eye(3)[axis]
            self._sheet(material, low, u, v, -outward, start)
            self._sheet(material, low + (high - low) * outward, u, v, outward, start)

    def sheet(self, material: str, corner: Vector, u: Vector, v: Vector) -> None:
        """A parallelogram facing u x v, textured in metres."""
        u, v = np.array(u, float), np.array(v, float)
        self._sheet(material, np.array(corner, float), u, v, np.cross(u, v), np.zeros(2))

    def picture(self, material: str, corner: Vector, u: Vector, v: Vector) -> None:
        """A parallelogram facing u x v whose texture is stretched over it once."""
        u, v = np.array(u, float), np.array(v, float)
        self._sheet(material, np.array(corner, float), u, v, np.cross(u, v), np.zeros(2), np.ones(2))

    def _sheet(self, material, corner, u, v, normal, start, extent=None) -> None:
        extent = np.array([np.linalg.norm(u), np.linalg.norm(v)]) if extent is None else extent
        s, t = np.meshgrid([0.0, 1.0], [0.0, 1.0], indexing="ij")
        points = corner + s[..., None] * u + t[..., None] * v
        uv = start + np.stack([s * extent[0], t * extent[1]], -1)
        self._grid(material, points, np.broadcast_to(normal / np.linalg.norm(normal), points.shape), uv)

    def lathe(self, material: str, profile: Sequence[Vector], base: Vector = (0, 0, 0), sides: int = 24) -> None:
        """Turn (radius, height) points about z. A point given twice in a row makes a crease."""
        runs, run = [], [profile[0]]
        for before, point in pairwise(profile):
            if tuple(before) == tuple(point):
                runs, run = [*runs, run], []
            run.append(point)
        phi = np.linspace(0, 2 * np.pi, sides + 1)
        for points in (np.array(r, float) for r in [*runs, run] if len(r) > 1):
            radius, height = points.T
            slope_r, slope_z = np.gradient(radius), np.gradient(height)
            ring = np.stack([np.cos(phi), np.sin(phi), np.zeros_like(phi)], -1)
            up = np.array([0.0, 0.0, 1.0])
            body = radius[:, None, None] * ring + height[:, None, None] * up + np.array(base, float)
            normals = slope_z[:, None, None] * ring - slope_r[:, None, None] * up
            length = np.concatenate([[0], np.cumsum(np.hypot(np.diff(radius), np.diff(height)))])
            uv = np.stack(np.meshgrid(length, phi * radius.max(), indexing="ij"), -1)
            self._grid(material, body, normals / np.linalg.norm(normals, axis=-1, keepdims=True), uv)

    def rod(self, material: str, start: Vector, end: Vector, radius: float, end_radius: float | None = None) -> None:
        """A round bar with closed ends between two points; tapered when `end_radius` is given."""
        start, end = np.array(start, float), np.array(end, float)
        x, y, z = end - start
        length, flat = np.linalg.norm(end - start), np.hypot(x, y)
        end_radius = radius if end_radius is None else end_radius
        profile = [(0, 0), (radius, 0), (radius, 0), (end_radius, length), (end_radius, length), (0, length)]
        with self.at(*start, turn=np.degrees(np.arctan2(y, x)), tilt=np.degrees(np.arctan2(flat, z))):
            self.lathe(material, profile, sides=12)

    def cushion(self, material: str, center: Vector, size: Vector, squareness: float = 0.5, detail: int = 24) -> None:
        """A superellipsoid of full `size`: squareness 0 is an ellipsoid, towards 1 it becomes a box."""
        power = 1 - squareness
        latitude, longitude = np.linspace(-0.5, 0.5, detail + 1), np.linspace(-1, 1, 2 * detail + 1)
        eta, omega = np.meshgrid(np.pi * latitude, np.pi * longitude, indexing="ij")

        def bent(exponent: float) -> np.ndarray:
            cos_eta, sin_eta, cos_omega, sin_omega = (
                np.sign(wave) * np.abs(wave) ** exponent
                for angle in (eta, omega)
                for wave in (np.cos(angle), np.sin(angle))
            )
            return np.stack([cos_eta * cos_omega, cos_eta * sin_omega, sin_eta], -1)

        half = np.array(size, float) / 2
        normals = bent(2 - power) / half
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        points = np.array(center, float) + bent(power) * half
        self._grid(material, points, normals, points[..., :2] + points[..., 2:])

    def _grid(self, material: str, points: np.ndarray, normals: np.ndarray, uv: np.ndarray) -> None:
        """Add quads between neighbouring points, wound so that they face the same way as their normals."""
        rows, columns = points.shape[:2]
        index = np.arange(rows * columns).reshape(rows, columns)
        a, b, c, d = (x.ravel() for x in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
        faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)])
        points, normals = points.reshape(-1, 3), normals.reshape(-1, 3)
        corners = points[faces]
        facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        if np.sum(facing * normals[faces[:, 0]]) < 0:
            faces = faces[:, ::-1]
        rotation, offset = self._frame[:3, :3], self._frame[:3, 3]
        part = (points @ rotation.T + offset, normals @ rotation.T, uv.reshape(-1, 2), faces)
        self._grids[material].append(part)

    def sphere(self, bsdf: dict, center: Vector, radius: float, radiance: Vector | None = None) -> None:
        """One of Mitsuba's spheres; with `radiance` it is a lamp."""
        place = self._frame @ np.array([*center, 1.0])
        self._add({"type": "sphere", "center": list(place[:3]), "radius": radius, "bsdf": bsdf}, radiance)

    def tube(self, bsdf: dict, start: Vector, end: Vector, radius: float, radiance: Vector | None = None) -> None:
        """One of Mitsuba's open cylinders; with `radiance` it is a lamp."""
        p0, p1 = (list((self._frame @ np.array([*p, 1.0]))[:3]) for p in (start, end))
        self._add({"type": "cylinder", "p0": p0, "p1": p1, "radius": radius, "bsdf": bsdf}, radiance)

    def panel(self, corner: Vector, u: Vector, v: Vector, radiance, share: float = 0.5) -> None:
        """A rectangular light that shines towards u x v; `radiance` is an RGB triple or a texture.

        `share` says how often a path asks this light, beside 1 for the sun and 0.15 for a lamp.
        """
        corner, u, v = (np.array(x, float) for x in (corner, u, v))
        matrix = np.eye(4)
        normal = np.cross(u, v)
        matrix[:3] = np.stack([u / 2, v / 2, normal / np.linalg.norm(normal), corner + (u + v) / 2], -1)
        to_world = mi.ScalarTransform4f(self._frame @ matrix)
        self._add({"type": "rectangle", "to_world": to_world, "bsdf": matte((0, 0, 0))}, radiance, share)

    def sun(self, direction: Vector, irradiance: Vector) -> None:
        """Parallel light travelling along `direction`: its shadows have hard edges."""
        light = {"type": "directional", "direction": list(direction), "irradiance": _spectrum(irradiance)}
        self._shapes[f"sun{len(self._shapes)}"] = light

    def _add(self, shape: dict, radiance, share: float = 0.15) -> None:
        if radiance is not None:
            shape["emitter"] = {"type": "area", "radiance": _spectrum(radiance), "sampling_weight": share}
        self._shapes[f"shape{len(self._shapes)}"] = shape

    def finish(
        self, eye: Vector, target: Vector, fov: float, size: tuple[int, int], lens: Vector | None = None
    ) -> dict:
        """The whole scene as `mi.load_dict` takes it; `lens` is (aperture radius, distance in focus)."""
        camera = {
            "type": "perspective",
            "fov": fov,
            "near_clip": 0.05,
            "to_world": mi.ScalarTransform4f().look_at(list(eye), list(target), [0, 0, 1]),
            "film": {"type": "hdrfilm", "width": size[0], "height": size[1], "rfilter": {"type": "box"}},
        }
        if lens is not None:
            camera |= {"type": "thinlens", "aperture_radius": lens[0], "focus_distance": lens[1]}
        meshes = {name: self._mesh(name) for name, grids in self._grids.items() if grids}
        integrator = {"type": "path", "max_depth": 9}
        return {"type": "scene", "integrator": integrator, "camera": camera, **meshes, **self._shapes}

    def _mesh(self, name: str) -> dict:
        """One mesh of everything made of this material.

        A mesh made in Python belongs to Python, and scalar Mitsuba then takes the interpreter's lock whenever a thread
        counts a reference to it: AOVs come out ten times slower. Mitsuba's `merge` builds a mesh of its own out of two.
        """
        grids = self._grids[name]
        starts = np.cumsum([0, *(len(points) for points, *_ in grids)])
        points, normals, uv = (np.concatenate([grid[i] for grid in grids]) for i in range(3))
        faces = np.concatenate([grid[3] + start for grid, start in zip(grids, starts[:-1], strict=True)])
        bsdf = mi.load_dict(self.materials[name])
        halves = {f"half{i}": _mesh(points, normals, uv, faces[i::2], bsdf) for i in range(2)}
        return {"type": "merge", **halves}


def _mesh(points: np.ndarray, normals: np.ndarray, uv: np.ndarray, faces: np.ndarray, bsdf):
    props = mi.Properties()
    props["bsdf"] = bsdf
    mesh = mi.Mesh("part", len(points), len(faces), props=props, has_vertex_normals=True, has_vertex_texcoords=True)
    params = mi.traverse(mesh)
    params["vertex_positions"] = points.astype(np.float32).ravel()
    params["vertex_normals"] = normals.astype(np.float32).ravel()
    params["vertex_texcoords"] = uv.astype(np.float32).ravel()
    params["faces"] = faces.astype(np.uint32).ravel()
    params.update()
    return mesh
