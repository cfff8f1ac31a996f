"""Hostile files through every reader: each must be read, or refused in words, within 5 s of processor time and 1 GB.

Files by name (``named_files.py``) go to a command in a process of its own: masks to ``drc``, frames to ``decode``,
designs to ``psf --ideal``. Drawn ones ("fuzzed") are many:
masks come from a grammar, other formats from mutations (``hostile_files.py``). Files are read in a forked process whose
memory and time per file are limited; a process that dies counts as a failure of the file that it was reading, and the
next one goes on behind it. A row holds the counts of one format; ``failures`` names the seeds.
"""

from __future__ import annotations

import math
import multiprocessing
import resource
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from benchmarks.mask.hostile_files import maker
from benchmarks.mask.named_files import NamedFile, named_files
from benchmarks.pipeline.commands import Finished, finished
from metafab import camera, decode, library, mask, optics
from metafab.core.errors import InputError
from metafab.core.storage.hdf5 import SEAL_BYTES
from metafab.core.storage.pictures import read_counts
from metafab.mask.read import read_shapes
from metafab.materials.record import read_table
from metafab.spec import Design, load_design, load_scene, load_unit_cell

Reader: TypeAlias = Callable[[Path], object]

REPOSITORY = Path(__file__).parents[2]
#: Parts of the benchmark.
PARTS = ("named", "fuzzed")
#: Share of the fuzzed files of each format.
FORMATS = {
    "oas": 0.34, "gds": 0.24, "many.oas": 0.01, "many.gds": 0.01, "toml": 0.12, "h5": 0.12, "tif": 0.08, "png": 0.03,
    "npy": 0.03, "csv": 0.02,
}  # fmt: skip
#: Limits of one file: processor time, s, and bytes besides what the process holds already.
LIMIT_S, LIMIT_BYTES = 5.0, 1 << 30
_FINE = ("read", "refused")
#: Arguments of a small PSF pair.
_ONE_DEPTH = ("--depths-m", "0.0028", "--window-px", "64")
#: Processor time, s, after which a process is ended.
_END_S = 20.0


@dataclass(frozen=True)
class Verdict:
    """Outcome of one file."""

    kind: str  #: Its format, one of :data:`FORMATS`.
    seed: int  #: Its seed.
    outcome: str  #: "read", "refused", or why it failed.
    seconds: float  #: Processor time; NaN if the process died.

    @property
    def failed(self) -> bool:
        """Whether the file was neither read nor refused within the limits."""
        return self.outcome not in _FINE


def rows(quick: bool, seed: int = 0, samples: int | None = None, only: Sequence[str] = PARTS) -> list[dict[str, Any]]:
    """A row of all fuzzed files, one for each of their formats, and one for each file by name."""
    for part in only:
        if part not in PARTS:
            raise InputError.single("benchmark", "--only", f"one of {', '.join(PARTS)}", repr(part))
    table = _fuzzed_rows(seed, samples or (80 if quick else 2000)) if "fuzzed" in only else []
    return [*table, *(_named_rows(quick=quick) if "named" in only else ())]


def _named_rows(*, quick: bool) -> Iterator[dict[str, Any]]:
    """A row of each file by name; every eighth of them if ``quick``."""
    design = (REPOSITORY / "layouts" / "helix_small.toml").read_text(encoding="utf-8")
    design = design.replace('"..', f'"{REPOSITORY.as_posix()}')
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        psf = folder / "psf.h5"
        done = finished(
            "psf",
            "--ideal",
            "--design",
            str(_written(folder / "whole.toml", design.encode())),
            *_ONE_DEPTH,
            "-o",
            str(psf),
        )
        if done.code:
            raise RuntimeError(f"the PSF pair of the frames failed: {done.stderr}")
        start_s = 0.0
        for file in named_files(design)[:: 8 if quick else 1]:
            path = _written(folder / f"hostile.{file.suffix}", file.make())
            arguments = ["drc", str(path), "--design", str(REPOSITORY / "layouts" / f"{file.design}.toml")]
            if file.suffix == "toml":
                arguments = ["psf", "--ideal", "--design", str(path), *_ONE_DEPTH]
            elif file.suffix not in ("oas", "gds"):
                arguments = ["decode", str(path), "--psf", str(psf)]
            done = finished(*arguments, "--json", most_s=60)
            start_s = start_s or done.processor_seconds  # of an empty mask: start of Python, imports, the design
            yield _named_row(file, path.stat().st_size, done, start_s)
            path.unlink()


