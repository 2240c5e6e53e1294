"""The benchmark's own logic: figures in, tables, labels and files out. What it measures is not for a test to say."""

import importlib
import json
import math
import sys
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from mcdenoise_cl import Denoiser, methods
from mcdenoise_cl.choose import pick_device
from mcdenoise_cl.device import DEVICE_VARIABLE
from mcdenoise_cl.errors import DeviceError
from mcdenoise_cl.metrics import Scores

BENCH = Path(__file__).resolve().parents[1] / "bench"


def bench(name):
    """A module of bench/, which is a folder of scripts and no package."""
    if str(BENCH) not in sys.path:
        sys.path.insert(0, str(BENCH))
    return importlib.import_module(name)


def timing(name, seconds, stages=None):
    stages = stages or {}
    return {
        "name": name,
        "ours": bool(stages),
        "seconds": seconds,
        "device_ms": [sum(stages.values())] * len(seconds) if stages else [],
        "stages": stages,
        "host_bytes": 3 << 20,
        "device_bytes": 5 << 20 if stages else None,
    }


def speed_figures():
    def size(width, height, factor):
        names = {"nlm": 0.01, "guided": 0.02, "auto": 0.1, "OIDN high": 0.12, "scikit-image NLM": 0.05}
        timings = [
            timing(name, [factor * s, factor * s * 1.1, factor * s * 1.3], {"door": s} if s < 0.04 else None)
            for name, s in names.items()
        ]
        return {"width": width, "height": height, "timings": timings}

    facts = {"kind": "CPU", "cores": 2, "cpu": "a CPU", "runtime": "a runtime", "device": "it", "driver": "1"}
    return {"machine": facts, "sizes": [size(1280, 720, 1), size(2560, 1440, 5)]}


def test_every_method_is_an_entry_and_every_entry_can_be_made():
    entries = bench("entries")
    assert {entries.method_of(name) for name in entries.ENTRIES} == {method.name for method in methods()}
    for one in entries.chosen_entries(list(entries.ENTRIES)):
        Denoiser(8, 8, **one.arguments)


def test_speed_tables():
    tables = bench("speed_tables")
    assert tables.quartiles([3.0]) == (3.0, 3.0, 3.0)
    assert tables.quartiles([1.0, 2.0, 3.0]) == (1.5, 2.0, 2.5)
    sizes = speed_figures()["sizes"]
    ratio = next(one for one in tables.ratios(sizes) if one["faster"] == "nlm")
    assert ratio["slower"] == "scikit-image NLM"
    assert (ratio["width"], ratio["height"]) == (1280, 720)
    assert ratio["ratio"] == pytest.approx(5)
    assert {round(one["ratio"], 6) for one in tables.scaling(sizes)} == {1.25}
    assert tables.scaling(sizes[:1]) == []
    for text in (tables.size_table(sizes[0]), tables.ratio_table(tables.ratios(sizes))):
        assert len({line.count("|") for line in text.splitlines()}) == 1
    assert "| nlm | 11.0 | 10.5–12.0 | 10.0 | 0.01 | 3 | 5 |" in tables.size_table(sizes[0])


def test_worker_answers(tmp_path):
    crew, speed = bench("crew"), bench("speed")
    rng = np.random.default_rng(0)
    speed.save_planes(tmp_path, bench("frames").Frame(rng.random((12, 16, 3), np.float32)), 1.0)
    place = crew.Place(tmp_path, 12 * 16, {DEVICE_VARIABLE: str(pick_device().index)})
    worker = crew.Worker("nlm", place)
    try:
        assert set(worker.start()) == {"made", "first"}
        answer = worker.run()
        assert answer["seconds"] > 0
        assert answer["stages"]["nlm"] > 0
        assert answer["device_bytes"] > 0
    finally:
        worker.stop()
    assert worker.process is None


def test_worker_that_fails_says_why(tmp_path):
    crew = bench("crew")
    worker = crew.Worker("nlm", crew.Place(tmp_path, 1, {}))
    with pytest.raises(crew.WorkerError, match="ended with code 1: "):
        worker.start()
    worker.stop()
    worker = crew.Worker("nlm", crew.Place(tmp_path, 1, {}))
    with pytest.raises(crew.WorkerError, match=r"longer than 0\.01 s"):
        worker.start(longest=0.01)
    worker.stop()


