"""Programs: found, built, cached, never stale, and clear when they do not build."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyopencl as cl
import pytest

from mcdenoise_cl import DeviceError
from mcdenoise_cl.device import context_for
from mcdenoise_cl.program import build, kernel_folder, source

WRITE = "kernel void write(global int *out) {{ out[0] = {value}; }}"


def run(context, device, folder, file="write.cl"):
    queue = cl.CommandQueue(context, device)
    out = np.zeros(1, np.int32)
    buffer = cl.Buffer(context, cl.mem_flags.WRITE_ONLY, 4)
    cl.Kernel(build(context, file, {}, folder), "write")(queue, (1,), None, buffer)
    cl.enqueue_copy(queue, out, buffer)
    return out[0]


def test_headers_are_pasted_once():
    text = source("nlm.cl")
    assert text.count("inline int reflect(") == 1
    assert "#include" not in text


def test_a_changed_kernel_is_never_served_stale(device, tmp_path):
    context = context_for(device)
    (tmp_path / "write.cl").write_text('#include "value.h"\n' + WRITE.format(value="VALUE"))
    for value in (1, 2, 1, 3):
        (tmp_path / "value.h").write_text(f"#define VALUE {value}\n")
        assert run(context, device, tmp_path) == value


def test_one_build_a_process(device, tmp_path):
    context = context_for(device)
    (tmp_path / "write.cl").write_text(WRITE.format(value=7))
    assert build(context, "write.cl", {}, tmp_path) is build(context, "write.cl", {}, tmp_path)
    assert build(context, "write.cl", {"A": 1}, tmp_path) is not build(context, "write.cl", {"A": 2}, tmp_path)


def test_the_next_process_finds_the_program_built(device, tmp_path):
    """Every cache on disk is moved to an empty folder; the second process must add no file to it."""
    code = "import mcdenoise_cl, numpy; mcdenoise_cl.denoise(numpy.ones((8, 8, 3)))"
    environment = {
        **os.environ,
        "MCDENOISE_DEVICE": device.name.strip(),
        "XDG_CACHE_HOME": str(tmp_path),
        "POCL_CACHE_DIR": str(tmp_path / "pocl"),
    }

    def files():
        subprocess.run([sys.executable, "-c", code], env=environment, check=True)
        # PoCL leaves the temporary copy behind of each program that it loads from its cache.
        return {path for path in tmp_path.rglob("*") if path.is_file() and not path.name.startswith("tempfile")}

    first = files()
    if not first:
        pytest.skip("this driver keeps its programs somewhere that cannot be moved")
    assert files() == first


def test_a_kernel_that_does_not_build_shows_device_options_and_log(device, tmp_path):
    (tmp_path / "bad.cl").write_text("kernel void bad(global int *out) { out[0] = nonsense_here; }")
    with pytest.raises(DeviceError) as error:
        build(context_for(device), "bad.cl", {"WIDTH": 8}, tmp_path)
    message = str(error.value)
    assert "bad.cl" in message and device.name.strip() in message
    assert "-DWIDTH=8" in message and "nonsense_here" in message


@pytest.fixture(scope="module")
def wheel_site(tmp_path_factory):
    """The wheel, installed into a folder of its own away from the checkout, without its dependencies."""
    root = Path(__file__).parents[1]
    if not (root / "pyproject.toml").is_file():
        pytest.fail("the tests are not in a checkout, so no wheel can be built")
    folder = tmp_path_factory.mktemp("wheel")
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, "wheel", "--no-deps", "-w", folder, root], check=True)
    [wheel] = folder.glob("*.whl")
    subprocess.run([*pip, "install", "--no-deps", "--target", folder / "site", wheel], check=True)
    return folder / "site"


def test_an_installed_wheel_finds_its_kernels(wheel_site, tmp_path):
    code = (
        "import mcdenoise_cl, numpy, mcdenoise_cl.program as p\n"
        "print(p.kernel_folder()); print(mcdenoise_cl.denoise(numpy.ones((8, 8, 3), 'f4')).sum())"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(wheel_site)},
        capture_output=True,
        text=True,
        check=True,
    )
    folder, total = done.stdout.split()
    assert folder == str(wheel_site / "mcdenoise_cl" / "kernels")
    assert float(total) == pytest.approx(192.0, rel=1e-5)


def test_the_wheel_holds_every_kernel_and_scene(wheel_site):
    root = kernel_folder().parent
    for name in ("kernels", "scenes"):
        shipped = {path.name for path in (wheel_site / "mcdenoise_cl" / name).iterdir() if path.is_file()}
        assert {path.name for path in (root / name).iterdir() if path.is_file()} <= shipped, name


def test_missing_kernels_are_explained(wheel_site, tmp_path):
    site = tmp_path / "site"
    shutil.copytree(wheel_site, site)
    shutil.rmtree(site / "mcdenoise_cl" / "kernels")
    code = "import mcdenoise_cl, numpy; mcdenoise_cl.denoise(numpy.ones((8, 8, 3)))"
    environment = {**os.environ, "PYTHONPATH": str(site)}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert "the kernels are missing" in done.stderr and "reinstall mcdenoise-cl" in done.stderr


def test_importing_the_package_imports_no_extra():
    code = (
        "import sys, mcdenoise_cl\n"
        "extras = {'mitsuba', 'drjit', 'cv2', 'skimage', 'matplotlib', 'PIL', 'flip_evaluator', 'scipy', 'dask'}\n"
        "assert not extras & set(sys.modules), extras & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
