"""Loaded by the workers of test_farm.py: a file beside a frame makes whoever gets that frame misbehave.

`x.hold` beside `x.exr`: the first worker writes all of the result but gives it no name yet, prints its process number,
and stays so, to be killed. `x.deadly`: every worker ends at once. `x.broken`: the device fails; `x.unseen`: the storage
is not there; both on worker 0 alone, or on all where the file says so.
"""

import os
import signal
import threading

from mcdenoise_cl import DeviceError, exr_file, farm_worker
from mcdenoise_cl.job import Outcome

if "_here" not in globals():  # Dask loads it twice
    _run_job, _write = farm_worker.run_job, exr_file._write
    _here = threading.local()


def run_job(job, recipe, **options):
    if job.source.with_suffix(".deadly").exists():
        os.kill(os.getpid(), signal.SIGKILL)
    for suffix, kind in ((".broken", DeviceError), (".unseen", farm_worker.UnseenError)):
        marker = job.source.with_suffix(suffix)
        if marker.exists() and (marker.read_text() == "all" or os.environ.get("CUDA_VISIBLE_DEVICES") == "0"):
            return Outcome(job.source, job.target, error=kind("as asked"))
    try:
        job.source.with_suffix(".hold").unlink()
        _here.holds = True
    except FileNotFoundError:
        pass
    return _run_job(job, recipe, **options)


def write(path, parts):
    _write(path, parts)
    if getattr(_here, "holds", False):
        print(f"holding {os.getpid()}", flush=True)
        threading.Event().wait()


farm_worker.run_job, exr_file._write = run_job, write
