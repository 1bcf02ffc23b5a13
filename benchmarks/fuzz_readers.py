"""Coverage-guided fuzzing of every reader: `python benchmarks/fuzz_readers.py [SECONDS] [READER...]`.

libFuzzer by way of atheris (`pip install atheris`) changes files so that they reach new lines of
rtcal. It keeps those that do in `.fuzz/READER`, from where the next run goes on, and the smallest of
them in `tests/fuzz_corpus`. It starts from those, and from the files of `tests/fuzz.py` and
`tests/corpus.py`. A reader passes if every file is read or refused as `fuzz.check` asks, within 10 s
and 1 GB. Prints the files tried and kept; ends with 1 if a reader fell, beside the file that did it.
SECONDS, 60 if not said, are those of each reader.
"""

from __future__ import annotations

import itertools
import os
import re
import sys
import tempfile
import traceback
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
FOLDER = ROOT / ".fuzz"
MAX_BYTES = 20_000
MAX_KEPT_BYTES = 60_000
"""Size of all the files of a reader that are kept in the repository."""
KERNELS = [
    "rtcal.exact.kernel",
    "rtcal.simulators.image_numba",
    "rtcal.simulators.path_numba",
    "rtcal.simulators.sdn_numba",
    "rtcal.studies.trials_kernel",
]
"""Modules that numba compiles: it does not know what atheris writes into them."""


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
        f"-max_len={MAX_BYTES}",
        f"-dict={tokens}",
        f"-artifact_prefix={FOLDER}/{name}-",
        "-timeout=10",
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


def forked(name: str, seconds: int) -> tuple[bool, str]:
    """Fuzz a reader in a child, which has all modules already; whether it passed, and what it said."""
    from tests import fuzz

    said = FOLDER / f"{name}.log"
    said.unlink(missing_ok=True)
    with tempfile.TemporaryDirectory() as folder:  # what reading imports is imported here
        for content in fuzz.READERS[name].seeds:
            fuzz.check(name, content, Path(folder))
    child = os.fork()
    if child == 0:
        for stream in (sys.stdout, sys.stderr):  # a traceback goes to the one, figures to the other
            os.dup2(os.open(said, os.O_WRONLY | os.O_CREAT | os.O_APPEND), stream.fileno())
        try:
            fuzz_one(name, seconds)
        except Exception:
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            os._exit(1)
    passed = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    return passed, said.read_text(errors="replace")


def main(seconds: int, names: list[str]) -> int:
    import atheris

    with atheris.instrument_imports(include=["rtcal"], exclude=KERNELS):
        from tests import fuzz

    fell = 0
    print(f"{'reader':16} {'tried':>9} {'kept':>6}", flush=True)
    for name in names or sorted(fuzz.READERS):
        (FOLDER / name).mkdir(parents=True, exist_ok=True)
        passed, said = forked(name, seconds)
        tried = re.search(r"number_of_executed_units: (\d+)", said)
        fuzz.keep(name, smallest(name))
        kept = len(list((FOLDER / name).iterdir()))
        print(f"{name:16} {tried[1] if tried else '-':>9} {kept:6}", flush=True)
        if not passed:
            fell += 1
            print("\n".join(said.splitlines()[-30:]), flush=True)
    return min(fell, 1)


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else 60, sys.argv[2:]))
