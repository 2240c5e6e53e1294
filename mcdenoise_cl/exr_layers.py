"""Which layer of an EXR file is which plane of a `Frame`: names only, no pixels and no files."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from .errors import ExrError
from .frame import PLANES, SCALAR_PLANES

#: The channels under which this project writes a plane.
OWN_CHANNELS: dict[str, tuple[str, ...]] = {
    "color": ("R", "G", "B"),
    "albedo": ("albedo.R", "albedo.G", "albedo.B"),
    "normal": ("N.X", "N.Y", "N.Z"),
    "depth": ("Z",),
    "color_variance": ("variance.R", "variance.G", "variance.B"),
    "albedo_variance": ("albedo_variance.R", "albedo_variance.G", "albedo_variance.B"),
    "normal_variance": ("N_variance.X", "N_variance.Y", "N_variance.Z"),
    "depth_variance": ("Z_variance",),
    "color_a": ("half_a.R", "half_a.G", "half_a.B"),
    "color_b": ("half_b.R", "half_b.G", "half_b.B"),
}

#: The layer names of each plane, the preferred one first. A name stands for a layer called so, or ending in "." and
#: the name ("Combined" finds "ViewLayer.Combined"), whatever its case. "" is the plain R G B of a file.
NAMES: dict[str, tuple[str, ...]] = {
    # Cycles keeps the rendered image as "Noisy Image" when it has denoised "Combined" itself.
    "color": ("noisy image", "", "rgba", "rgb", "combined", "beauty", "color"),
    # Cycles: "Denoising ..."; Arnold: "denoise_albedo", with the suffix "_noice" where its denoiser added the AOV.
    "albedo": ("denoising albedo", "albedo", "denoise_albedo", "denoise_albedo_noice", "diffuse_albedo"),
    # pbrt-v4 has the shading normal "Ns" beside the geometric "N"; "nn" is the name in Mitsuba's manual.
    "normal": (
        "denoising normal",
        *("ns", "sh_normal", "shading_normal", "nn", "n", "n_noice", "normal", "normals"),
        *("geo_normal", "geometric_normal"),
    ),
    # Early pbrt-v4 wrote the camera-space position as Px Py Pz. Later files are left out: "P" can be in world space
    # there, and nothing in the file tells.
    "depth": ("denoising depth", "depth", "z", "z_noice", "dd.y", "pz"),
    # Arnold's "variance" is taken as it stands.
    "color_variance": ("variance",),
    "albedo_variance": ("albedo_variance",),
    "normal_variance": ("n_variance", "normal_variance"),
    "depth_variance": ("z_variance", "depth_variance"),
    "color_a": ("half_a",),
    "color_b": ("half_b",),
}

#: Layers with three components that are never a normal.
NOT_NORMALS = frozenset(
    (
        *("p", "pos", "position", "positions", "pref", "pworld", "world_position", "worldpos", "point", "points"),
        *("motion", "motionvector", "motion_vector", "motionvectors", "mv", "velocity", "vel", "v", "vector"),
        *("uv", "uvs", "st", "tangent", "bitangent", "binormal", "dp_du", "dp_dv", "dpdu", "dpdv"),
    )
)
NONE = ("", "none")
#: What a user calls motion vectors, which are recognised by name alone and can only be left out.
MOTION = "motion"
PLAIN = ("rgb", "rgba", "r g b", "r g b a")


@dataclass(frozen=True)
class Layer:
    """A group of channels that belong together.

    `name` is what comes before the last dot of the channel names, preceded by the part's name in a file of many
    parts; "" is the plain R G B. `suffix` is "RGB", "RGBA", "XYZ", "XYZW", or what follows the dot in a layer of one
    channel. `channels` are the names in the file, three or one, without A and W.
    """

    name: str
    suffix: str
    part: int
    channels: tuple[str, ...]
    #: Left over beside a vector ("vel.W"): only its full name finds it.
    stray: bool = False

    @property
    def title(self) -> str:
        """The name a user sees and can give back."""
        return self.name or "RGB"

    @property
    def parent(self) -> str:
        return self.name.rpartition(".")[0]

    def answers_to(self, name: str) -> bool:
        own = self.name.casefold()
        return own == name or (name != "" and not self.stray and own.endswith("." + name))


def group_layers(parts: Sequence[tuple[str, Iterable[str]]]) -> list[Layer]:
    """The layers of a file, from the name and the channel names of each of its parts.

    Example:
        >>> [layer.title for layer in group_layers([("", ["R", "G", "B", "Z", "N.X", "N.Y", "N.Z"])])]
        ['RGB', 'Z', 'N']
    """
    layers = []
    for index, (part, channels) in enumerate(parts):
        groups: dict[str, dict[str, str]] = defaultdict(dict)
        for channel in channels:
            full = channel
            if len(parts) > 1 and part and not channel.casefold().startswith(part.casefold() + "."):
                full = f"{part}.{channel}"
            prefix, _, suffix = full.rpartition(".")
            groups[prefix][suffix] = channel
        for prefix, group in groups.items():
            layers += _group(prefix, group, index)
    return layers


def _group(name: str, group: dict[str, str], part: int) -> list[Layer]:
    """The layers among the channels that share what comes before their last dot; `group` is suffix -> channel."""
    by_letter = {suffix.upper(): suffix for suffix in group}
    has_colour = all(c in by_letter for c in "RGB")
    # The plain X, Y and Z of a file are not one layer: Z alone is depth.
    has_vector = name != "" and all(c in by_letter for c in "XYZ")
    found, used = [], set()
    for letters, extra, present in (("RGB", "A", has_colour), ("XYZ", "W", has_vector)):
        if present:
            suffix = letters + (extra if extra in by_letter else "")
            used |= {by_letter[c] for c in suffix}
            found.append(Layer(name, suffix, part, tuple(group[by_letter[c]] for c in letters)))
    rest = [suffix for suffix in group if suffix not in used]
    if name and not found and len(rest) == 1:
        return [Layer(name, rest[0], part, (group[rest[0]],))]
    # "Nx", "Ny", "Nz": vectors of early pbrt-v4. Their channels stay layers of their own too, for "Pz".
    for stem in dict.fromkeys(suffix[:-1] for suffix in rest if suffix[-1:] == "x" and len(suffix) > 1):
        if all(stem + c in group for c in "xyz"):
            found.append(Layer(_join(name, stem), "XYZ", part, tuple(group[stem + c] for c in "xyz")))
    # A Z beside a colour is the depth of that image; beside other channels, as in a 2D vector, it is nothing we know.
    stray = name != "" and not has_colour
    return found + [Layer(_join(name, s), s, part, (group[s],), stray) for s in rest]


def _join(prefix: str, name: str) -> str:
    return f"{prefix}.{name}" if prefix else name


def moment_base(layer: Layer) -> str | None:
    """The name of the layer whose second moment this is, by Mitsuba's prefix "m2_", or None.

    Example:
        >>> moment_base(Layer("m2_inner.albedo", "RGB", 0, ()))
        'inner.albedo'
    """
    words = layer.name.split(".")
    for i, word in enumerate(words):
        if word.startswith("m2_"):
            return ".".join([*words[:i], word.removeprefix("m2_"), *words[i + 1 :]])
    return None


def describe(layers: Iterable[Layer]) -> str:
    """A list of layers for a message."""
    return ", ".join(dict.fromkeys(layer.title for layer in layers)) or "none"


def find_wanted(layers: Sequence[Layer], wanted: Mapping[str, str]) -> dict[str, Layer | None]:
    """The layers a user asked for, by plane; None for a plane that is to be left out.

    Raises:
        ExrError: one is not there, could be several, or has not as many channels as its plane needs.
    """
    if wanted.get("color", "RGB").casefold() in NONE:
        raise ExrError("color cannot be left out: give the name of a layer, for instance --layer color=RGB")
    return {
        plane: None if name.casefold() in NONE else _find_named(layers, plane, name) for plane, name in wanted.items()
    }


def find_color(layers: Sequence[Layer]) -> Layer:
    """The colour layer: the first of `NAMES` that is there.

    Raises:
        ExrError: there is none, or more than one.
    """
    candidates = [c for c in layers if c.suffix.startswith("RGB") and moment_base(c) is None]
    for name in NAMES["color"]:
        found = [c for c in candidates if c.answers_to(name)]
        # Blender's compositor adds its own "Composite.Combined".
        found = [c for c in found if not c.name.casefold().startswith("composite.")] or found
        if len(found) == 1:
            return found[0]
        if found:
            raise ExrError(
                f"{describe(found)} could each be the colour: choose one, for instance --layer color='{found[0].title}'"
            )
    # In a file of many parts the plain R G B carries the name of its part, whatever that is: the first such part.
    plain = [c for c in candidates if all("." not in channel for channel in c.channels) and _plane_of(c) is None]
    if plain:
        return plain[0]
    raise ExrError(
        f"no RGB colour was recognised among the layers {describe(layers)}: say which one it is with "
        "--layer color=NAME (layers={'color': 'NAME'} in Python)"
    )


def result_layer(layers: Sequence[Layer], color: Layer) -> Layer:
    """Where a denoised `color` goes: its own place, or "Combined", which viewers show, for Cycles' "Noisy Image"."""
    if not color.answers_to("noisy image"):
        return color
    beside = [c for c in layers if c.parent == color.parent and c.part == color.part and c.answers_to("combined")]
    return beside[0] if beside else color