def test_crew_stops_the_one_that_ran_last_when_memory_is_short(monkeypatch):
    crew = bench("crew")
    started = []

    class Fake(crew.Worker):
        def start(self, longest=None):
            self.process = "alive"
            started.append(self.name)

        def run(self, longest=None):
            return {}

        def stop(self):
            self.process = None

    monkeypatch.setattr(crew, "Worker", Fake)
    # Room for two at once.
    with crew.Crew(["a", "b", "c"], crew.Place(Path(), 1, {})) as three:
        monkeypatch.setattr(crew, "available_memory", lambda: 1 << 40 if len(three._order) < 2 else 0)
        for name in ("a", "b", "c", "a", "b", "c"):
            three.turn(name)
    assert started == ["a", "b", "c", "b"]


def test_labels_do_not_overlap():
    labels = bench("labels")
    rng = np.random.default_rng(5)
    points = [(float(x), float(y)) for x, y in rng.uniform((100, 60), (500, 200), (16, 2))]
    boxes = labels.place(points, [(80.0, 14.0)] * 16, labels.Box(0, 0, 700, 300), marker=4)
    assert all(a.common(b) == 0 for a, b in combinations(boxes, 2))
    markers = [labels.Box(x - 4, y - 4, x + 4, y + 4) for x, y in points]
    assert all(box.common(marker) == 0 for box in boxes for marker in markers)
    assert all(box.left >= 0 and box.right <= 700 and box.bottom >= 0 and box.top <= 300 for box in boxes)


def test_labels_at_the_ends_of_lines_keep_their_order_and_distance():
    spread = bench("labels").spread
    assert spread([0, 1, 10], 4, 0, 20) == [0, 4, 10]
    heights = spread([50, 3, 50, 51, 52], 10, 0, 100)
    assert heights[1] == 3
    assert sorted(np.diff(sorted(heights)))[:3] == pytest.approx([10, 10, 10])
    assert np.mean([heights[i] for i in (0, 2, 3, 4)]) == pytest.approx(50.75)
    assert max(spread([99] * 4, 10, 0, 100)) == 100


def test_charts(tmp_path):
    pytest.importorskip("matplotlib")
    chart = bench("chart")
    names = ("input", "nlm", "guided", "auto", "OIDN high", "OIDN balanced", "scikit-image NLM")
    means = {name: {"4": 1 / (i + 1), "32": 0.1 / (i + 1)} for i, name in enumerate(names)}
    means["OIDN balanced"] = means["OIDN high"]
    speed = speed_figures()
    speed["sizes"][0]["timings"].append(timing("OIDN balanced", [0.12]))
    quality = {"means": means, "frames": [{"scene": "room"}]}
    points = chart.pareto_points(quality, speed["sizes"][0])
    assert "OIDN high = balanced" in points[4]
    assert points[32]["nlm"] == pytest.approx((0.011 * 1e3 / 0.9216, 0.05))
    chart.save(chart.pareto(quality, speed, (1280, 720)), tmp_path, "pareto")
    chart.save(chart.sizes(speed), tmp_path, "sizes")
    lines = {"input": {"4": 1.0, "16": 0.25}, "nlm": {"4": 0.5, "16": 0.5}, "auto": {"4": 0.2, "16": 0.1}}
    figures = {"scene": "room", "width": 9, "height": 5, "reference_spp": 2, "relmse": lines}
    chart.save(chart.samples(figures), tmp_path, "samples")
    assert {path.name for path in tmp_path.iterdir()} == {
        f"{name}.{ending}" for name in ("pareto", "sizes", "samples") for ending in ("png", "svg")
    }


def test_front_and_crossing():
    pytest.importorskip("matplotlib")
    chart = bench("chart")
    points = {"a": (1, 5), "beaten": (2, 6), "b": (3, 2), "slow": (9, 2)}
    assert chart.front(points) == [(1, 5), (3, 2)]
    assert chart.steps([(1, 5), (3, 2)]) == [(1, 5), (3, 5), (3, 2)]
    noisy = [(4, 1.0), (16, 0.25)]
    assert chart.crossing([(4, 0.5), (16, 0.5)], noisy) == pytest.approx((8, 0.5))
    assert chart.crossing([(4, 0.5), (16, 0.2)], noisy) is None


