"""One denoiser and one frame size in a process of its own, for `speed.py`.

    python bench/worker.py NAME PLANES

PLANES is a folder of one .npy file a plane and `exposure.json`, as `speed.py` writes it. The worker loads what the
denoiser looks at, makes the denoiser, denoises once and says so; after that it answers every line `run` on stdin. Each
answer is one line of JSON on stdout; everything that libraries print there goes to stderr. It ends with its stdin.

- "ready": {"made": seconds for making the denoiser, "first": seconds of the first call}.
- "run": {"seconds": of one call, "stages": device milliseconds by stage (ours), "host_bytes", "device_bytes"}.

A call is what a user pays a frame: from arrays in host memory to an array in host memory. A turn begins with calls
that are not counted, because the other denoisers took turns in between: they bring caches and clocks back to where
they are while frames come one after another. If calls are short it then reports the median of several.

`host_bytes` is the highest resident memory of the process so far, less what was resident once the inputs were loaded,
less the output. It includes code and compilers that the denoiser brings into the process, on CPU runtimes the buffers
of the device, and for OpenCV and scikit-image the frame converted to what they take. `device_bytes` is what the pool
of the engine holds: it never gives back within a frame, so this is the peak. Peers on the CPU have none.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from mcdenoise_cl import Denoiser, Frame

#: Seconds of calls before the ones that count, and of those that do; calls longer than LONG are made once a turn.
SETTLE, MEASURE, LONG = 0.2, 0.2, 1.0
#: Calls of one turn, at most.
MOST = 20


@dataclass(frozen=True)
class Ready:
    """A denoiser to be timed: a call of it, and what its last call took on the device (None for peers)."""

    call: Callable[[], np.ndarray]
    stages: Callable[[], dict[str, float]] | None = None
    device_bytes: Callable[[], int] | None = None


@contextmanager
def ours(name: str, frame: Frame) -> Iterator[Ready]:
    """One of our entries, with an output array that is used again as someone does who denoises many frames."""
    from entries import entry

    denoiser = Denoiser(*frame.shape, **entry(name).arguments)
    out = np.empty_like(frame.color)
    # The engine is asked and not `denoiser.report`, which runs kernels of its own and takes memory for them.
    engine = denoiser._engine
    yield Ready(lambda: denoiser(frame, out=out), engine.stage_times, lambda: engine._pool.managed_bytes)


@contextmanager
def peers(name: str, frame: Frame, exposure: float) -> Iterator[Ready]:
    """One of the peers."""
    from peers import all_peers

    peer = next(peer for peer in all_peers() if peer.name == name)
    with peer.opened(frame, exposure) as run:
        yield Ready(run)


def turn(ready: Ready, last: float) -> tuple[float, dict[str, float]]:
    """Seconds of a call and the device's milliseconds by stage: medians over a turn. `last`: the call before's."""
    if last < LONG:
        begin = time.perf_counter()
        while time.perf_counter() - begin < SETTLE:
            last, _ = timed(ready)
    calls = [timed(ready)]
    while sum(seconds for seconds, _ in calls) < MEASURE and len(calls) < MOST:
        calls.append(timed(ready))
    stages = {name: statistics.median(one[name] for _, one in calls) for name in calls[0][1]}
    return statistics.median(seconds for seconds, _ in calls), stages


def timed(ready: Ready) -> tuple[float, dict[str, float]]:
    """One call."""
    start = time.perf_counter()
    ready.call()
    seconds = time.perf_counter() - start
    return seconds, ready.stages() if ready.stages else {}


def load(folder: Path, wanted: tuple[str, ...]) -> tuple[Frame, float]:
    """The planes of a folder that are wanted and there, in memory of their own, and the exposure."""
    planes = {name: np.load(folder / f"{name}.npy") for name in wanted if (folder / f"{name}.npy").exists()}
    return Frame(**planes), float(json.loads((folder / "exposure.json").read_text()))


def resident(peak: bool) -> int:
    """Bytes of this process in memory, now or at most so far.

    Outside Linux only the peak is known. On Linux ru_maxrss would not do: it begins with the peak of the parent.
    """
    status = Path("/proc/self/status")
    if status.exists():
        key = "VmHWM:" if peak else "VmRSS:"
        return next(int(line.split()[1]) << 10 for line in status.read_text().splitlines() if line.startswith(key))
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def serve(name: str, folder: Path, say: Callable[[Any], None]) -> None:
    """Make ready, tell, and answer until stdin ends."""
    from entries import ENTRIES, entry
    from peers import all_peers

    wanted = entry(name).planes if name in ENTRIES else ("color", *next(p.needs for p in all_peers() if p.name == name))
    frame, exposure = load(folder, wanted)
    before = resident(peak=False)
    begin = time.perf_counter()
    with ours(name, frame) if name in ENTRIES else peers(name, frame, exposure) as ready:
        made = time.perf_counter() - begin
        begin = time.perf_counter()
        output = ready.call().nbytes
        last = time.perf_counter() - begin
        say({"made": made, "first": last})
        for line in sys.stdin:
            if line.strip() != "run":
                raise SystemExit(f"worker: {line.strip()!r} is no command: send 'run'")
            last, stages = turn(ready, last)
            host = max(0, resident(peak=True) - before - output)
            device = ready.device_bytes() if ready.device_bytes else None
            say({"seconds": last, "stages": stages, "host_bytes": host, "device_bytes": device})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", help="one of entries.ENTRIES, or a peer")
    parser.add_argument("planes", type=Path, help="folder of planes")
    options = parser.parse_args()
    answers: TextIO = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    serve(options.name, options.planes, lambda answer: print(json.dumps(answer), file=answers, flush=True))


if __name__ == "__main__":
    main()
