"""The page without a browser: how images travel in it, what it says, and that nothing in a name can break it."""

import base64
import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import inputs
import numpy as np
import pytest

from mcdenoise_cl import Denoised, Frame, FrameError, McdenoiseError, ParameterError, denoise
from mcdenoise_cl.metrics import Scores, frame_exposure
from mcdenoise_cl.page import Entry, budget, chart, codec, make_page, planes, write_page
from mcdenoise_cl.page.budget import bytes_for, errors, pack
from mcdenoise_cl.page.planes import STEPS, Plane, quantise, restore

NASTY = "</script><!--<script> \"a\" 'b' & \u2028 é"


@pytest.mark.parametrize("height,width", inputs.SIZES)
@pytest.mark.parametrize("most", [0, 1, 40, 3000, 13000])
def test_numbers_come_back(height, width, most):
    rng = np.random.default_rng([height, width, most])
    for plane in (
        rng.integers(-most, most + 1, (height, width)),
        np.cumsum(rng.integers(-3, 4, (height, width)), axis=1) + most,
    ):
        np.testing.assert_array_equal(codec.decode(codec.encode(plane), height, width), plane)


def test_what_is_smooth_takes_less():
    rng = np.random.default_rng(1)
    noise = rng.integers(0, 256, (64, 64))
    ramp = np.add.outer(np.arange(64), 2 * np.arange(64))
    assert len(codec.encode(noise)) < 1.1 * noise.size
    assert len(codec.encode(ramp)) < 0.1 * ramp.size


def test_numbers_too_far_apart_are_refused():
    with pytest.raises(OverflowError, match="80000 from what its neighbours let expect: 33022 is the most"):
        codec.encode(np.array([[0, 80000]]))


def test_text_opens_no_tag():
    text = codec.as_text(np.random.default_rng(0).bytes(40000))
    assert "<" not in text and text.isascii() and " " not in text


@pytest.mark.parametrize("step", [STEPS[0], STEPS[4], STEPS[-1]])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 40.0])
def test_light_is_as_near_as_the_page_says(step, scale):
    """Against the values themselves in float64, over 24 decades, and on both sides of 0."""
    values = np.concatenate([[0.0], np.geomspace(1e-15, 1e9, 4001)]) / scale
    values = np.concatenate([-values[::-1], values])
    back = restore(quantise(values, scale, step, planes.DARK), scale, step, planes.DARK)
    bound = (np.exp(step / 2) - 1) * (np.abs(values) + planes.DARK / scale)
    assert (np.abs(back - values) <= bound * (1 + 1e-9)).all()
    assert np.abs(back - values).max() > 0.5 * bound.max(), "the bound is not tight"


def test_the_largest_light_can_be_packed():
    values = np.array([[[1e9, -1e9, 3e38], [-3e38, 0, 1e9]]])
    for step in (STEPS[0], STEPS[-1]):
        assert planes.packed(Plane("light", "light", values, step=step))


def test_marks_tell_what_is_not_finite():
    values = np.zeros((2, 2, 3), np.float16)
    assert planes.marks(values) is None
    values[0, 1, 2], values[1, 0, 0], values[1, 1, 1] = np.nan, -np.inf, np.inf
    assert [planes.MARKS[i] for i in planes.marks(values).ravel()] == ["", "NaN", "-Inf", "+Inf"]
    assert planes.marks(np.array([[np.inf, 1.0]])).tolist() == [[2, 0]]


def test_a_budget_is_kept_with_the_finest_step_that_can():
    rng = np.random.default_rng(2)
    light = [Plane(f"{i}", "light", rng.lognormal(0, 1.5, (200, 96, 3)), scale=0.3) for i in range(3)]
    fixed = Plane("normal", "normal", rng.uniform(-1, 1, (200, 96, 3)), step=1 / 127, dark=0.0)
    sizes = [sum(len(planes.packed(replace(plane, step=step))) for plane in light) for step in STEPS]
    assert sizes == sorted(sizes, reverse=True)
    other = len(planes.packed(fixed)) + budget.REST
    for index in (0, 3, 6):
        stored = pack([*light, fixed], other + sizes[index])
        assert stored.fits and sum(map(len, stored.texts)) + budget.REST <= other + sizes[index]
        assert stored.step in STEPS[index : index + 2], "coarser than it had to be"
        assert [plane.name for plane in stored.planes] == ["0", "1", "2", "normal"]
        assert stored.planes[3].step == 1 / 127
    stored = pack([*light, fixed], other)
    assert not stored.fits and stored.step == STEPS[-1]
    assert stored.worst == errors(stored.planes[:3])[0] > 0.1


