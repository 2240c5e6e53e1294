"""The installed command, run as its users run it."""

import json
import os
import pty
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import inputs
import numpy as np
import pytest
from PIL import Image

from mcdenoise_cl import __version__, methods
from mcdenoise_cl.api import denoise
from mcdenoise_cl.choose import pick_device
from mcdenoise_cl.cli import main
from mcdenoise_cl.device import list_devices
from mcdenoise_cl.exr import read_exr, write_exr
from mcdenoise_cl.frame import PLANES, Frame
from mcdenoise_cl.methods import DEFAULT_PRESET, PRESETS

DEFAULT = PRESETS[DEFAULT_PRESET].method
COMMAND = str(Path(sys.executable).parent / "mcdenoise")
H, W = 24, 32
SMALL = ["--set", "search_radius=1", "--set", "patch_radius=1"]
FAST = ["--method", "ssim-nlm", *SMALL]


def run(*arguments, code=0, **environment):
    """Standard output of the command; for a code other than 0 its errors, in which no traceback may show."""
    env = {k: v for k, v in os.environ.items() if k != "MCDENOISE_DEVICE"} | environment
    done = subprocess.run([COMMAND, *map(str, arguments)], capture_output=True, text=True, env=env, timeout=120)
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr
    return done.stdout if code == 0 else done.stderr


def error(*arguments, code, **environment):
    """The one sentence on stderr."""
    text = run(*arguments, code=code, **environment)
    assert text.startswith("mcdenoise: ") and text.count("\n") == 1, text
    return text.removeprefix("mcdenoise: ").rstrip()


def quick_error(capsys, *arguments, code):
    """The one sentence, without a process of its own: for tables of mistakes."""
    assert main([str(argument) for argument in arguments]) == code
    out, text = capsys.readouterr()
    assert out == "" and text.startswith("mcdenoise: ") and text.count("\n") == 1, text
    return text


def notes(*arguments, code=0):
    """Standard error of a run that says nothing on standard output."""
    done = subprocess.run([COMMAND, *map(str, arguments)], capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout) == (code, ""), done.stderr
    return done.stderr


def write_frame(path, seed=0, size=(H, W)):
    write_exr(path, Frame(**inputs.features(*size, seed=seed)))
    return path


@pytest.fixture
def noisy(tmp_path):
    return write_frame(tmp_path / "noisy.exr")


@pytest.fixture
def folder(tmp_path):
    """Three frames, the second broken."""
    folder = tmp_path / "in"
    folder.mkdir()
    for seed, name in enumerate(("a.exr", "b.exr", "c.EXR")):
        write_frame(folder / name, seed)
    (folder / "b.exr").write_bytes((folder / "b.exr").read_bytes()[:2000])
    (folder / "readme.txt").touch()
    return folder


def test_help_and_version():
    assert run("--version") == f"mcdenoise {__version__}\n"
    whole = run("-h")
    assert whole == run() == run("--help")
    assert "0 done, 1 failed, 2 wrong usage" in whole
    listed = whole[whole.index("Commands:") :]
    for command in ("compare", "demo", "denoise", "devices", "methods", "render", "report"):
        assert re.search(rf"^  {command}  .*\.$", listed, re.MULTILINE), f"{command} has no line of its own"
        assert f"Usage: mcdenoise {command}" in run(command, "-h")