def _plane_of(layer: Layer) -> str | None:
    return next((plane for plane in NAMES if any(layer.answers_to(name) for name in NAMES[plane])), None)


def _find_named(layers: Sequence[Layer], plane: str, wanted: str) -> Layer:
    """The layer called `wanted`: the name of a layer or of a channel, or channel names separated by commas."""
    count = 1 if plane in SCALAR_PLANES else 3
    key = wanted.strip().casefold()
    fits = [layer for layer in layers if len(layer.channels) == count]
    found = [layer for layer in fits if layer.name == wanted] or [c for c in fits if c.name.casefold() == key]
    found = found or [layer for layer in fits if layer.answers_to(key)]
    if not found and key in PLAIN:
        found = [layer for layer in fits if layer.name == ""]
    if not found:
        found = _from_channels(layers, [name.strip() for name in wanted.split(",")], count)
    if len(found) == 1:
        return found[0]
    if found:
        raise ExrError(f"{plane}={wanted} could be any of {describe(found)}: give the full name")
    other = next((c for c in layers if c.answers_to(key) or (key in PLAIN and c.name == "")), None)
    if other is not None:
        needs = "one channel" if count == 1 else "three channels"
        hint = f"name one, for instance {plane}={other.channels[-1]}" if count == 1 else "name another layer"
        raise ExrError(f"{plane} needs {needs} but the layer {wanted} has {', '.join(other.channels)}: {hint}")
    raise ExrError(f"{plane}={wanted} is not in the file: its layers are {describe(layers)}")