def test_budgets():
    assert bytes_for(720, 1280, None) == bytes_for(9, 16, None) == 10e6
    assert bytes_for(1440, 2560, None) == 40e6
    for wrong in (0, -1, 0.5, float("nan")):
        with pytest.raises(ParameterError, match="a page needs at least 1 MB"):
            bytes_for(9, 16, wrong)


class Checker(HTMLParser):
    """Every element closed in its turn; texts by the element they are in."""

    VOID = ("meta", "link", "input", "br")

    def __init__(self):
        super().__init__(convert_charrefs=True)
        self.open, self.seen, self.texts, self.ids = [], [], {}, []

    def handle_starttag(self, tag, attributes):
        self.seen.append(tag)
        names = dict(attributes)
        if "id" in names:
            self.ids.append(names["id"])
            self.texts[names["id"]] = ""
        for name in ("src", "href"):
            assert names.get(name, "data:,").startswith("data:"), "the page asks for something outside"
        if tag not in self.VOID:
            self.open.append((tag, names.get("id", tag)))

    def handle_startendtag(self, tag, attributes):
        self.seen.append(tag)

    def handle_endtag(self, tag):
        assert self.open and self.open[-1][0] == tag, f"</{tag}> closes {self.open[-1:]}"
        self.open.pop()

    def handle_data(self, data):
        for _, name in self.open[-1:]:
            self.texts[name] = self.texts.get(name, "") + data


def checked(html):
    parser = Checker()
    parser.feed(html)
    parser.close()
    assert not parser.open, parser.open
    assert len(parser.ids) == len(set(parser.ids))
    return parser


def scene(size=(24, 32)):
    planes = inputs.features(*size)
    return Frame(**planes), Frame(inputs.features(*size, noise=0.0)["color"])


def details(frame):
    return denoise(frame, method="nlm", search_radius=1, patch_radius=1, details=True)


def test_page_is_whole_and_names_are_only_text():
    frame, truth = scene()
    found = details(frame)
    maps = Denoised(found.image, np.ones(frame.shape, np.uint8), np.full(frame.shape, 1e-3, np.float32), found.report)
    results = {NASTY: Entry(found.image, 0.01, maps), "plain": frame.color}
    page = make_page(frame, results, reference=truth, title=NASTY, about={NASTY: NASTY})
    seen = checked(page.html)
    facts = json.loads(seen.texts["facts"])
    assert seen.texts["title"] == seen.texts["h1"] == NASTY
    names = [plane["name"] for plane in facts["planes"]]
    assert names == [
        "input", NASTY, "plain", "reference", "albedo", "normal", "depth", f"estimated error of {NASTY}",
        f"model map of {NASTY}",
    ]  # fmt: skip
    assert facts["judged"] == ["input", NASTY, "plain"] and facts["reference"] == "reference"
    assert sum(name.startswith("plane-") for name in seen.ids) == len(names)
    assert seen.seen.count("script") == len(names) + 2, "a name has opened a script"
    assert set(page.scores) == {"input", NASTY, "plain"} and not page.unscored
    assert page.scores["input"].relmse > page.scores[NASTY].relmse
    assert page.fits and page.worst < 0.005


def test_numbers_in_the_page_are_those_of_the_frame():
    frame, _ = scene()
    page = make_page(frame, {"same": frame.color})
    facts, seen = json.loads(checked(page.html).texts["facts"]), checked(page.html)
    light = facts["planes"][0]
    assert light["scale"] == frame_exposure(frame)
    parts = [part.replace("/", "<") for part in seen.texts["plane-0"].split(" ")]
    green, red, blue = (codec.decode(base64.b85decode(part), *frame.shape) for part in parts)
    back = restore(np.stack([red + green, green, blue + green], 2), light["scale"], light["step"], light["dark"])
    np.testing.assert_allclose(back, frame.color, rtol=0.005, atol=0.005 / light["scale"] / 128)


