"""The page in headless Chromium: it shows what it was given, and every control does what it says."""

import inputs
import numpy as np
import pytest
from browser import browser  # noqa: F401

from mcdenoise_cl import Denoised, Frame, denoise
from mcdenoise_cl.metrics import relmse_map
from mcdenoise_cl.page import Entry, write_page
from mcdenoise_cl.page.planes import quantise
from mcdenoise_cl.pictures import to_png

H, W = 48, 80
NAME = 'a "quoted" </script> <b>'
#: The colour of a place on the canvas, given as parts of its width and height.
COLOR = """([x, y]) => { const c = document.getElementById("canvas");
    const at = [Math.floor(x * c.width), Math.floor(y * c.height)];
    return [...c.getContext("2d").getImageData(...at, 1, 1).data].slice(0, 3); }"""
#: Where a pixel of the image is on the canvas, in the same parts.
PLACE = """([x, y]) => [0.5 + (x + 0.5 - view.x) * view.zoom / view.canvas.width,
    0.5 + (y + 0.5 - view.y) * view.zoom / view.canvas.height]"""
#: And the other way round, to a fraction of a pixel.
UNDER = """([x, y]) => [view.x + (x - 0.5) * view.canvas.width / view.zoom,
    view.y + (y - 0.5) * view.canvas.height / view.zoom]"""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A page with everything on it: (path, frame, images by name, page)."""
    planes = inputs.features(H, W)
    planes["color"][5, 7] = np.nan
    planes["color"][6, 8, 1] = np.inf
    planes["depth"][0, :4] = np.inf
    frame, truth = Frame(**planes), Frame(inputs.features(H, W, noise=0.0)["color"])
    found = denoise(frame, method="nlm", search_radius=1, patch_radius=1, details=True)
    models = (np.add.outer(np.arange(H), np.arange(W)) // 8 % 4).astype(np.uint8)
    errors = np.geomspace(1e-5, 2, H * W).reshape(H, W).astype(np.float32)
    maps = Denoised(found.image, models, errors, found.report)
    path = tmp_path_factory.mktemp("page") / "report.html"
    results = {"half": truth.color / 2, NAME: Entry(found.image, 0.02, maps)}
    page = write_page(path, frame, results, reference=truth, title="A <test>")
    return (
        path,
        frame,
        {"input": frame.color, "half": truth.color / 2, NAME: found.image, "reference": truth.color},
        page,
    )


@pytest.fixture(params=["light", "dark"])
def scheme(request):
    return request.param


@pytest.fixture
def opened(browser, made):  # noqa: F811
    """A function that opens the page in a window of its own; every complaint of the browser fails the test."""
    complaints, contexts = [], []

    def open_page(width=1280, height=900, anchor="", path=None, **options):
        context = browser.new_context(viewport={"width": width, "height": height}, offline=True, **options)
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.goto(f"file://{path or made[0]}{anchor}")
        page.wait_for_selector("html[data-ready=yes]", state="attached")
        settle(page)
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert complaints == []


def settle(page):
    page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")


def until(page, expression):
    """Wait for it; Playwright's own way to do so needs `eval`, which the page forbids."""
    while not page.evaluate(expression):
        page.wait_for_timeout(20)


def color_at(page, x, y):
    settle(page)
    return page.evaluate(COLOR, page.evaluate(PLACE, [x, y]))


def choose(page, left, right):
    page.select_option("#left", left)
    page.select_option("#right", right)
    settle(page)


@pytest.mark.parametrize("width", [1280, 400])
def test_it_opens_and_nothing_sticks_out(opened, scheme, width):
    page = opened(width, color_scheme=scheme)
    assert page.title() == page.inner_text("h1") == "A <test>"
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.inner_text("#status") == ""
    box = page.locator("#canvas").bounding_box()
    assert box["width"] > 0.6 * min(width, 900) and 200 <= box["height"] < 900