def test_gather(tmp_path, monkeypatch):
    gather = bench("gather")
    (tmp_path / "tests.xml").write_text(
        '<testsuites><testsuite tests="4" failures="1" errors="0" skipped="1" time="2.5">'
        '<testcase classname="a" name="b"><failure/></testcase><testcase classname="a" name="c"/>'
        "</testsuite></testsuites>"
    )
    (tmp_path / "speed.json").write_text(json.dumps(speed_figures()))
    (tmp_path / "quality.json").write_text("{}")
    info = pick_device()
    found = gather.collect(info, tmp_path, quick=True)
    assert found["tests"]["passed"] == 2
    assert found["tests"]["failed"] == ["a.b"]
    assert found["stages"]["nlm"] == {"1280x720": {"door": 0.01}, "2560x1440": {"door": 0.01}}
    path = gather.write(found, tmp_path / "results")
    assert path.name.endswith("-quick.json")
    assert [path] == list(path.parent.iterdir())
    assert json.loads(path.read_text())["device"] == info.name
    assert pick_device(gather.choice(info)) == info
    monkeypatch.setattr(gather, "list_devices", lambda: [info] if info.kind != "GPU" else [])
    with pytest.raises(DeviceError, match="there is no OpenCL GPU here"):
        gather.find(None)


def test_absolute_means_are_geometric_and_miss_what_is_missing():
    pytest.importorskip("skimage")
    quality = bench("quality")
    rows = [
        quality.Row(scene, 4, name, Scores(psnr=0, mse=0, relmse=error, relmse_trimmed=0))
        for scene, name, error in (("a", "input", 1.0), ("b", "input", 4.0), ("a", "nlm", 1.0))
    ]
    means = quality.absolute(rows)
    assert math.isclose(means["input"][4], 2)
    assert means["nlm"][4] is None


def test_cases_of_the_stability_table_have_names_of_their_own():
    cases = bench("stability").all_cases([])
    assert len({case.name for case in cases}) == len(cases) > 35
    assert all(case.tried and case.outcome for case in cases)
    chosen = bench("stability").all_cases(["outliers", "nan-row"])
    assert {case.topic for case in chosen} == {"outliers", "non-finite input"}
    with pytest.raises(SystemExit, match="'outlier' is neither a topic nor a case"):
        bench("stability").all_cases(["outlier"])


def test_cells_of_the_stability_table():
    cell = bench("stability").cell
    assert cell(0.02, 0.1) == "0.2" and cell(0.02, 0.1, absolute=True) == "(0.02)"
    assert cell(0.02, 0.0) == "(0.02)" and cell("non-finite", None) == "non-finite"
    assert cell("error: " + 50 * "x", 0.1).endswith("…")


def test_the_stability_table_says_how_much_contrast_is_kept(capsys):
    stability = bench("stability")
    results, contrast = {"auto": 0.1, "OIDN": "error: none"}, {"input": 0.998, "auto": 0.814}
    outcomes = [
        stability.Outcome("topic", "shadow", "it", "must", 0.2, results, contrast),
        stability.Outcome("topic", "sun", "it", "must", 0.2, results),
    ]
    stability.print_table("topic", outcomes, absolute=True)
    printed = capsys.readouterr().out
    assert "| shadow | 1.00 | 0.81 |  |" in printed and printed.count("| sun |") == 1
    stability.print_table("topic", outcomes[1:], absolute=True)
    assert "ontrast" not in capsys.readouterr().out


def test_errors_of_the_stability_table():
    """Bad pixels are left out of the input's error; in a result they are what is said."""
    stability = bench("stability")
    truth = np.ones((4, 5, 3))
    image = 1.1 * truth
    image[1, 2] = np.nan
    assert stability.error_of(image, truth, None, 1.0) == pytest.approx(0.01 / 1.01)
    assert stability.judged(image, truth, None, 1.0) == "non-finite"
    mask = np.zeros((4, 5), bool)
    mask[1, 2] = True
    assert np.isnan(stability.error_of(image, truth, mask, 1.0))
    image[1, 2] = 2.0
    assert stability.judged(image, truth, mask, 1.0) == pytest.approx(1 / 1.01)