def test_page_without_a_reference_has_no_scores():
    frame, _ = scene()
    page = make_page(Frame(frame.color), {"nlm": Entry(frame.color, 0.0123)})
    seen = checked(page.html)
    assert page.scores == {} and json.loads(seen.texts["facts"])["judged"] == []
    assert "<h2>Times</h2>" in page.html and "12.3" in page.html and "<svg" not in page.html
    assert "<h2>Times</h2>" not in make_page(Frame(frame.color), {"nlm": frame.color}).html


def test_not_finite_is_said_and_not_hidden():
    frame, truth = scene()
    color = frame.color.copy()
    color[3, 4] = np.nan
    page = make_page(Frame(color), {"clean": truth.color}, reference=truth)
    checked(page.html)
    assert list(page.unscored) == ["input"] and "input has 1 of 768 pixels that are not finite" in page.html
    assert len(re.search(r'id="plane-0">(.*)</script>', page.html)[1].split(" ")) == 4
    broken = make_page(frame, {"clean": color}, reference=Frame(color))
    assert set(broken.unscored) == {"input", "clean"} and not broken.scores
    checked(broken.html)
    checked(make_page(Frame(np.full((5, 6, 3), np.inf, np.float32)), {"clean": np.zeros((5, 6, 3))}).html)


def test_mistakes():
    frame, _ = scene()
    with pytest.raises(FrameError, match=r"clean is \(9, 9, 3\) but input is \(24, 32, 3\): pass images of one size"):
        make_page(frame, {"clean": np.zeros((9, 9, 3))})
    with pytest.raises(FrameError, match=r"reference is \(9, 9, 3\) but"):
        make_page(frame, {"clean": frame.color}, reference=np.zeros((9, 9, 3)))
    for name in ("input", "reference", "depth"):
        with pytest.raises(ParameterError, match="choose another name"):
            make_page(frame, {name: frame.color})


def test_a_page_is_written_whole_or_not_at_all(tmp_path):
    frame, _ = scene()
    path = tmp_path / "page.html"
    page = write_page(path, frame, {"same": frame.color})
    assert path.read_text("utf-8") == page.html and list(tmp_path.iterdir()) == [path]
    with pytest.raises(McdenoiseError, match="folder does not exist"):
        write_page(tmp_path / "no" / "page.html", frame, {"same": frame.color})


def test_chart_labels_keep_apart():
    rng = np.random.default_rng(5)
    for _ in range(20):
        places = {
            f"method {i}": (float(x), float(y)) for i, (x, y) in enumerate(rng.uniform((80, 40), (600, 260), (6, 2)))
        }
        boxes = [chart._box(*label, chart.LETTER * len(name)) for name, label in chart._labels(places).items()]
        assert not any(chart._meet(a, b) for i, a in enumerate(boxes) for b in boxes[:i])
        assert all(chart._inside(box) for box in boxes)


def test_chart_leaves_out_what_has_no_place():
    assert (
        chart.chart({}, {"a": 0.1}) == chart.chart({"a": 1.0}, {"a": 0.0}) == chart.chart({"a": 0.0}, {"a": 1.0}) == ""
    )
    text = chart.chart({"<a>": 0.5, "b": 2.0, "c": 1.0}, {"<a>": 0.1, "b": -1e-5})
    assert text.count('class="point"') == 1 and "&lt;a&gt;" in text and ">input<" not in text
    assert ">input<" in chart.chart({"a": 0.5}, {"a": 0.1}, 0.3)
    checked(text)


def test_scores_that_are_given_are_used():
    frame, truth = scene()
    given = Scores(12.5, 0.1, 0.2, 0.3)
    page = make_page(frame, {"a": Entry(frame.color, scores=given)}, reference=truth, scores=given)
    assert page.scores == {"input": given, "a": given} and page.html.count("<b>12.50</b>") == 2