def _from_channels(layers: Sequence[Layer], names: list[str], count: int) -> list[Layer]:
    """Layers made of the named channels, one for each part that has them all."""
    if len(names) != count:
        return []
    if known := [layer for layer in layers if layer.channels == tuple(names)]:
        return known
    parts: dict[int, set[str]] = defaultdict(set)
    for layer in layers:
        parts[layer.part].update(layer.channels)
    return [Layer(",".join(names), "", part, tuple(names)) for part, have in parts.items() if have.issuperset(names)]


def find_planes(
    layers: Sequence[Layer],
    color: Layer,
    wanted: Mapping[str, Layer | None],
    *,
    from_mitsuba: bool,
    is_direction: Callable[[Layer], bool],
) -> dict[str, Layer]:
    """The layer of every plane that is recognised or asked for, `color` included.

    A variance plane may come out as a layer of second moments (`moment_base` tells). A plane with two layers that
    could be it is left out. `is_direction` says whether the pixels of a layer could be mean unit vectors.
    """
    found = {"color": color}
    for plane in PLANES[1:]:
        layer = wanted[plane] if plane in wanted else _by_name(layers, plane, color)
        if layer is not None:
            found[plane] = layer
    for plane in ("albedo", "normal", "depth"):
        if plane not in found and plane not in wanted:
            guess = _by_suffix(layers, plane, found, from_mitsuba, is_direction)
            if len(guess) == 1:
                found[plane] = guess[0]
    for plane in ("color", "albedo", "normal", "depth"):
        variance = f"{plane}_variance"
        if plane in found and variance not in found and variance not in wanted:
            moments = _moments_of(layers, plane, found[plane])
            if len(moments) == 1:
                found[variance] = moments[0]
    return {plane: layer for plane, layer in found.items() if plane in wanted or _has_company(plane, found)}