def test_every_number_arrives(opened, made):
    """decode.js against what planes.py made of the values, and the values against their float64."""
    _, frame, images, _ = made
    page = opened()
    told = page.evaluate("facts.planes")
    values = images | {"albedo": frame.albedo, "normal": frame.normal, "depth": frame.depth}
    for index, facts in enumerate(told):
        if facts["name"] not in values:
            continue
        got = page.evaluate("i => planes[i].data.channels.map((channel) => [...channel])", index)
        wanted = quantise(values[facts["name"]], facts["scale"], facts["step"], facts["dark"])
        wanted = wanted.reshape(H * W, -1).T
        np.testing.assert_array_equal(np.array(got), wanted, err_msg=facts["name"])
    back = page.evaluate("[...planes[1].data.channels[0]].map((n) => valueOf(planes[1], n) / planes[1].scale)")
    np.testing.assert_allclose(np.reshape(back, (H, W)), images["half"][..., 0], rtol=0.005, atol=1e-4)


def test_exposure_acts_on_light(opened, made):
    """Against `to_png` of the values: brighter by stops, and what was beyond white comes back when it is darker."""
    _, _, images, _ = made
    page = opened()
    choose(page, NAME, NAME)
    page.click("#one")
    scale = page.evaluate("planes[0].scale")
    spots = [(20, 10), (40, 30), (60, 40), (50, 20)]
    for stops in (0, 2, -3):
        page.locator("#exposure").fill(str(stops))
        expected = to_png(images[NAME], scale * 2.0**stops).astype(int)
        got = np.array([color_at(page, *spot) for spot in spots])
        assert np.abs(got - [expected[y, x] for x, y in spots]).max() <= 1
        assert page.inner_text("#stops") == f"{'+' * (stops > 0)}{stops} stops".replace("-", "−")
    page.click("#unexposed")
    settle(page)
    assert page.input_value("#exposure") == "0"


def test_the_divider_moves_by_mouse_and_keys(opened):
    page = opened()
    choose(page, "half", "reference")
    middle = [0.4, 0.5]
    before = page.evaluate(COLOR, middle)
    handle, view = page.locator("#divider"), page.locator("#canvas").bounding_box()
    box = handle.bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down()
    page.mouse.move(view["x"] + 0.25 * view["width"], view["y"] + 10, steps=4)
    page.mouse.up()
    settle(page)
    assert handle.get_attribute("aria-valuenow") == "25"
    assert handle.get_attribute("aria-valuetext") == "25 % half, 75 % reference"
    after = page.evaluate(COLOR, middle)
    assert sum(after) > sum(before), "the brighter side has not taken over"
    handle.focus()
    for key, wanted in [
        ("ArrowRight", "26"),
        ("Shift+ArrowLeft", "16"),
        ("End", "100"),
        ("Home", "0"),
        ("PageUp", "10"),
    ]:
        page.keyboard.press(key)
        settle(page)
        assert handle.get_attribute("aria-valuenow") == wanted, key


