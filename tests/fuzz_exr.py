"""Feed the EXR door with damaged files, by hand: every file must become a frame or an error of our own.

The fuzzer needs atheris, which is no part of the tests' own packages, so it has an environment to itself:

    python3 -m venv /tmp/fuzz && /tmp/fuzz/bin/pip install atheris .
    PYTHONPATH=. nice /tmp/fuzz/bin/python tests/fuzz_exr.py /tmp/corpus -max_total_time=600

It starts from the small files of `seeds`, keeps in that folder what led to new lines of ours, and stops at the first
finding, which it writes to the current folder as `crash-...`, `oom-...` or `timeout-...`. A finding belongs, once it is
fixed, into `fuzz_findings/` under a name that says what it is; `test_fuzz_findings.py` goes over that folder.

What counts as a finding: an exception that is not a `McdenoiseError`, pixels that differ from one reading to the next,
the end of the process, 20 seconds for one file, or more than `ROOM` of memory for a file of a few kB.
"""

from __future__ import annotations

import contextlib
import os
import random
import struct
import sys
from pathlib import Path

import numpy as np
import OpenEXR

try:
    import atheris
except ImportError:  # the tests import this module too, and have no need of it
    atheris = None
try:
    import resource
except ImportError:  # on Windows, where findings are gone over without it
    resource = None

with contextlib.nullcontext() if atheris is None else atheris.instrument_imports(include=["mcdenoise_cl"]):
    from mcdenoise_cl.errors import McdenoiseError
    from mcdenoise_cl.exr import read_exr, write_exr
    from mcdenoise_cl.frame import Frame

#: Bytes by which reading one small file may raise the process's peak.
ROOM = 1 << 29
HEIGHT, WIDTH = 5, 7


def door(path: Path) -> str:
    """Read a file twice and write a result with it as the template: "frame", or the message of our own error.

    Whatever else is raised passes through.
    """
    try:
        frame = read_exr(path)
        # Pixels that the file does not hold would be whatever lay in memory, so the memory is given other contents.
        junk = [np.full(max(plane.nbytes // 4, 1), 7.5e30, np.float32) for plane in frame.planes().values()] * 4
        del junk
        again = read_exr(path).planes()
        for name, plane in frame.planes().items():
            assert plane.tobytes() == again[name].tobytes(), f"{name} is another at each reading"
        write_exr(path.with_name("out.exr"), frame, template=path)
    except McdenoiseError as error:
        return str(error)
    return "frame"


def peak() -> int:
    """Bytes of memory that this process has held at most."""
    if resource is None:
        return 0
    unit = 1 if sys.platform == "darwin" else 1024
    return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def seeds(folder: Path) -> None:
    """Small whole files of every kind that the door reads: compressions, pixel types, layers, parts, tiles, deep."""
    rng = np.random.default_rng(0)
    color = rng.random((HEIGHT, WIDTH, 3), np.float32)
    for compression in ("none", "rle", "zips", "zip", "piz", "pxr24", "b44", "b44a", "dwaa", "dwab"):
        write_exr(folder / f"{compression}.exr", color, compression=compression, dtype="half")
    frame = Frame(color, color, color, color[..., 0], color, metadata={"samples_per_pixel": 4, "scene": "a"})
    write_exr(folder / "layers.exr", frame)
    for storage in ("scanlineimage", "tiledimage"):
        for compression in ("NO", "ZIP", "PIZ", "DWAA"):
            plain = _part(storage, compression, {c: color[..., i] for i, c in enumerate("RGB")}, "rgb")
            count = np.arange(HEIGHT * WIDTH, dtype=np.uint32).reshape(HEIGHT, WIDTH)
            other = _part(storage, compression, {"id": count, "Z": color[..., 0].astype("f2")}, "more")
            OpenEXR.File([plain]).write(str(folder / f"{storage}-{compression}.exr"))
            OpenEXR.File([plain, other]).write(str(folder / f"parts-{storage}-{compression}.exr"))
    deep = np.empty((HEIGHT, WIDTH), object)
    for i, where in enumerate(np.ndindex(HEIGHT, WIDTH)):
        deep[where] = np.arange(i % 3, dtype=np.float32)
    parts = [_part("scanlineimage", "ZIP", {c: color[..., 0] for c in "RGB"}, "flat")]
    OpenEXR.File([*parts, _part("deepscanline", "ZIPS", {"Z": deep}, "deep")]).write(str(folder / "deep.exr"))


def _part(storage: str, compression: str, channels: dict[str, np.ndarray], name: str) -> OpenEXR.Part:
    header = {"type": getattr(OpenEXR, storage), "compression": getattr(OpenEXR, f"{compression}_COMPRESSION")}
    if storage == "tiledimage":
        header["tiles"] = OpenEXR.TileDescription()
        header["tiles"].xSize, header["tiles"].ySize = 4, 3
    return OpenEXR.Part(header, {c: np.ascontiguousarray(pixels) for c, pixels in channels.items()}, name)


NUMBERS = (0, 1, 2, 3, 4, 7, 255, 256, 65535, 65536, 2**24, 2**30, 2**31 - 1, 2**31, 2**32 - 2, 2**32 - 1)
NAMES = (b"channels\0chlist", b"compression\0compression", b"dataWindow\0box2i", b"displayWindow\0box2i")
NAMES += (b"tiles\0tiledesc", b"chunkCount\0int", b"type\0string", b"name\0string", b"lineOrder\0lineOrder")


def mutate(data: bytes, most: int, seed: int) -> bytes:
    """Half the time bytes as libFuzzer changes them, else a number in a place where EXR keeps one."""
    rng = random.Random(seed)
    if len(data) < 64 or rng.random() < 0.5:
        return atheris.Mutate(data, most)
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 3))):
        at = rng.randrange(4, len(changed) - 4)
        name = rng.choice(NAMES)
        found = changed.find(name)
        if found >= 0 and rng.random() < 0.7:  # within the value, which follows the name, a zero and its size
            at = min(found + len(name) + 1 + rng.randrange(0, 24), len(changed) - 4)
        if rng.random() < 0.5:
            changed[at] = rng.choice((rng.randrange(256), 0, 1, 255, changed[at] ^ (1 << rng.randrange(8))))
        else:
            changed[at : at + 4] = struct.pack("<I", rng.choice(NUMBERS))
    return bytes(changed[:most])


def main() -> None:
    corpus = Path(sys.argv[1]).resolve()
    work = corpus.with_name(corpus.name + "-work")
    for folder in (corpus, work):
        folder.mkdir(parents=True, exist_ok=True)
    seeds(corpus)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)  # OpenEXR speaks of each file to stdout, libFuzzer to stderr
    sys.stdout = os.fdopen(nowhere, "w")

    def one(data: bytes) -> None:
        path, before = work / "in.exr", peak()
        path.write_bytes(data)
        door(path)
        if peak() - before > ROOM:
            print(f"took {(peak() - before) / 2**20:.0f} MiB", file=sys.stderr)
            raise MemoryError(f"{len(data)} bytes took {(peak() - before) / 2**20:.0f} MiB")

    options = ["-timeout=20", "-rss_limit_mb=8000", *sys.argv[2:]]
    atheris.Setup([sys.argv[0], str(corpus), *options], one, custom_mutator=mutate)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
