"""The parts of `gpu.sh` that are easier said in Python: which device, and one JSON file of all that was measured.

    python bench/gather.py device [NAME]
    python bench/gather.py write --work FOLDER [--quick]

`device` prints what MCDENOISE_DEVICE has to be, for the first GPU or for the device of that name, or fails with a
sentence. `write` joins tests.xml (of pytest), speed.json and quality.json of the folder with what is known of the
device into results/<device>.json beside this file, which appears whole or not at all.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import tempfile
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from machine import machine, versions

from mcdenoise_cl.choose import pick_device
from mcdenoise_cl.device import DeviceInfo, list_devices
from mcdenoise_cl.errors import DeviceError

RESULTS = Path(__file__).with_name("results")
NO_GPU = (
    "there is no OpenCL GPU here, only {found}: install its driver with OpenCL. If an NVIDIA driver is installed and "
    "not found (as in containers), set OCL_ICD_VENDORS to a folder with a file nvidia.icd that holds the line "
    "libnvidia-opencl.so.1. --device NAME runs on another device"
)


def find(name: str | None) -> DeviceInfo:
    """The first GPU, or the device of a name.

    Raises:
        DeviceError: there is none.
    """
    if name:
        return pick_device(name)
    try:
        devices = list_devices()
    except DeviceError:  # a loader without a single runtime
        devices = []
    gpu = next((info for info in devices if info.kind == "GPU"), None)
    if gpu is None:
        found = ", ".join(f"{info.name} ({info.kind})" for info in devices) or "no device at all"
        raise DeviceError(NO_GPU.format(found=found))
    return gpu


def choice(info: DeviceInfo) -> str:
    """What picks this device: its name, or its number where another of that name comes first."""
    return info.name if pick_device(info.name) == info else str(info.index)


def test_counts(path: Path) -> dict[str, Any]:
    """Counts of a JUnit file, and the names of the tests that failed."""
    suites = list(ElementTree.parse(path).getroot().iter("testsuite"))
    counts = {key: sum(int(one.get(key, 0)) for one in suites) for key in ("tests", "failures", "errors", "skipped")}
    passed = counts["tests"] - counts["failures"] - counts["errors"] - counts["skipped"]
    failed = [
        f"{case.get('classname')}.{case.get('name')}"
        for one in suites
        for case in one.iter("testcase")
        if case.find("failure") is not None or case.find("error") is not None
    ]
    return {"passed": passed, **counts, "seconds": sum(float(one.get("time", 0)) for one in suites), "failed": failed}


def stage_times(speed: dict[str, Any]) -> dict[str, dict[str, dict[str, float]]]:
    """Device milliseconds by denoiser, frame size and stage, as `speed.py` measured them."""
    found: dict[str, dict[str, dict[str, float]]] = {}
    for size in speed["sizes"]:
        for one in size["timings"]:
            if one["stages"]:
                found.setdefault(one["name"], {})[f"{size['width']}x{size['height']}"] = one["stages"]
    return found


def commit() -> str | None:
    """The version of the sources, with a + where they were changed; None outside a git checkout."""
    here = Path(__file__).parent
    try:
        run = [
            subprocess.run(["git", *words], cwd=here, capture_output=True, text=True, check=True).stdout.strip()
            for words in (("rev-parse", "HEAD"), ("status", "--porcelain", "--untracked-files=no"))
        ]
    except (OSError, subprocess.CalledProcessError):
        return None
    return run[0] + ("+" if run[1] else "")


def collect(info: DeviceInfo, work: Path, quick: bool) -> dict[str, Any]:
    """Everything that the result file holds."""
    speed = json.loads((work / "speed.json").read_text())
    return {
        "device": info.name,
        "driver": info.driver,
        "machine": machine(info),
        "versions": versions(),
        "commit": commit(),
        "measured": datetime.now(UTC).isoformat(timespec="seconds"),
        "quick": quick,
        "tests": test_counts(work / "tests.xml"),
        "stages": stage_times(speed),
        "speed": speed,
        "quality": json.loads((work / "quality.json").read_text()),
    }


def write(figures: dict[str, Any], folder: Path) -> Path:
    """Into a file named after the device; a quick run does not replace a whole one."""
    folder.mkdir(parents=True, exist_ok=True)
    slug = re.sub(r"[^a-z0-9]+", "-", figures["device"].lower()).strip("-")
    path = folder / f"{slug}{'-quick' if figures['quick'] else ''}.json"
    with tempfile.NamedTemporaryFile("w", dir=folder, prefix=".", suffix=".part", delete=False) as file:
        try:
            file.write(json.dumps(figures, indent=1) + "\n")
            file.flush()
            os.fsync(file.fileno())
            Path(file.name).chmod(0o644)
            Path(file.name).replace(path)
        except BaseException:
            Path(file.name).unlink(missing_ok=True)
            raise
    return path


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    device = commands.add_parser("device", help="print what MCDENOISE_DEVICE has to be")
    device.add_argument("name", nargs="?", help="part of a name; the first GPU without one")
    writer = commands.add_parser("write", help="write one JSON file of everything")
    writer.add_argument("--work", type=Path, required=True, help="folder of tests.xml, speed.json and quality.json")
    writer.add_argument("--quick", action="store_true", help="mark the figures as those of a dry run")
    options = parser.parse_args()
    try:
        if options.command == "device":
            print(choice(find(options.name)))
        else:
            print(write(collect(pick_device(), options.work, options.quick), RESULTS))
    except DeviceError as error:
        raise SystemExit(f"gpu.sh: {error}") from None


if __name__ == "__main__":
    main()