def test_zoom_and_pan_keep_both_sides_in_step(opened):
    page = opened()
    choose(page, "half", "reference")
    view = page.locator("#canvas").bounding_box()
    at = [0.7, 0.6]
    before, zoom = page.evaluate(UNDER, at), page.evaluate("view.zoom")
    page.mouse.move(view["x"] + at[0] * view["width"], view["y"] + at[1] * view["height"])
    page.mouse.wheel(0, -500)
    until(page, f"view.zoom > 3 * {zoom}")
    assert page.evaluate("view.zoom") == pytest.approx(4 * zoom, rel=0.01)
    np.testing.assert_allclose(page.evaluate(UNDER, at), before, atol=0.2)
    # Beyond one to one a pixel is a square of one colour, and one place shows one pixel on both sides.
    probed = {}
    for split in ("Home", "End"):
        page.focus("#divider")
        page.keyboard.press(split)
        x, y = (int(v) for v in page.evaluate(UNDER, [0.5, 0.5]))
        probed[split] = [color_at(page, x + dx, y + dy) for dx in (-0.4, 0, 0.4) for dy in (-0.4, 0, 0.4)]
        assert len({tuple(color) for color in probed[split]}) == 1
        name = {"Home": "reference", "End": "half"}[split]
        shown = page.evaluate(
            "([name, i]) => named(name).data.channels.map((c) => encoded(valueOf(named(name), c[i])))",
            [name, y * W + x],
        )
        assert probed[split][0] == shown
    page.focus("#canvas")
    x = page.evaluate("view.x")
    page.keyboard.press("ArrowLeft")
    assert page.evaluate("view.x") < x
    page.mouse.down()
    page.mouse.move(view["x"] + 0.5 * view["width"], view["y"] + 0.5 * view["height"], steps=3)
    page.mouse.up()
    assert page.evaluate("view.fitted") is False
    for key, wanted in [("1", "100 %"), ("+", "141 %"), ("-", "100 %")]:
        page.keyboard.press(key)
        settle(page)
        assert page.inner_text("#zoom") == wanted, key
    page.keyboard.press("0")
    assert page.evaluate("view.fitted && view.x === width / 2")


def test_two_fingers_zoom_and_pan(opened):
    page = opened(400, has_touch=True)
    session = page.context.new_cdp_session(page)
    box = page.locator("#canvas").bounding_box()
    x, y = box["x"] + box["width"] / 2 - 60, box["y"] + 60  # clear of the divider
    zoom = page.evaluate("view.zoom")

    def touch(kind, *places):
        points = [{"x": px, "y": py, "id": i} for i, (px, py) in enumerate(places)]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    touch("touchStart", (x - 60, y), (x - 20, y))
    for gap in (25, 30, 35, 40):
        touch("touchMove", (x - 40 - gap, y), (x - 40 + gap, y))
    touch("touchEnd")
    settle(page)
    assert page.evaluate("view.zoom") == pytest.approx(2 * zoom, rel=0.1)


@pytest.mark.parametrize(
    "left", ["error of half", "estimated error of " + NAME, "model map of " + NAME, "depth", "normal"]
)
def test_maps_have_legends(opened, left):
    page = opened(anchor="")
    choose(page, left, left)
    assert page.locator("#legends h3").all_inner_texts() == [left]
    text = page.inner_text("#legends")
    for wanted in {"error": ["0.0001", "1"], "model": ["input", "narrow", "wide"], "depth": ["near", "far"]}.get(
        left.split()[0].replace("estimated", "error"), ["x, y, z"]
    ):
        assert wanted in text


def test_a_scale_grows_lighter_evenly_without_colour(opened):
    """The luminance of the error scale, which is what is left without colour vision, rises at every step."""
    page = opened()
    colors = np.array(page.evaluate("RAMP")) / 255
    linear = np.where(colors <= 0.04045, colors / 12.92, ((colors + 0.055) / 1.055) ** 2.4)
    lightness = 116 * np.cbrt(linear @ [0.2126, 0.7152, 0.0722]) - 16
    steps = np.diff(lightness[::15])
    assert steps.min() > 0.5 * steps.mean() and lightness[0] < 15 and lightness[-1] > 90


def test_labels_differ_without_colour(opened):
    """The patterns, apart from what they are drawn on."""
    page = opened()
    tiles = page.evaluate(
        "[0, 1, 2, 3].map((k) => Array.from({length: 144}, (_, i) => PATTERNS[k](i % 12, Math.floor(i / 12))))"
    )
    assert len({tuple(tile) for tile in tiles}) == 4


def test_errors_are_those_of_metrics(opened, made):
    _, _, images, _ = made
    page = opened()
    scale = page.evaluate("planes[0].scale")
    errors = np.reshape(page.evaluate('[...named("error of half").errors]'), (H, W))
    wanted = relmse_map(images["half"], images["reference"], scale)
    np.testing.assert_allclose(errors, wanted, rtol=0.05)
    lost = page.evaluate('[...named("error of input").errors].flatMap((v, i) => (Number.isNaN(v) ? [i] : []))')
    assert lost == [5 * W + 7, 6 * W + 8]


