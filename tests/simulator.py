"""Every kernel under oclgrind, on small frames and in both schedules: no data race, nothing read or written out of
bounds, nothing used that was never written, no wrong call.

    python tests/simulator.py            # small tiles and groups, so that small frames have seams
    python tests/simulator.py --whole    # tiles and groups as devices get them: slow
    python tests/simulator.py auto nlm   # some of the cases of small_frames.py

First it checks that the simulator reports each kind of fault in kernels that have it. Exits with 1 if it does not, or
if it reports anything of ours.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from itertools import product
from pathlib import Path
from time import monotonic

from small_frames import NAMES

# Optimised code holds intrinsics that oclgrind 21.10 lacks.
OCLGRIND = ("oclgrind", "--data-races", "--uninitialized", "--check-api", "--build-options", "-cl-opt-disable")

#: PyOpenCL asks every device for what newer versions of OpenCL know: no fault.
ASKED = "Function: clGetDeviceInfo\n\tError:    CL_INVALID_VALUE"

#: What the simulator calls each kind of fault, and a program that has it, for PyOpenCL.
FAULTS = {
    "data race": "out[0] = get_global_id(0);",
    "Invalid write": "out[get_global_id(0) + 63] = 1;",
    "Invalid read": "out[get_global_id(0)] = out[get_global_id(0) - 1];",
    "Uninitialized value": "int own[2]; own[0] = 1; out[get_global_id(0)] = own[get_global_id(0)];",
    "uninitialized value": "if (out[get_global_id(0)] > 1) out[get_global_id(0)] = 1;",
    "CL_INVALID_WORK_GROUP_SIZE": "",
}
FAULTY = """
import sys
import pyopencl as cl

context = cl.Context(cl.get_platforms()[0].get_devices())
queue = cl.CommandQueue(context)
out = cl.Buffer(context, cl.mem_flags.READ_WRITE, 256)
text = f"kernel void faulty(global int *out) {{ {sys.argv[1]} }}"
kernel = cl.Kernel(cl.Program(context, text).build(), "faulty")
kernel(queue, (2,), (2,) if sys.argv[1] else (100000,), out)
queue.finish()
"""


def simulate(*command: str, schedule: str = "") -> tuple[list[str], subprocess.CompletedProcess]:
    """Run Python with these arguments on the simulator: what it reports, and how the process ended."""
    environment = {**os.environ, "MCDENOISE_DEVICE": "oclgrind", "PYOPENCL_NO_CACHE": "1"}
    environment |= {"MCDENOISE_SCHEDULE": schedule} if schedule else {}
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder, "log")
        call = (*OCLGRIND, "--log", str(log), sys.executable, *command)
        done = subprocess.run(call, env=environment, capture_output=True, text=True, check=False)
        parts = log.read_text().split("\n\n") if log.exists() else []
    # Wrong calls go to the standard error; all else, and only that, to the log.
    parts += [part for part in done.stderr.split("\n\n") if "Oclgrind - OpenCL runtime error" in part]
    return [part.strip() for part in parts if part.strip() and ASKED not in part], done


def finds(fault: str) -> bool:
    """Whether the simulator reports it where it is."""
    reports, _ = simulate("-c", FAULTY, FAULTS[fault])
    return any(fault in report for report in reports)


def run(name: str, schedule: str, options: list[str]) -> bool:
    """One case; prints what is found, and says whether that is nothing."""
    start = monotonic()
    reports, done = simulate(str(Path(__file__).with_name("small_frames.py")), name, *options, schedule=schedule)
    fine = not reports and done.returncode == 0
    verdict = "nothing" if fine else f"{len(reports)} reports, exit code {done.returncode}"
    error = [done.stderr[-2000:]] if done.returncode else []
    print(
        "\n\n".join([f"{schedule:5} {name:17} {monotonic() - start:4.0f} s  {verdict}", *reports[:5], *error]),
        flush=True,
    )
    return fine


def main(arguments: list[str]) -> int:
    if shutil.which("oclgrind") is None:
        print("oclgrind is not installed: on Debian and Ubuntu, apt-get install oclgrind")
        return 1
    missed = [fault for fault in FAULTS if not finds(fault)]
    if missed:
        print(f"oclgrind does not report what it should: {', '.join(missed)}")
        return 1
    options = [argument for argument in arguments if argument.startswith("--")]
    names = [argument for argument in arguments if argument not in options] or list(NAMES)
    # The longest first, so that no core is idle at the end.
    cases = [(name, schedule, options) for name, schedule in product(reversed(names), ("group", "tile"))]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        fine = list(pool.map(lambda case: run(*case), cases))
    print(f"{sum(fine)} of {len(fine)} runs without a report")
    return 0 if all(fine) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
