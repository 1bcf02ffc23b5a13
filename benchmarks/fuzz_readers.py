"""Coverage-guided fuzzing of every reader: `python benchmarks/fuzz_readers.py [SECONDS] [READER ...]`.

libFuzzer by way of atheris (`pip install atheris`) changes files so that they reach new lines of
rtcal. It keeps those that do in `.fuzz/READER`, from where the next run goes on, and the smallest of
them in `tests/fuzz_corpus`. It starts from those, and from the files of `tests/fuzz.py` and
`tests/corpus.toml`. A reader passes if every file is read or refused as `fuzz.check` asks, within 10 s
and 1 GB. Prints per reader the files tried and kept, the places of rtcal's code that were reached,
the processor time in s and the memory in MB. Ends with 1 if a reader fell, beside the file that did it.
SECONDS, 60 if not said, are those of each reader, by the clock. As many readers run at a time as there
are processors (``--jobs``).

atheris 3.0.0 never frees the result of a comparison that it has instrumented. With arrays that is
12 kB per response. So a reader's process is replaced after `FILES_PER_PROCESS` files.
"""

from __future__ import annotations

import argparse
import itertools
import os
import re
import resource
import sys
import tempfile
import time
import traceback
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
FOLDER = ROOT / ".fuzz"
MAX_BYTES = 20_000
FILES_PER_PROCESS = 40_000
"""Files after which a process is replaced: 0.5 GB of comparisons' results."""

MAX_KEPT_BYTES = 60_000
"""Size of all the files of a reader that are kept in the repository."""
KERNELS = [
    "rtcal.calibration.exact_kernel",
    "rtcal.finder.positions.density_kernel",
    "rtcal.simulators.kernels",
    "rtcal.studies.trials_kernel",
]
"""Modules that numba compiles: it does not know what atheris writes into them."""


@dataclass
class Progress:
    """The work of a reader's processes so far; `end` is the time at which the last one ends."""

    end: float
    tried: int = 0
    seconds: float = 0.0
    megabytes: float = 0.0

    def add(self, tried: int, used: resource.struct_rusage) -> None:
        self.tried += tried
        self.seconds += used.ru_utime + used.ru_stime
        self.megabytes = max(self.megabytes, used.ru_maxrss / 1024)


def fuzz_one(name: str, seconds: int) -> None:
    """Fuzz a reader in this process, which libFuzzer ends."""
    import atheris

    from tests import fuzz

    kept = FOLDER / name
    folder = Path(tempfile.mkdtemp(prefix="rtcal-fuzz-"))
    for number, content in enumerate(seeds(name)):
        (kept / f"seed-{number}").write_bytes(content)
    tokens = folder / "tokens"
    tokens.write_text("".join(f'"{escaped(t)}"\n' for t in fuzz.TOKENS if 0 < len(t) < 60))

    def check(content: bytes) -> None:
        fuzz.check(name, content, folder)

    options = [
        f"-max_total_time={seconds}",
        f"-runs={FILES_PER_PROCESS}",
        f"-max_len={MAX_BYTES}",
        f"-dict={tokens}",
        f"-artifact_prefix={FOLDER}/{name}-",
        "-timeout=100",  # by the clock; `fuzz.check` counts 10 s of processor time
        "-rss_limit_mb=1024",
        "-print_final_stats=1",
    ]
    atheris.Setup([sys.argv[0], str(kept), *options], check)
    atheris.Fuzz()


def seeds(name: str) -> list[bytes]:
    """Good and odd files of a reader."""
    from tests import corpus, fuzz

    odd = [case.content for case in corpus.CASES if case.reader == name]
    every = (*fuzz.READERS[name].seeds, *odd, *fuzz.kept(name))
    return [content for content in every if len(content) <= MAX_BYTES]


def smallest(name: str) -> list[bytes]:
    """The smallest of the files that reached new lines."""
    contents = sorted((file.read_bytes() for file in (FOLDER / name).iterdir()), key=len)
    sizes = itertools.accumulate(map(len, contents))
    return [c for c, size in zip(contents, sizes, strict=True) if size <= MAX_KEPT_BYTES]


def escaped(token: bytes) -> str:
    """A token as libFuzzer's dictionaries have it."""
    return "".join(f"\\x{byte:02x}" for byte in token)


def warm(name: str) -> None:
    """Read the reader's good files: what reading imports is then imported once, here."""
    from tests import fuzz

    with tempfile.TemporaryDirectory() as folder:
        for content in fuzz.READERS[name].seeds:
            fuzz.check(name, content, Path(folder))


def forked(name: str, seconds: int) -> int:
    """Fuzz a reader in a child, which has all modules already; return its process number."""
    (FOLDER / name).mkdir(parents=True, exist_ok=True)
    said_in(name).unlink(missing_ok=True)
    child = os.fork()
    if child == 0:
        for stream in (sys.stdout, sys.stderr):  # a traceback goes to the one, figures to the other
            os.dup2(os.open(said_in(name), os.O_WRONLY | os.O_CREAT | os.O_APPEND), stream.fileno())
        try:
            fuzz_one(name, seconds)
        except Exception:
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            os._exit(1)
    return child


def said_in(name: str) -> Path:
    """The file with what a reader's fuzzing printed."""
    return FOLDER / f"{name}.log"


def tried_by(name: str) -> int:
    """Number of files that a reader's last process tried."""
    tried = re.search(r"number_of_executed_units: (\d+)", said_in(name).read_text(errors="replace"))
    return int(tried[1]) if tried else 0


def report(name: str, passed: bool, progress: Progress) -> None:
    """Print a reader's figures, and what it said if it fell."""
    from tests import fuzz

    said = said_in(name).read_text(errors="replace")
    lines = re.findall(r"cov: (\d+)", said)
    fuzz.keep(name, smallest(name))
    kept = len(list((FOLDER / name).iterdir()))
    print(
        f"{name:16} {progress.tried:9} {kept:6} {lines[-1] if lines else '-':>6} "
        f"{progress.seconds:7.0f} {progress.megabytes:5.0f}",
        flush=True,
    )
    if not passed:
        print("\n".join(said.splitlines()[-30:]), flush=True)


def main(seconds: int, names: list[str], jobs: int) -> int:
    import atheris

    with atheris.instrument_imports(include=["rtcal"], exclude=KERNELS):
        from tests import fuzz

    print(f"{'reader':16} {'tried':>9} {'kept':>6} {'lines':>6} {'s':>7} {'MB':>5}", flush=True)
    waiting = names or sorted(fuzz.READERS)
    for name in waiting:
        warm(name)
    fell = 0
    running: dict[int, str] = {}
    progress: dict[str, Progress] = {}
    while waiting or running:
        while waiting and len(running) < jobs:
            name, *waiting = waiting
            progress[name] = Progress(end=time.monotonic() + seconds)
            running[forked(name, seconds)] = name
        child, status, used = os.wait4(-1, 0)
        name = running.pop(child)
        progress[name].add(tried_by(name), used)
        left = int(progress[name].end - time.monotonic())
        passed = os.waitstatus_to_exitcode(status) == 0
        if passed and left > 0:
            running[forked(name, left)] = name
        else:
            fell += not passed
            report(name, passed, progress[name])
    return min(fell, 1)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("seconds", type=int, nargs="?", default=60)
    parser.add_argument("readers", nargs="*")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="readers at a time")
    chosen = parser.parse_args()
    sys.exit(main(chosen.seconds, chosen.readers, chosen.jobs))
