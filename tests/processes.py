"""Processes with caches of their own, for the tests of caches: what they run, and fixtures that start them."""

import hashlib
import os
import shutil
import subprocess
import sys

import inputs
import numpy as np
import pytest

from mcdenoise_cl import denoise
from mcdenoise_cl.device import list_devices

SMALL = {"method": "nlm", "search_radius": 1, "patch_radius": 1}
COLOR = inputs.planes("hdr", 24, 32, 3)

#: A process that denoises COLOR and prints what came of it. OWN_CACHE makes it take the driver for one that keeps no
#: programs; KILL_AT is a folder to
#: keep them in, where it says when it has written the first one and stays, before it gives it its name, to be killed.
CHILD = """
import hashlib, os, sys, time
import numpy as np
from mcdenoise_cl import denoise, measured, program
if os.environ.get("OWN_CACHE"):
    program.has_src_build_cache = lambda device: None
class Stay(type(measured.Path())):
    def replace(self, target):
        print("writing", flush=True)
        time.sleep(1e6)
if os.environ.get("KILL_AT"):
    program.cache_folder = lambda: Stay(os.environ["KILL_AT"])
    measured.Path = Stay
while os.environ.get("WAIT_FOR") and not os.path.exists(os.environ["WAIT_FOR"]):
    time.sleep(0.01)
color = np.load(os.environ["COLOR"])
print(hashlib.sha256(denoise(color, method="nlm", search_radius=1, patch_radius=1).tobytes()).hexdigest())
"""


class Place:
    """A folder with every cache of a process in it."""

    def __init__(self, folder, info):
        self.folder = folder
        folder.mkdir(exist_ok=True)
        np.save(folder / "color.npy", COLOR)
        self.environment = {k: v for k, v in os.environ.items() if not k.startswith("PYOPENCL")} | {
            "XDG_CACHE_HOME": str(folder),
            "POCL_CACHE_DIR": str(folder / "pocl"),
            "MCDENOISE_DEVICE": str(info.index),
            "COLOR": str(folder / "color.npy"),
            "PYTHONPATH": os.pathsep.join(sys.path),
        }

    def start(self, **environment):
        return subprocess.Popen(
            [sys.executable, "-c", CHILD],
            env=self.environment | environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def run(self, **environment):
        return result(self.start(**environment))

    def files(self, pattern):
        return [path for path in self.folder.rglob(pattern) if path.is_file()]


def result(process):
    out, err = process.communicate()
    assert process.returncode == 0, err
    return out.strip()


def is_whole(program):
    data = program.read_bytes()
    return len(data) > 32 and hashlib.sha256(data[32:]).digest() == data[:32]


@pytest.fixture(scope="session")
def pocl():
    """The PoCL that is picked here, as the others have their caches elsewhere."""
    found = [info for info in list_devices() if "PoCL" in info.version]
    if not found:
        pytest.skip("no PoCL here")
    return found[0]


@pytest.fixture(scope="session")
def digest(pocl):
    return hashlib.sha256(denoise(COLOR, device=pocl.device, **SMALL).tobytes()).hexdigest()


@pytest.fixture
def place(tmp_path, pocl):
    return Place(tmp_path / "caches", pocl)


@pytest.fixture(scope="session")
def filled(tmp_path_factory, pocl, digest):
    """Caches that two processes have filled, of which one kept its programs itself."""
    place = Place(tmp_path_factory.mktemp("filled"), pocl)
    assert place.run() == place.run(OWN_CACHE="1") == digest
    return place.folder


@pytest.fixture
def warm(filled, tmp_path, pocl):
    shutil.copytree(filled, tmp_path / "warm")
    return Place(tmp_path / "warm", pocl)