def _named_row(file: NamedFile, size: int, done: Finished, start_s: float) -> dict[str, Any]:
    outcome = "read" if done.stdout.lstrip().startswith("{") and done.code in (0, 2) else "refused"
    faults = [] if done.code in (0, 2) else [f"exit {done.code}"]
    faults += ["a traceback"] if "Traceback" in done.stderr else []
    faults += ["read"] if outcome == "read" and file.must_be_refused else []
    faults += ["too slow"] if done.processor_seconds - start_s > LIMIT_S else []
    faults += ["too large"] if done.peak_rss_mb > LIMIT_BYTES / 1e6 else []
    lens = "" if file.design == "helix_small" else f", for {file.design}"
    return {
        "name": f"{file.suffix}: {file.name}{lens}",
        "series": "named files",
        "error": None,
        "seconds": done.processor_seconds,
        "peak_rss_mb": done.peak_rss_mb,
        "bytes": size,
        "outcome": outcome,
        "failed": len(faults),
        "failures": faults,
        "message": (done.stderr or done.stdout).strip()[-200:],
    }


def _fuzzed_rows(seed: int, wanted: int) -> list[dict[str, Any]]:
    """A row of all fuzzed files, and one for each format."""
    verdicts: list[Verdict] = []
    with tempfile.TemporaryDirectory() as folder:
        for kind, share in FORMATS.items():
            count = max(1, round(share * wanted))
            verdicts += examine(kind, range(seed * 1_000_000, seed * 1_000_000 + count), Path(folder))
    groups = {"all answers": verdicts} | {kind: [v for v in verdicts if v.kind == kind] for kind in FORMATS}
    return [_row(name, group) for name, group in groups.items()]


def examine(kind: str, seeds: range, folder: Path) -> Iterator[Verdict]:
    """Read the hostile files of a format one by one.

    Args:
        kind: one of :data:`FORMATS`.
        seeds: seeds of the files.
        folder: where files are written.
    """
    return judged(_readers()[kind], maker(kind, _whole_files(folder)), kind, seeds, folder)


def judged(
    readers: Sequence[Reader],
    make: Callable[[int], bytes],
    kind: str,
    seeds: range,
    folder: Path,
    *,
    limit_s: float = LIMIT_S,
) -> Iterator[Verdict]:
    """Read the files that ``make`` returns for ``seeds``, in forked processes of limited memory and time."""
    for read in readers:  # compiled and imported before memory is limited
        _outcome(read, _written(folder / f"first.{kind}", make(seeds.start)))
    context = multiprocessing.get_context("fork")
    while seeds:
        ours, theirs = context.Pipe(duplex=False)
        process = context.Process(target=_examine, args=(theirs, readers, make, kind, seeds, folder, limit_s))
        process.start()
        theirs.close()
        try:
            while seeds:
                yield ours.recv()
                seeds = seeds[1:]
        except EOFError:
            process.join()
            yield Verdict(kind, seeds[0], f"the process ended with {process.exitcode}", math.nan)
            seeds = seeds[1:]
        process.join()


