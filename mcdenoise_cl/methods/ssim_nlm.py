"""`ssim-nlm`: the paper's method (Yang 2022, eqs. 1-8), as printed or stabilised."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..engine import Engine, Planes
from ..stages.box import rows_each
from ..stages.canny import albedo_luminance, canny
from ..stages.guided import guided_filter, references
from ..stages.nlm import SsimTerm
from ..stages.pad import pad
from ..stages.rows import Rows
from ..stages.source import Source
from ..stages.ssim import patch_statistics
from . import nlm
from .facts import Facts
from .parameters import parameter
from .result import Result

NAME = "ssim-nlm"
SUMMARY = "the paper's method: NLM whose weights are bent by the structural similarity of the normals"
NEEDS = ("albedo", "normal")
USES: tuple[str, ...] = ()


@dataclass(frozen=True)
class Parameters(nlm.Parameters):
    """The paper's windows; the choices it leaves open by measurement (bench/sweep.py)."""

    h_factor: float = parameter(1.2, "strength: h is this many times the frame's own noise level", low=0.0)
    stabilised: bool = parameter(
        True, "false: eq. 8 exactly as printed (its center is one), which ignores colours where normals are equal"
    )
    stabiliser: float = parameter(0.3, "what the stabilised form adds to ln(1/SSIM)", low=0.0)
    canny_sigma: float = parameter(1.4, "Gaussian before Canny, standard deviation in pixels", low=0.0, high=32)
    canny_low: float | None = parameter(
        None, "lower threshold on the Sobel gradient of the albedo; none: 0.67 median", kind=float, low=0.0
    )
    canny_high: float | None = parameter(
        None, "upper threshold on the Sobel gradient of the albedo; none: 1.33 median", kind=float, low=0.0
    )
    guided_radius: int = parameter(1, "windows of the guided filter are (2 r + 1)² pixels", low=0, high=1024)
    guided_epsilon: float = parameter(1e-2, "regularisation of the guided filter", low=1e-12)
    ssim_c1: float = parameter(1e-4, "constant of SSIM's luminance term, range 1", low=1e-12)
    ssim_c2: float = parameter(9e-4, "constant of SSIM's contrast term, range 1; C3 is half of it", low=1e-12)


def survey(engine: Engine, source: Source, p: Parameters) -> Facts:
    """What bands need to know of the whole frame: edges are linked over all of it."""
    facts = nlm.survey(engine, source, p)
    gray = engine.planes(1, source.height, source.width)
    for albedo, rows in source.sweep("albedo"):
        albedo_luminance(engine, albedo, gray.rows(rows.first, rows.last - rows.first))
    edges = canny(engine, gray, p.canny_low, p.canny_high, p.canny_sigma)
    middle = source.height // 2
    normal = source.planes(Rows(middle, middle + 1, middle, middle + 1), ["normal"])["normal"]
    return replace(facts, edges=edges, references=references(engine, edges.rows(middle, 1), normal))


def reach(p: Parameters) -> int:
    """Rows that a pixel depends on to each side."""
    return nlm.reach(p) + 2 * p.guided_radius


def align(engine: Engine, p: Parameters) -> int:
    """Means begin with the first row."""
    return rows_each(engine, p.guided_radius)


def run(engine: Engine, planes: dict[str, Planes], p: Parameters, facts: Facts | None = None) -> Result:
    """Door to exit without the door and the exit: planes in, planes out."""
    if facts is None:
        gray = albedo_luminance(engine, planes["albedo"])
        edges, start = canny(engine, gray, p.canny_low, p.canny_high, p.canny_sigma), None
    else:
        edges, start = facts.edges.rows(facts.rows.start, facts.rows.stop - facts.rows.start), facts.references
    normal = guided_filter(engine, edges, planes["normal"], p.guided_radius, p.guided_epsilon, start)
    border = p.search_radius + p.patch_radius
    unit = pad(engine, normal, border, 0.5, 0.5)  # [-1, 1] to [0, 1]
    stats = pad(engine, patch_statistics(engine, unit, p.patch_radius), border)
    if not p.stabilised:
        p = replace(p, stabiliser=0.0, center="one")
    term = SsimTerm(unit, stats, p.ssim_c1, p.ssim_c2, p.stabiliser)
    return nlm.filter_colors(engine, planes, p, term, facts)