def test_start_imports_nothing_slow():
    code = (
        "import sys, mcdenoise_cl.cli;"
        "print(*{'mitsuba', 'skimage', 'flip_evaluator', 'PIL', 'scipy', 'matplotlib'} & set(sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "\n"


def test_denoise_a_file(noisy, tmp_path):
    said = notes("denoise", noisy, "-o", tmp_path / "clean.exr")
    frame, clean = read_exr(noisy), read_exr(tmp_path / "clean.exr")
    used = r"from color=RGB, albedo=albedo, normal=N.* in \d+ ms on"
    assert re.fullmatch(rf".*clean.exr: {DEFAULT} {used} {re.escape(pick_device().name)} .*\n", said)
    np.testing.assert_array_equal(clean.color, denoise(frame))
    assert set(clean.planes()) == set(frame.planes())


def test_denoise_options(noisy, tmp_path):
    out, small = tmp_path / "out", {"search_radius": 1, "patch_radius": 1}
    out.mkdir()
    chosen = ["--method", "nlm", "--set", "h_factor=0.5", "--set", "exposure=none", "--set", "average=linear"]
    chosen += ["--layer", "depth=none", "--samples", 4, "--device", 0]
    said = notes("denoise", noisy, "-o", out / "a.exr", *chosen, *SMALL)
    assert "a.exr: nlm from color=RGB in" in said and "note" not in said
    frame = read_exr(noisy)
    wanted = denoise(frame, method="nlm", h_factor=0.5, average="linear", device=0, **small)
    np.testing.assert_array_equal(read_exr(out / "a.exr").color, wanted)
    # Where the default falls back to the colour alone its user should know.
    alone = ["--layer", "normal=", "--layer", "albedo=none", "--layer", "depth=none"]
    said = notes("denoise", noisy, "-o", out / "b.exr", *alone, *SMALL)
    assert (
        f"b.exr: {PRESETS[DEFAULT_PRESET].method} from color=RGB in" in said
        and "note: nothing but the colour was found" in said
    )
    said = notes("denoise", noisy, "-o", out / "c.exr", "--layer", "albedo=N", "--set", "stabilised=off", *FAST)
    assert "c.exr: ssim-nlm from color=RGB, albedo=N, normal=N" in said
    swapped = Frame(frame.color, frame.normal, frame.normal)
    wanted = denoise(swapped, method="ssim-nlm", stabilised=False, **small)
    np.testing.assert_array_equal(read_exr(out / "c.exr").color, wanted)


def test_denoise_with_a_preset(noisy, tmp_path):
    said = notes("denoise", noisy, "-o", tmp_path / "clean.exr", "--preset", "fast")
    assert f"clean.exr: {PRESETS['fast'].method} from" in said
    both = "--method", "nlm", "--preset", "fast"
    assert "a preset is a method, so give one" in error("denoise", noisy, "-o", tmp_path / "c.exr", *both, code=2)


def test_denoise_says_what_it_replaced(tmp_path):
    planes = inputs.features(H, W)
    planes["color"][2, 3] = np.inf
    planes["normal"][4:6, 5] = np.nan
    write_exr(tmp_path / "bad.exr", Frame(**planes))
    said = notes("denoise", tmp_path / "bad.exr", "-o", tmp_path / "clean.exr", *FAST)
    assert "note: replaced 1 pixel of color, not being finite" in said
    assert "note: replaced 2 pixels of normal, not being finite" in said


def test_denoise_a_folder(folder, tmp_path):
    said = notes("denoise", folder, "-o", tmp_path / "new" / "out", *FAST, code=1).splitlines()
    out = tmp_path / "new" / "out"
    assert sorted(path.name for path in out.iterdir()) == ["a.exr", "c.EXR"]
    assert said[0] == f"denoising into {out}" and said[1].startswith("2 of 3 files denoised with ssim-nlm on ")
    assert said[1].endswith("; 1 failed") and len(said) == 3
    assert re.match(r"mcdenoise: .*in/b.exr is damaged or cut short, its pixels cannot be read", said[2])
    (folder / "b.exr").unlink()
    again = notes("denoise", folder, "-o", out, *FAST)
    assert "0 of 2 files denoised; 2 skipped, being up to date (--force does them again)\n" in again
    assert "2 of 2 files denoised with nlm on" in notes("denoise", folder, "-o", out, "--force", "--method", "nlm")


def test_denoise_several_files(folder, tmp_path):
    sources = (folder / "a.exr", tmp_path / "missing.exr", folder / "c.EXR")
    said = notes("denoise", *sources, "-o", tmp_path / "out", *FAST, code=1)
    assert "2 of 3 files denoised" in said and "missing.exr cannot be read (No such file or directory)" in said
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["a.exr", "c.EXR"]
    assert "1 of 1 file denoised" in notes("denoise", sources[0], "-o", f"{tmp_path / 'b'}/", *FAST)
    assert (tmp_path / "b" / "a.exr").is_file()


def test_progress_on_a_terminal(folder, tmp_path):
    terminal, end = pty.openpty()
    done = subprocess.Popen([COMMAND, "denoise", folder, "-o", tmp_path / "out", *FAST], stderr=end)
    os.close(end)
    shown = b""
    while True:
        try:
            shown += os.read(terminal, 4096)
        except OSError:  # what Linux answers once the other end is closed
            break
    os.close(terminal)
    assert done.wait() == 1
    assert re.search(rb"denoising into .*\[#+ *\] +[123]/3", shown) and re.search(rb"\d+\.\d/s", shown)


@pytest.mark.usefixtures("interruptible")
def test_interrupted(tmp_path):
    folder, out = tmp_path / "in", tmp_path / "out"
    folder.mkdir()
    write_frame(folder / "000.exr", size=(200, 300))
    for number in range(1, 100):
        (folder / f"{number:03d}.exr").hardlink_to(folder / "000.exr")
    process = subprocess.Popen([COMMAND, "denoise", folder, "-o", out], stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while not (out.is_dir() and any(out.glob("*.exr"))):
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert said.splitlines()[-1].startswith("mcdenoise: interrupted: files already finished are whole")
    files = sorted(out.iterdir())
    assert 0 < len(files) < 100 and {path.suffix for path in files} == {".exr"}
    assert all(read_exr(path).shape == (200, 300) for path in files)


def test_wrong_usage(noisy, tmp_path, capsys):
    out = tmp_path / "out.exr"
    for arguments, message in (
        (["--no-such"], "No such option '--no-such'; see mcdenoise --help"),
        (["denose"], "No such command 'denose'"),
        (["denoise", noisy], "Missing option '-o' / '--output'; see mcdenoise denoise --help"),
        (["denoise", noisy, "-o", out, "--method", "no"], "'no' is not one of 'nlm'"),
        (["denoise", noisy, "-o", out, "--set", "h"], "--set is 'h', but NAME=VALUE is needed; see mcdenoise denoise"),
        (["denoise", noisy, "-o", out, "--set", "no=1"], "--set has 'no', but method auto has the parameters search"),
        (
            ["denoise", noisy, "-o", out, "--set", "exposure=wide"],
            "exposure is 'wide' but a number from 1e-30 to 1e+30,",
        ),
        (["denoise", noisy, "-o", out, "--set", "search_radius=-1"], "is -1 but a whole number from 0 to"),
        (["denoise", noisy, "-o", out, "--layer", "no=N"], "--layer has 'no', but the planes are color, albedo"),
        (
            ["denoise", noisy, "-o", out, "--device", "no such"],
            "device is 'no such', which is none of the devices here",
        ),
        (["denoise", "-o", out], "INPUT or --halves A B is needed, one of them; see mcdenoise denoise --help"),
        (["denoise", noisy, "-o", out, "--halves", noisy, noisy], "INPUT or --halves A B is needed, one of them"),
        (["denoise", noisy, "-o", out, "--frames", "1-4"], "--frames is given but"),
        (["denoise", noisy, "-o", out, "--pairs"], "noisy.exr is one file: give a folder, a pattern or a sequence"),
        (["denoise", tmp_path, "-o", out, "--frames", "1-4"], "frames is given but no input is a sequence"),
        (["denoise", "a.##.exr", "-o", out, "--frames", "9-1"], "frames is '9-1' but 1 comes before 9"),
        (["denoise", "a.##.exr", "-o", out, "--frames", "1-9y2"], "but something like 1-240, 1-240x2 or"),
        (["compare", noisy, "--reference", noisy, "--exposure", "0"], "exposure is 0.0 but a number above 0 is needed"),
        (["render", "room", "--spp", "1"], "-o FILE is missing; see mcdenoise render --help"),
    ):
        assert message in quick_error(capsys, *arguments, code=2)
    only = ["--method", "nlm", "--set", "canny_low=1"]
    assert "method nlm has the parameters search_radius" in error("denoise", noisy, "-o", out, *only, code=2)
    error("--no-such", code=2)
    assert not out.exists()


def test_failures(noisy, tmp_path, capsys):
    (tmp_path / "text.exr").write_text("no pixels")
    (tmp_path / "taken.exr").write_text("mine")
    (tmp_path / "empty").mkdir()
    out = tmp_path / "out.exr"
    for arguments, message in (
        ([tmp_path / "text.exr", "-o", out], "text.exr is not an EXR file, whatever its name"),
        ([noisy, "-o", out, "--layer", "normal=no"], "normal=no is not in the file: its layers are RGB"),
        (
            [noisy, "-o", out, "--layer", "albedo=none", "--method", "ssim-nlm"],
            "noisy.exr: method 'ssim-nlm' needs alb",
        ),
        ([noisy, "-o", noisy, "--force"], "noisy.exr is the input itself, which is never written to"),
        ([noisy, "-o", tmp_path, "--force"], "noisy.exr would be written but is the input"),
        ([noisy, "-o", tmp_path / "taken.exr"], "taken.exr exists already: give another name, or pass --force"),
        ([noisy, "-o", tmp_path / "taken.exr" / "out.exr"], "cannot be written, as there is no folder"),
        ([noisy, "-o", f"{tmp_path / 'taken.exr' / 'out'}/"], "cannot be made (Not a directory)"),
        ([tmp_path / "empty", "-o", out], "empty holds no EXR file: give a folder with *.exr directly in it"),
    ):
        assert message in quick_error(capsys, "denoise", *arguments, code=1)
    assert (tmp_path / "taken.exr").read_text() == "mine"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["empty", "noisy.exr", "taken.exr", "text.exr"]


def test_debug_shows_the_traceback(tmp_path):
    for arguments in (["--debug", "denoise", "no.exr", "-o", "x.exr"], ["denoise", "no.exr", "-o", "x.exr", "--debug"]):
        done = subprocess.run([COMMAND, *arguments], capture_output=True, text=True, cwd=tmp_path)
        assert done.returncode == 1 and "Traceback" in done.stderr and "in run_job" in done.stderr
        assert done.stderr.splitlines()[-1].startswith("mcdenoise: no.exr cannot be read")


def test_surprises_are_one_sentence(tmp_path):
    (tmp_path / "sitecustomize.py").write_text(
        "import mcdenoise_cl.console as console\n"
        "def broken(*arguments): raise ZeroDivisionError('by\\nzero')\n"
        "console.print_methods = broken\n"
    )
    path = {"PYTHONPATH": str(tmp_path)}
    assert error("methods", code=1, **path) == (
        "unexpected ZeroDivisionError (by): run again with --debug to see where"
    )


def test_devices(monkeypatch):
    monkeypatch.delenv("MCDENOISE_DEVICE", raising=False)
    known, default = list_devices(), pick_device(None).index
    rows = json.loads(run("devices", "--json"))
    assert [row["name"] for row in rows] == [device.name for device in known]
    assert [row["index"] for row in rows if row["default"]] == [default]
    assert set(rows[0]) == {
        "index", "name", "runtime", "version", "driver", "kind", "compute_units", "memory", "default"
    }  # fmt: skip
    text = run("devices")
    for device in known:
        assert f"{'*' if device.index == default else ' '} {device.index}  {device.name}\n" in text
        assert f"{device.kind}, {device.compute_units} compute units, " in text and device.driver in text


def test_the_environment_chooses_the_device(noisy, tmp_path):
    last = list_devices()[-1]
    rows = json.loads(run("devices", "--json", MCDENOISE_DEVICE=str(last.index)))
    assert [row["index"] for row in rows if row["default"]] == [last.index]
    wrong = {"MCDENOISE_DEVICE": "no such"}
    for arguments in (("devices",), ("denoise", noisy, "-o", tmp_path / "out.exr")):
        message = error(*arguments, code=1, **wrong)
        assert message.startswith("environment variable MCDENOISE_DEVICE is 'no such', which is none of the devices")


def test_no_opencl_at_all(noisy, tmp_path):
    # PyOpenCL sets PYOPENCL_HOME, where its loader looks too, when it is imported; so that comes first here.
    (tmp_path / "sitecustomize.py").write_text(
        "import os, pyopencl\nos.environ['PYOPENCL_HOME'] = os.environ['OCL_ICD_VENDORS']\n"
    )
    (tmp_path / "empty").mkdir()
    nothing = {"PYTHONPATH": str(tmp_path), "OCL_ICD_VENDORS": str(tmp_path / "empty")}
    for arguments in (["devices"], ["devices", "--json"], ["denoise", noisy, "-o", tmp_path / "out.exr"]):
        message = error(*arguments, code=1, **nothing)
        assert message.startswith("no OpenCL runtime was found: install") and "mcdenoise-cl[cpu]" in message


def test_methods():
    rows = json.loads(run("methods", "--json"))
    text = run("methods")
    for row, method in zip(rows, methods(), strict=True):
        assert (row["name"], row["summary"], row["needs"]) == (method.name, method.summary, list(method.needs))
        assert row["uses"] == list(method.uses)
        assert f"{method.name}: {method.summary}\n  needs {', '.join(('color', *method.needs))}\n" in text
        for fact, info in zip(row["parameters"], method.parameters, strict=True):
            assert (fact["name"], fact["default"], fact["type"]) == (info.name, info.default, info.type.__name__)
            assert re.search(rf"^  {info.name}=\S+ .*{re.escape(info.meaning)}$", text, re.MULTILINE)
    assert re.search(r"^  search_radius=3 +0 to \d+ ", text, re.MULTILINE)
    assert re.search(r"^  stabilised=true +true, false ", text, re.MULTILINE)
    assert re.search(r"^  h=none +at least 0 ", text, re.MULTILINE)


def test_methods_into_a_closed_pipe():
    command = f"{COMMAND} methods | true; echo ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True)
    assert done.stderr == "" and done.stdout in ("0\n", "1\n")


def test_compare(noisy, tmp_path):
    truth = inputs.features(H, W, noise=0)
    write_exr(tmp_path / "truth.exr", Frame(**truth, metadata={"exposure_scale": 1.0}))
    write_exr(tmp_path / "near.exr", truth["color"] * 1.01)
    images = (noisy, tmp_path / "near.exr", tmp_path / "truth.exr")
    table = run("compare", *images, "--reference", tmp_path / "truth.exr").splitlines()
    assert table[0].split("|")[2].strip() == "PSNR, dB" and len(table) == 5
    assert [line.split("|")[1].strip() for line in table[2:]] == [str(image) for image in images]
    assert "**inf**" in table[4]
    rows = json.loads(run("compare", *images, "--reference", tmp_path / "truth.exr", "--json"))
    assert [row["image"] for row in rows] == [str(image) for image in images]
    assert set(rows[0]) == {"image", "psnr", "mse", "relmse", "relmse_trimmed", "ssim", "flip"}
    assert rows[0]["psnr"] < rows[1]["psnr"] and (rows[2]["psnr"], rows[2]["mse"]) == (None, 0)
    darker = json.loads(run("compare", noisy, "--reference", tmp_path / "truth.exr", "--json", "--exposure", "0.1"))
    assert darker[0]["mse"] < rows[0]["mse"]


def test_compare_errors(noisy, tmp_path):
    write_frame(tmp_path / "small.exr", size=(H - 1, W))
    message = error("compare", noisy, "--reference", tmp_path / "small.exr", code=1)
    assert re.match(r".*noisy.exr against .*small.exr: reference is \(23, 32, 3\) but image is \(24, 32, 3\)", message)
    assert "no.exr cannot be read" in error("compare", noisy, "--reference", "no.exr", code=1)


def test_compare_without_the_optional_packages(noisy, tmp_path):
    (tmp_path / "sitecustomize.py").write_text(
        "import importlib.util as util\n"
        "find = util.find_spec\n"
        "util.find_spec = lambda name, *rest: None if name in ('skimage', 'flip_evaluator') else find(name, *rest)\n"
    )
    env = os.environ | {"PYTHONPATH": str(tmp_path)}
    done = subprocess.run(
        [COMMAND, "compare", noisy, "--reference", noisy], capture_output=True, text=True, env=env, check=True
    )
    assert [text.strip() for text in done.stdout.splitlines()[2].split("|")[-3:-1]] == ["-", "-"]
    assert done.stderr.splitlines() == [
        "note: SSIM needs scikit-image: pip install 'mcdenoise-cl[demo]'",
        "note: FLIP needs flip-evaluator: pip install 'mcdenoise-cl[demo]'",
    ]


def test_render(tmp_path):
    assert "room" in run("render", "--list").split()
    target = tmp_path / "frame.exr"
    options = ["--width", 16, "--height", 12, "--spp", 2, "--seed", 3, "--halves", "--variant", "scalar_rgb"]
    said = notes("render", "room", "-o", target, *options)
    assert said.splitlines()[-1].startswith(f"{target}: 16 x 12, 2 samples per pixel, color, albedo, normal, depth")
    frame = read_exr(target)
    assert frame.shape == (12, 16) and set(frame.planes()) == set(PLANES)
    assert frame.metadata["samples_per_pixel"] == 2
    before = target.read_bytes()
    assert "frame.exr exists already" in error("render", "room", "-o", target, *options, code=1)
    assert target.read_bytes() == before
    assert "there is no folder" in error("render", "room", "-o", tmp_path / "no" / "a.exr", "--spp", 1, code=1)
    error("render", "no-such-scene", "-o", tmp_path / "a.exr", "--spp", 1, code=1)
    assert [path.name for path in tmp_path.iterdir()] == ["frame.exr"]


def test_rendering_without_the_optional_packages(tmp_path):
    for module in ("mitsuba.py", "PIL.py"):
        (tmp_path / module).write_text("raise ImportError('not here')")
    path = {"PYTHONPATH": str(tmp_path)}
    message = error("render", "room", "-o", tmp_path / "a.exr", "--spp", 1, code=1, **path)
    assert "needs Mitsuba" in message and "pip install 'mcdenoise-cl[render]'" in message
    assert "room" in run("render", "--list", **path)
    assert "pictures need Pillow" in error("demo", "--out", tmp_path / "demo", code=1, **path)


def test_demo(tmp_path):
    out = tmp_path / "new" / "demo"
    options = ["--out", out, "--width", 48, "--height", 32, "--spp", 4, "--reference-spp", 8]
    table = run("demo", *options, DRJIT_LIBLLVM_PATH="none")  # a tiny picture takes less time than compiling for LLVM
    assert [line.split("|")[1].strip() for line in table.splitlines()[2:]] == [
        "input, 4 spp", "NLM", "SSIM-NLM as printed", "SSIM-NLM", "guided", "auto"
    ]  # fmt: skip
    assert "time, ms" in table
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "<title>mcdenoise demo</title>" in page and ">SSIM-NLM as printed<" in page and "model map of auto" in page
    text = (out / "report.md").read_text(encoding="utf-8")
    assert text.startswith("# mcdenoise demo\n") and table in text + "\n"
    frames = ["auto.exr", "guided.exr", "nlm.exr", "noisy.exr", "reference.exr", "ssim-nlm-printed.exr", "ssim-nlm.exr"]
    assert sorted(path.name for path in out.glob("*.exr")) == frames
    for name in frames:
        assert read_exr(out / name).shape == (32, 48)
        with Image.open((out / name).with_suffix(".png")) as picture:
            assert picture.size == (48, 32)
    noisy, reference = read_exr(out / "noisy.exr"), read_exr(out / "reference.exr")
    assert set(noisy.planes()) == set(PLANES) and noisy.metadata["samples_per_pixel"] == 4
    assert np.abs(noisy.color_a - reference.color_a).min(axis=2).max() > 0, "the reference repeats the samples"
    clean = read_exr(out / "ssim-nlm.exr")
    np.testing.assert_array_equal(clean.color, denoise(noisy, method="ssim-nlm"))
    shown = re.findall(r"!\[.*\]\((.*)\)", text)
    assert len(shown) == 3
    with Image.open(out / shown[0]) as picture:
        assert picture.width > 4 * 48 and picture.height > 2 * 32
    # It knows its own folder again, and leaves what is not its own alone.
    other = tmp_path / "other"
    other.mkdir()
    (other / "noisy.exr").write_text("mine")
    assert "holds a noisy.exr that is not from a demo" in error("demo", "--out", other, code=1)
    assert (other / "noisy.exr").read_text() == "mine" and len(list(other.iterdir())) == 1