def test_the_probe_tells_values_and_what_is_not_finite(opened, made):
    _, frame, images, _ = made
    page = opened()
    page.focus("#canvas")
    page.evaluate("view.pointAt(7, 6)")
    assert page.inner_text("#probe h3") == "Pixel 7, 6"
    half = page.evaluate(
        "[...document.querySelectorAll('#probe tr')].find((row) => row.cells[0].textContent === 'half').innerText"
    )
    np.testing.assert_allclose([float(text) for text in half.split()[1:4]], images["half"][6, 7], rtol=0.01)
    page.keyboard.press("Shift+ArrowUp")
    assert page.inner_text("#probe h3") == "Pixel 7, 5"
    rows = page.locator("#probe tr").all_inner_texts()
    assert any(row.startswith("input") and "NaN" in row for row in rows)
    page.evaluate("view.pointAt(8, 6)")
    assert any(row.startswith("input") and "+Inf" in row for row in page.locator("#probe tr").all_inner_texts())
    page.evaluate("view.pointAt(1, 0)")
    assert any(row.startswith("depth") and "+Inf" in row for row in page.locator("#probe tr").all_inner_texts())
    choose(page, "input", "input")
    page.keyboard.press("1")
    assert {tuple(color_at(page, *spot)) for spot in ((7, 5), (8, 6))} <= {(255, 0, 255), (0, 0, 0)}
    assert frame.color[6, 8, 1] == np.inf


def test_a_view_is_shared_by_its_address(opened):
    page = opened()
    choose(page, "half", "albedo")
    page.locator("#exposure").fill("1.5")
    page.focus("#canvas")
    for _ in range(3):
        page.keyboard.press("+")
    page.focus("#divider")
    page.keyboard.press("PageUp")
    until(page, "location.hash.includes('split=0.60')")
    state = "() => [state.left, state.right, state.stops, view.zoom.toFixed(2), view.x.toFixed(1), view.split]"
    wanted, anchor = page.evaluate(state), page.evaluate("location.hash")
    assert opened(anchor=anchor).evaluate(state) == wanted
    for wrong in ("#left=none&zoom=x&split=nan", "#%", "#zoom=1e9&x=-1e9&stops=99"):
        assert opened(anchor=wrong).inner_text("#status") == ""


def test_everything_is_reached_by_keys(opened):
    page = opened()
    reached = set()
    for _ in range(40):
        page.keyboard.press("Tab")
        element = page.evaluate(
            "[document.activeElement.id || document.activeElement.tagName, "
            "getComputedStyle(document.activeElement).outlineStyle]"
        )
        reached.add(element[0])
    controls = {
        "left",
        "swap",
        "right",
        "exposure",
        "unexposed",
        "out",
        "in",
        "fit",
        "one",
        "canvas",
        "divider",
        "SUMMARY",
    }
    assert controls <= reached
    page.focus("#canvas")
    left, right = page.input_value("#left"), page.input_value("#right")
    page.keyboard.press("x")
    settle(page)
    assert (page.input_value("#left"), page.input_value("#right")) == (right, left)
    page.keyboard.press("]")
    settle(page)
    assert page.input_value("#right") != left
    page.keyboard.press(".")
    settle(page)
    assert page.inner_text("#stops") == "+0.25 stops"


def test_a_damaged_page_says_so(opened, browser, made, tmp_path):  # noqa: F811
    text = made[0].read_text("utf-8")
    at = text.index('id="plane-0">') + 200
    (tmp_path / "damaged.html").write_text(text[:at] + "00000" + text[at + 5 :], "utf-8")
    page = browser.new_page()
    page.goto(f"file://{tmp_path / 'damaged.html'}")
    until(page, "document.getElementById('status').textContent.includes('cannot be read')")
    page.close()
