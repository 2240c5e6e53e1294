"""What a measurement ran on and with: part of every JSON file, so that a chart can say it in words."""

from __future__ import annotations

import os
import platform
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import mcdenoise_cl
from mcdenoise_cl.device import DeviceInfo

#: Packages whose versions can change a figure, by the module that they bring.
MODULES = ("numpy", "pyopencl", "pocl_binary_distribution", "pyoidn", "cv2", "skimage", "flip_evaluator", "mitsuba")
#: What runtimes are called where people talk about them.
RUNTIMES = {"Portable Computing Language": "PoCL", "Intel(R) OpenCL": "Intel's CPU runtime"}


@dataclass(frozen=True)
class Machine:
    """The OpenCL device that our methods ran on, and the CPU that everything else did.

    Attributes:
        device, runtime, version, driver, kind, compute_units, memory: of the OpenCL device, as the runtime reports
            them; memory in bytes.
        cpu: the processor's name.
        cores: how many of its logical cores this process may use.
        system: operating system and Python.
    """

    device: str
    runtime: str
    version: str
    driver: str
    kind: str
    compute_units: int
    memory: int
    cpu: str
    cores: int
    system: str


def machine(info: DeviceInfo) -> dict[str, Any]:
    """The facts of this machine, ready for JSON."""
    facts = Machine(
        device=info.name,
        runtime=info.runtime,
        version=info.version,
        driver=info.driver,
        kind=info.kind,
        compute_units=info.compute_units,
        memory=info.memory,
        cpu=_cpu(),
        cores=len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1,
        system=f"{platform.system()} {platform.machine()}, Python {platform.python_version()}",
    )
    return asdict(facts)


def words(facts: dict[str, Any]) -> str:
    """The machine as a chart's title names it."""
    cores = f"{facts['cores']} core{'s' if facts['cores'] != 1 else ''} of {facts['cpu']}"
    if facts["kind"] == "CPU":
        runtime = RUNTIMES.get(facts["runtime"], facts["runtime"])
        return f"{cores} ({runtime})"
    return f"{facts['device']} (driver {facts['driver']}); peers on {cores}"


def versions() -> dict[str, str]:
    """Installed packages by the name they were installed under."""
    brought_by = metadata.packages_distributions()
    names = sorted({name for module in MODULES for name in brought_by.get(module, ())})
    return {"mcdenoise-cl": mcdenoise_cl.__version__, **{name: metadata.version(name) for name in names}}


def _cpu() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return " ".join(line.partition(":")[2].split())
    return platform.processor() or platform.machine()