def _has_company(plane: str, found: Mapping[str, Layer]) -> bool:
    """Whether a plane that was recognised, not asked for, has the planes without which a `Frame` refuses it."""
    partner = {"color_a": "color_b", "color_b": "color_a"}.get(plane, plane.removesuffix("_variance"))
    return partner in found


def _by_name(layers: Sequence[Layer], plane: str, color: Layer) -> Layer | None:
    # pbrt-v4's "Variance" is not the variance of the pixel mean, and cannot be turned into it: it is that of single
    # samples, counts only those that hit a surface, and is taken before the colour matrix (of CIE XYZ by default).
    if plane == "color_variance" and any(layer.answers_to("relativevariance") for layer in layers):
        return None
    count = 1 if plane in SCALAR_PLANES else 3
    fits = [c for c in layers if len(c.channels) == count and c.suffix != "XYZW" and moment_base(c) is None]
    for name in NAMES[plane]:
        found = [layer for layer in fits if layer.answers_to(name) and layer != color]
        if len(found) > 1:
            # Of several view layers, or views in parts of their own: the one the colour belongs to.
            found = [layer for layer in found if layer.parent in (color.parent, color.name)] or found
        if found:
            return found[0] if len(found) == 1 else None
    return None


def _by_suffix(
    layers: Sequence[Layer],
    plane: str,
    found: Mapping[str, Layer],
    from_mitsuba: bool,
    is_direction: Callable[[Layer], bool],
) -> list[Layer]:
    """The layers that could be a plane by their kind of channels, whatever the user called them."""
    moments = {moment_base(layer): layer for layer in layers if moment_base(layer) is not None}
    free = [c for c in layers if moment_base(c) is None and _plane_of(c) is None and c not in found.values()]
    if plane == "normal":
        # In a layer of moments the last word has the prefix only for the colour in CIE XYZ, which Mitsuba's `moment`
        # adds under the bare name of its integrator. It looks like a normal and is none.
        cie = {base for base, moment in moments.items() if moment.name.split(".")[-1].startswith("m2_")}
        free = [c for c in free if c.suffix == "XYZ" and c.name not in cie]
        free = [c for c in free if c.name.split(".")[-1].casefold() not in NOT_NORMALS]
        return [layer for layer in free if is_direction(layer)]
    if not (from_mitsuba or moments):
        return []
    # Mitsuba's albedo has no A, an integrator's result has; only depth has the suffix T.
    return [layer for layer in free if layer.suffix == ("RGB" if plane == "albedo" else "T")]


def _moments_of(layers: Sequence[Layer], plane: str, layer: Layer) -> list[Layer]:
    """The second moments of a layer. Those of the plain R G B stand under the name of Mitsuba's nested integrator,
    and are told from an albedo's by their A."""
    moments = [m for m in layers if moment_base(m) is not None and len(m.channels) == len(layer.channels)]
    own = [m for m in moments if moment_base(m) == layer.name]
    if own or plane != "color":
        return own
    return [m for m in moments if m.suffix == "RGBA"]