def _examine(
    pipe: Connection,
    readers: Sequence[Reader],
    make: Callable[[int], bytes],
    kind: str,
    seeds: range,
    folder: Path,
    limit_s: float,
) -> None:
    # Memory that can be written to; addresses that threads only reserve take none.
    held = int(Path("/proc/self/statm").read_text().split()[5]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_DATA, (held + LIMIT_BYTES,) * 2)
    for seed in seeds:
        path = _written(folder / f"hostile.{kind}", make(seed))
        signal.setitimer(signal.ITIMER_PROF, _END_S)
        found, longest = [], 0.0
        for read in readers:
            start = time.process_time()
            found.append(_outcome(read, path))
            longest = max(longest, time.process_time() - start)
        # A file is read where one reader of its format reads it.
        outcome = next((each for each in found if each not in _FINE), min(found))
        if longest > limit_s and outcome in _FINE:
            outcome = f"{longest:.1f} s"
        pipe.send(Verdict(kind, seed, outcome, longest))
    pipe.close()


def _outcome(read: Callable[[Path], object], path: Path) -> str:
    try:
        read(path)
    except InputError:
        return "refused"
    except Exception as error:  # what an outsider would see as a traceback
        return f"{type(error).__name__}: {error}"[:200]
    return "read"


def _readers() -> Mapping[str, Sequence[Reader]]:
    """Readers by suffix."""
    design = load_design(REPOSITORY / "layouts" / "helix_small.toml")
    small = replace(design, device=replace(design.device, aperture_um=6.0))
    return {
        "gds": _mask_readers(small),
        "oas": _mask_readers(small),
        "many.gds": _mask_readers(design),
        "many.oas": _mask_readers(design),
        "toml": (load_design, load_unit_cell, load_scene),
        "h5": (library.load, optics.load, camera.load, decode.load),
        "csv": (lambda path: read_table(path, "table"),),
        **dict.fromkeys(("tif", "png", "npy"), (read_counts,)),
    }


def _mask_readers(design: Design) -> Sequence[Reader]:
    return (lambda path: mask.read(path, design), lambda path: _all_shapes(path, design))


def _all_shapes(path: Path, design: Design) -> None:
    for _ in read_shapes(path, design).chunks():
        pass


def _whole_files(folder: Path) -> dict[str, bytes]:
    """Whole files by suffix, as metafab writes them; HDF5 without the checksum, which would stop every mutation."""
    counts = np.random.default_rng(1).poisson(300.0, (24, 32)).astype(np.float64)
    design = (REPOSITORY / "layouts" / "helix_small.toml").read_text(encoding="utf-8")
    frame = camera.RawFrame(counts, 3.45, (-15.5 * 3.45, -11.5 * 3.45), 2.0)
    whole = {
        "toml": design.replace("..", REPOSITORY.as_posix()).encode(),
        "csv": b"# an index\nwavelength_nm,n,k\n600,2.41,0\n700,2.40,0.001\n1000,2.39,0\n",
    }
    for suffix in ("tif", "png", "npy"):
        camera.save_counts(frame, folder / f"whole.{suffix}")
        whole[suffix] = (folder / f"whole.{suffix}").read_bytes()
    camera.save(frame, folder / "whole.h5")
    whole["h5"] = (folder / "whole.h5").read_bytes()[:-SEAL_BYTES]
    return whole


def _written(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


def _row(name: str, verdicts: list[Verdict]) -> dict[str, Any]:
    counts = Counter("failed" if verdict.failed else verdict.outcome for verdict in verdicts)
    seconds = [verdict.seconds for verdict in verdicts]
    failures = [f"{v.kind} {v.seed}: {v.outcome}" for v in verdicts if v.failed]
    return {
        "name": name,
        "series": "metafab",
        "error": None,
        "seconds": float(np.nanmedian(seconds)),
        "peak_rss_mb": resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024 / 1e6,
        "samples": len(verdicts),
        "read": counts["read"],
        "refused": counts["refused"],
        "failed": counts["failed"],
        "slowest_s": float(np.nanmax(seconds)),
        "failures": failures[:20],
    }
