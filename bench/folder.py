"""A folder of frames through everything that can go wrong: prints a table, and ends with 1 if a cell is wrong.

    python bench/folder.py [--frames 60] [--size 96 54] [--method guided] [--made-up] [--only CASE...]

The frames are renderings of a scene of this repository, each with another seed (`--made-up`, or without Mitsuba: a
synthetic room). Each case runs the command in processes of its own, and in the end every output must have the bits
that `denoise` gives for its frame alone, and nothing else may be in the folder:

- plain;
- killed: kill -9 at random moments, again and again, then once to the end;
- interrupted: Ctrl-C at a random moment, then to the end;
- corrupt: one file is cut short; then it is whole again;
- missing: a sequence of which one frame is not there; then it is;
- disk full: a file system with room for half of the frames, which is then cleared; only as root, who may mount one;
- farm: a Dask scheduler and two workers, one of which is killed half way.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from mcdenoise_cl import Frame, denoise, read_exr, write_exr

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
import farms
import inputs

COMMAND = [sys.executable, "-c", "import sys; from mcdenoise_cl.cli import main; sys.exit(main(sys.argv[1:]))"]
KILLS = 6


class Folder:
    """The frames, what each becomes alone, and the command on all of them."""

    def __init__(self, source: Path, method: str) -> None:
        self.source, self.method = source, method
        self.expected = {path.name: denoise(read_exr(path), method=method) for path in sorted(source.iterdir())}

    def start(self, out: Path, *given: str) -> subprocess.Popen[str]:
        arguments = ["denoise", *(given or [str(self.source)]), "-o", str(out), "--method", self.method]
        return subprocess.Popen([*COMMAND, *arguments], stderr=subprocess.PIPE, text=True)

    def run(self, out: Path, *given: str) -> tuple[int, str]:
        """Exit code and the line that sums up."""
        process = self.start(out, *given)
        said = process.communicate()[1].splitlines()
        line = next((line for line in said if "denoised" in line), said[-1] if said else "")
        return process.returncode, re.sub(r" with \S+ on [^;]*", "", line)

    def wrong(self, out: Path, but: set[str] = frozenset()) -> list[str]:
        """What is not as it should be in the folder of the results."""
        found = {path.name for path in out.iterdir()} if out.exists() else set()
        wanted = set(self.expected) - but
        wrong = [f"{name} is missing" for name in sorted(wanted - found)]
        wrong += [f"{name} is too much" for name in sorted(found - wanted)]
        for name in sorted(wanted & found):
            if not np.array_equal(read_exr(out / name).color, self.expected[name]):
                wrong.append(f"{name} has other bits")
        return wrong


def plain(folder: Folder, work: Path) -> tuple[str, list[str]]:
    code, said = folder.run(work / "out")
    return f"exit {code}: {said}", folder.wrong(work / "out")


def killed(folder: Folder, work: Path, how: int = signal.SIGKILL, times: int = KILLS) -> tuple[str, list[str]]:
    out, rng, wrong, steps = work / "out", random.Random(7), [], []
    for _ in range(times):
        before = len(list(out.glob("*.exr"))) if out.exists() else 0
        process = folder.start(out)
        while process.poll() is None and (len(list(out.glob("*.exr"))) if out.exists() else 0) <= before:
            time.sleep(0.005)
        time.sleep(rng.uniform(0, 0.5))
        process.send_signal(how)
        process.communicate()
        files = sorted(out.glob("*.exr"))
        steps.append(len(files))
        for path in files:  # also before it is run again, what is there is right
            if not np.array_equal(read_exr(path).color, folder.expected[path.name]):
                wrong.append(f"{path.name} has other bits after a kill")
        # The signal itself: it came when the command had ended and Python was still clearing up.
        if how == signal.SIGINT and process.returncode not in (0, 130, -how):
            wrong.append(f"exit {process.returncode} after Ctrl-C")
        if how == signal.SIGINT and any(out.glob(".*")):
            wrong.append("an unfinished file is left after Ctrl-C")
    code, said = folder.run(out)
    return f"{', '.join(map(str, steps))} files after each; then exit {code}: {said}", wrong + folder.wrong(out)


def interrupted(folder: Folder, work: Path) -> tuple[str, list[str]]:
    return killed(folder, work, signal.SIGINT, 2)


@contextlib.contextmanager
def replaced(path: Path, by: bytes | None) -> Iterator[None]:
    """A file with other content, or without it, for a while; then it is as it was, to the time."""
    status, content = path.stat(), path.read_bytes()
    path.unlink() if by is None else path.write_bytes(by)
    try:
        yield
    finally:
        path.write_bytes(content)
        os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))


def failing(folder: Folder, work: Path, by: Callable[[bytes], bytes | None], *given: str) -> tuple[str, list[str]]:
    out, victim = work / "out", sorted(folder.source.iterdir())[len(folder.expected) // 2]
    with replaced(victim, by(victim.read_bytes())):
        code, said = folder.run(out, *given)
        wrong = folder.wrong(out, {victim.name}) + ([] if code == 1 else [f"exit {code}"])
    again, said_again = folder.run(out, *given)
    wrong += folder.wrong(out) + ([] if again == 0 else [f"exit {again}"])
    return f"exit {code}: {said}; then {again}: {said_again}", wrong


def corrupt(folder: Folder, work: Path) -> tuple[str, list[str]]:
    return failing(folder, work, lambda content: content[: len(content) // 2])


def missing(folder: Folder, work: Path) -> tuple[str, list[str]]:
    frames = f"1-{len(folder.expected)}"
    return failing(folder, work, lambda _: None, str(folder.source / "shot.####.exr"), "--frames", frames)


def disk_full(folder: Folder, work: Path) -> tuple[str, list[str]]:
    if os.name != "posix" or os.geteuid() != 0:
        return "not tried: only root may mount a small file system", []
    disk, size = work / "disk", sum(path.stat().st_size for path in folder.source.iterdir())
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={2 * size}", "none", str(disk)]
    done = subprocess.run(mount, capture_output=True, text=True)
    if done.returncode:
        return f"not tried: no file system can be mounted here ({done.stderr.strip()})", []
    try:
        (disk / "ballast").write_bytes(bytes(int(1.5 * size)))
        code, said = folder.run(disk / "out")
        done_now = {path.name for path in (disk / "out").iterdir()}
        wrong = folder.wrong(disk / "out", set(folder.expected) - done_now)
        if code != 1 or not 0 < len(done_now) < len(folder.expected):
            wrong.append(f"exit {code} with {len(done_now)} files: the disk was not full")
        (disk / "ballast").unlink()
        again, said_again = folder.run(disk / "out")
        wrong += folder.wrong(disk / "out") + ([] if again == 0 else [f"exit {again}"])
        return f"exit {code}: {said}; then {again}: {said_again}", wrong
    finally:
        subprocess.run(["umount", disk], check=True)


def farm(folder: Folder, work: Path) -> tuple[str, list[str]]:
    if find_spec("distributed") is None:
        return "not tried: pip install 'mcdenoise-cl[farm]'", []
    out, running = work / "out", farms.Farm()
    try:
        running.fill()
        process = folder.start(out, str(folder.source), "--dask", running.address)
        while process.poll() is None and len(list(out.glob("*.exr"))) < len(folder.expected) // 2:
            time.sleep(0.005)
        running.workers[0].kill()
        before = len(list(out.glob("*.exr")))
        said = process.communicate()[1].splitlines()
    finally:
        running.close()
    wrong = folder.wrong(out) + ([] if process.returncode == 0 else [f"exit {process.returncode}"])
    if not any("was lost" in line for line in said):
        wrong.append("no worker was lost")
    line = next((line for line in said if "denoised" in line), said[-1] if said else "")
    return f"killed after {before} files; exit {process.returncode}: {re.sub(r' with .* on [^;]*', '', line)}", wrong


def make_frames(folder: Path, count: int, width: int, height: int, made_up: bool) -> None:
    folder.mkdir()
    for number in range(1, count + 1):
        if made_up:
            frame = Frame(**inputs.features(height, width, seed=number))
        else:
            from mcdenoise_cl.render import render

            frame = render("room", spp=4, width=width, height=height, seed=number)
        write_exr(folder / f"shot.{number:04d}.exr", frame)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--size", nargs=2, type=int, default=(96, 54), metavar=("W", "H"))
    parser.add_argument("--method", default="guided")
    parser.add_argument("--only", nargs="+", metavar="CASE", help="Not all of the cases.")
    parser.add_argument("--made-up", action="store_true", help="no renderings")
    options = parser.parse_args()
    failed = False
    with tempfile.TemporaryDirectory() as temporary:
        source = Path(temporary, "in")
        make_frames(source, options.frames, *options.size, options.made_up or find_spec("mitsuba") is None)
        folder = Folder(source, options.method)
        print("| case | | as frame by frame |\n|:---|:---|:---|")
        for case in (plain, killed, interrupted, corrupt, missing, disk_full, farm):
            if options.only and case.__name__ not in options.only:
                continue
            work = Path(temporary, case.__name__)
            work.mkdir()
            what, wrong = case(folder, work)
            failed |= bool(wrong)
            verdict = (
                "; ".join(wrong[:3]) + (f" and {len(wrong) - 3} more" if len(wrong) > 3 else "") or "the same bits"
            )
            print(f"| {case.__name__.replace('_', ' ')} | {what} | {verdict} |", flush=True)
            shutil.rmtree(work, ignore_errors=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
