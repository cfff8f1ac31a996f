"""Faults from outside on a small run: what each leaves behind, and whether the next run ends as an undisturbed one.

The job is a camera of 30 um with a library of 36 sizes, every step of ``metafab run``. It runs once undisturbed. Then,
with the counts in one row for each kind of fault:

- *kills*: ``kill -9`` at random times, of a run and of a library build in turn; processes that outlive their parent by
  2 s, results that differ from the undisturbed ones, and bytes of the run that goes on from there
- *killed workers*: a worker of a library build; bytes of the library
- *cluster*: the scheduler of a Dask cluster killed and ended, and its only worker killed and replaced; time until the
  build says so, and bytes of the library that goes on from there
- *second run*: a run in the folder of another; it names the owner and touches nothing
- *other place*: the project copied to a deeper folder, and run there
- *damaged files*: every file of the run folder, in one to six ways; the run after it, and ``metafab report``
- *full disk*: file systems in memory of 64 kB to 2 MB; then the run on one that is large enough
- *read-only folder*: a file system that cannot be written

A case is failed where a traceback, a wrong exit code, half a file, another byte or a living process was found; the
row names it. File systems need Linux and the right to mount; without, these rows say so.
"""

from __future__ import annotations

import json
import os
import random
import resource
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from benchmarks.pipeline.commands import REPOSITORY, command, dask_scheduler, dask_worker
from metafab.core.errors import InputError
from metafab.spec import write_new

#: Kinds of faults.
KINDS = (
    "kills",
    "killed workers",
    "cluster",
    "second run",
    "other place",
    "damaged files",
    "full disk",
    "read-only folder",
)
#: Files that hold times or owners, and so differ between any two runs.
TIMED = {"summary.json", ".rerun.json", ".run.lock"}
#: Time, s, by which no process may outlive its parent.
OUTLIVED_S = 2.0
#: Times, s, by which a build ends whose scheduler went away, and by which one says that all workers went.
SCHEDULER_S, WORKERS_S = 10.0, 40.0
#: Changes of the camera of ``metafab new`` that make a run take seconds.
_SMALLER = (
    ("aperture_um = 200.0", "aperture_um = 30.0"),
    ("focal_length_mm = 1.0", "focal_length_mm = 0.15"),
    ("field_px = [160, 128]", "field_px = [24, 16]"),
    ("pixel_um = 2.4", "pixel_um = 1.5"),
    ("[0.0025, 0.0028, 0.0031, 0.0034]", "[0.0028]\nwindow_px = 24\ntarget_error = 1e-2"),
)
#: The same of the unit cell: sizes in steps of 30 nm.
_COARSER = (("size_grid_nm = 2.0", "size_grid_nm = 30.0"), ("target_error = 2e-3", "target_error = 1e-2"))


@dataclass(frozen=True)
class Case:
    """One fault."""

    name: str  #: Fault and place.
    seconds: float  #: Time of the command that met it.
    faults: tuple[str, ...]  #: What was wrong; empty where all was as it should be.


@dataclass(frozen=True)
class Project:
    """The small camera."""

    folder: Path  #: Its folder, which holds design, unit cell and run.

    @property
    def design(self) -> Path:
        """The design file."""
        return self.folder / "camera.toml"

    @property
    def run(self) -> Path:
        """The run folder."""
        return self.folder / "run"

    def arguments(self, folder: Path | None = None, workers: int = 2) -> list[str]:
        """Arguments of the run, by default in the project's own folder."""
        return ["run", str(self.design), "-o", str(folder or self.run), "--workers", str(workers)]

    def moved(self, folder: Path) -> Project:
        """A copy of the project without its run."""
        shutil.copytree(self.folder, folder, ignore=shutil.ignore_patterns("run", "*.h5", ".*"))
        return Project(folder)


def rows(quick: bool, seed: int = 0, samples: int | None = None, only: Sequence[str] = ()) -> list[dict[str, Any]]:
    """A row of all faults, and one for each kind, or for those of ``only``; ``samples`` is the number of kills."""
    for kind in only:
        if kind not in KINDS:
            raise InputError.single("benchmark", "--only", f"one of {', '.join(KINDS)}", repr(kind))
    kills = samples or (4 if quick else 40)
    with tempfile.TemporaryDirectory() as folder:
        project, whole_s = _project(Path(folder) / "project")
        results = _results(project.folder)
        cases_of = (
            _killed(project, results, whole_s, kills, random.Random(seed)),
            _killed_workers(project, results["cell.h5"], 1 if quick else 5),
            _cluster(),
            _second_runs(project, 1 if quick else 5),
            _other_place(project, results),
            _damaged(project, results, quick=quick),
            _full_disk(project, results),
            _read_only(project),
        )
        groups = {kind: list(cases) for kind, cases in zip(KINDS, cases_of, strict=True) if kind in (only or KINDS)}
    cases = [case for group in groups.values() for case in group]
    return [_row("all answers", cases), *(_row(name, group) for name, group in groups.items())]


def _project(folder: Path) -> tuple[Project, float]:
    """The project, run once undisturbed, and the seconds of that run."""
    folder.mkdir(parents=True)
    cell = (REPOSITORY / "unitcell_lib" / "sos_800nm.toml").read_text(encoding="utf-8")
    (folder / "cell.toml").write_text(_changed(cell, _COARSER), encoding="utf-8")
    path = write_new("camera", "camera", folder, folder / "cell.toml")[0]
    path.write_text(_changed(path.read_text(encoding="utf-8"), _SMALLER), encoding="utf-8")
    project = Project(folder)
    return project, _undisturbed(*project.arguments())


def _undisturbed(*arguments: str) -> float:
    """Seconds of a command without a fault."""
    start, done = time.perf_counter(), _metafab(*arguments)
    if done.returncode:
        raise RuntimeError(f"`metafab {' '.join(arguments)}` failed without a fault: {done.stderr}")
    return time.perf_counter() - start


def _changed(text: str, changes: Sequence[tuple[str, str]]) -> str:
    for old, new in changes:
        if old not in text:
            raise RuntimeError(f"{old!r} is no longer in the file that the benchmark changes")
        text = text.replace(old, new)
    return text


def _killed(
    project: Project, results: dict[str, bytes], whole_s: float, kills: int, rng: random.Random
) -> Iterator[Case]:
    """Kill a run and a library build in turn; every fourth time, let both end and begin anew.

    A command that ended before its kill is no case, unless it failed.
    """
    with tempfile.TemporaryDirectory() as folder:
        moved, built = project.moved(Path(folder) / "another" / "place"), Path(folder) / "library.h5"
        build = ["library", "build", str(project.folder / "cell.toml"), "-o", str(built), "--workers", "2"]
        build_s = _undisturbed(*build)
        built.unlink()
        for number in range(kills):
            name, arguments, takes_s = (
                ("run", moved.arguments(), whole_s) if number % 2 == 0 else ("library build", build, build_s)
            )
            moment_s, start = rng.uniform(0.1, 0.9) * takes_s, time.perf_counter()
            process = _started(*arguments)
            with suppress(subprocess.TimeoutExpired):
                process.wait(moment_s)
            process.kill()
            process.wait()
            faults = [f"process {pid} outlived its parent" for pid in _left_over(process.pid)]
            is_killed = process.returncode == -signal.SIGKILL
            faults += [] if is_killed else _ended(_finished(process), 0)
            faults += _differences(moved.folder, results, unfinished=True)
            if number % 4 == 3 or number == kills - 1:
                faults += _ended(_metafab(*moved.arguments()), 0) + _differences(moved.folder, results)
                faults += _ended(_metafab(*build), 0)
                faults += [] if built.read_bytes() == results["cell.h5"] else ["another library"]
                shutil.rmtree(moved.run)
                (moved.folder / "cell.h5").unlink()
                built.unlink()
            if is_killed or faults:
                yield Case(f"{name} after {moment_s:.2f} s", time.perf_counter() - start, tuple(faults))


def _killed_workers(project: Project, expected: bytes, count: int) -> Iterator[Case]:
    """Kill a worker of a library build soon after it has begun."""
    with tempfile.TemporaryDirectory() as folder:
        for number in range(count):
            out, start = Path(folder) / f"library_{number}.h5", time.perf_counter()
            cell = str(project.folder / "cell.toml")
            process = _started("library", "build", cell, "-o", str(out), "--workers", "2")
            victims: list[int] = []
            while not victims and process.poll() is None:
                victims = [pid for pid in processes_of(process.pid) if pid != process.pid]
                time.sleep(0.01)
            time.sleep(0.05 * number)
            for pid in victims[:1]:
                _kill(pid)
            faults = [] if victims else ["no worker was found"]
            faults += _ended(_finished(process), 0)
            if out.is_file() and out.read_bytes() != expected:
                faults.append("another library")
            yield Case(f"worker {number}", time.perf_counter() - start, tuple(faults))


def _cluster() -> Iterator[Case]:
    """Take scheduler or worker from a library build on a Dask cluster of one worker; then let the build end."""
    if find_spec("distributed") is None:
        return
    with tempfile.TemporaryDirectory() as name:
        folder, cell = Path(name), str(REPOSITORY / "unitcell_lib" / "sos_800nm.toml")
        whole = folder / "whole.h5"
        _undisturbed("library", "build", cell, "-o", str(whole))
        for number, (victim, how) in enumerate((("scheduler", "KILL"), ("scheduler", "TERM"), ("worker", "KILL"))):
            out, at = folder / f"{number}.h5", folder / f"{number}.json"
            build = ["library", "build", cell, "-o", str(out)]
            with dask_scheduler(at) as (scheduler, address), dask_worker(at) as worker:
                process = _started(*build, "--cluster", address)
                while process.poll() is None and not list(folder.glob(f"{out.stem}.*.partial")):
                    time.sleep(0.1)
                start = time.perf_counter()
                os.kill((scheduler if victim == "scheduler" else worker).process.pid, getattr(signal, f"SIG{how}"))
                if victim == "scheduler":
                    done = _finished(process)
                    seconds, faults = time.perf_counter() - start, _ended(done, 1)
                    faults += [] if seconds < SCHEDULER_S else [f"exit after {seconds:.0f} s"]
                    faults += _ended(_metafab(*build), 0)
                else:
                    assert process.stderr is not None
                    said = next((line for line in process.stderr if "has had no worker" in line), "")
                    seconds = time.perf_counter() - start
                    faults = [] if said and seconds < WORKERS_S else [f"after {seconds:.0f} s: {said.strip()}"]
                    with dask_worker(at):
                        faults += _ended(_finished(process), 0)
            faults += [] if out.is_file() and out.read_bytes() == whole.read_bytes() else ["another library"]
            yield Case(f"{victim} of the cluster, SIG{how}", seconds, tuple(faults))


def _second_runs(project: Project, count: int) -> Iterator[Case]:
    """Run twice in one folder at once."""
    with tempfile.TemporaryDirectory() as folder:
        for number in range(count):
            run, start = Path(folder) / str(number), time.perf_counter()
            first = _started(*project.arguments(run))
            while not (run / ".run.lock").is_file() and first.poll() is None:
                time.sleep(0.01)
            second = _metafab(*project.arguments(run))
            faults = _ended(second, 2)
            if f"process {first.pid} on host" not in second.stderr:
                faults.append(f"the owner is not named: {second.stderr.strip()[-200:]}")
            faults += _ended(_finished(first), 0)
            yield Case(f"run beside process {first.pid}", time.perf_counter() - start, tuple(faults))


def _other_place(project: Project, results: dict[str, bytes]) -> Iterator[Case]:
    """Run the copied project in two folders of unlike depth, at another time."""
    for depth in (1, 5):
        with tempfile.TemporaryDirectory() as folder:
            moved, start = project.moved(Path(folder, *"abcde"[:depth]) / "project"), time.perf_counter()
            faults = _ended(_metafab(*moved.arguments(workers=1)), 0) + _differences(moved.folder, results)
            yield Case(f"{depth} folders deep", time.perf_counter() - start, tuple(faults))


def _damaged(project: Project, results: dict[str, bytes], *, quick: bool) -> Iterator[Case]:
    """Damage every file of the run, one at a time, and run again; then ``metafab report`` on a damaged summary."""
    names = sorted(path.relative_to(project.folder).as_posix() for path in project.run.rglob("*") if path.is_file())
    for name in names if not quick else [f"{project.run.name}/steps.json"]:
        path = project.folder / name
        for kind, content in _damages(path).items():
            path.write_bytes(content)
            start, faults = time.perf_counter(), list[str]()
            if path.name == "summary.json":
                shown = _metafab("report", str(project.run))
                faults += _ended(shown, 2 if shown.returncode else 0)
            faults += _ended(_metafab(*project.arguments(workers=1)), 0) + _differences(project.folder, results)
            yield Case(f"{name}, {kind}", time.perf_counter() - start, tuple(faults))


def _damages(path: Path) -> dict[str, bytes]:
    """Damaged contents of a file by the kind of damage: six of a JSON file, two of another, one of a picture."""
    whole = path.read_bytes()
    middle = len(whole) // 2
    if path.suffix == ".png":
        return {"cut": whole[:middle]}
    damages = {"cut": whole[:middle], "one bit": whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1 :]}
    if path.suffix != ".json":
        return damages
    numbers = json.dumps(dict.fromkeys(json.loads(whole), -1)).encode()
    return damages | {"empty": b"", "list": b"[1, {}]", "deep": b"[" * 200_000, "numbers": numbers}


def _full_disk(project: Project, results: dict[str, bytes]) -> Iterator[Case]:
    """Run on disks that are too small, then on one that is large enough, in what the first has left."""
    for room_kb in (64, 256, 512, 1024, 2048):
        with _disk(f"size={room_kb}k") as folder:
            if folder is None:
                return
            moved, start = project.moved(folder / "project"), time.perf_counter()
            done = _metafab(*moved.arguments(workers=1))
            faults = _ended(done, 1) if done.returncode else _differences(moved.folder, results)
            if done.returncode:
                if "No space left" not in done.stderr:
                    faults.append(f"the reason is not named: {done.stderr.strip()[-200:]}")
                faults += _differences(moved.folder, results, unfinished=True)
                subprocess.run(["mount", "-o", "remount,size=64m", str(folder)], check=True)
                faults += _ended(_metafab(*moved.arguments(workers=1)), 0) + _differences(moved.folder, results)
            yield Case(f"{room_kb} kB", time.perf_counter() - start, tuple(faults))


def _read_only(project: Project) -> Iterator[Case]:
    """Run in a new folder of a disk that is read-only, and in a finished run's folder there."""
    with _disk("size=64m") as folder:
        if folder is None:
            return
        moved = project.moved(folder / "project")
        shutil.copytree(project.folder, folder / "finished")
        subprocess.run(["mount", "-o", "remount,ro", str(folder)], check=True)
        for each in (moved, Project(folder / "finished")):
            start, done = time.perf_counter(), _metafab(*each.arguments(workers=1))
            faults = _ended(done, 1)
            if "Read-only file system" not in done.stderr:
                faults.append(f"the reason is not named: {done.stderr.strip()[-200:]}")
            yield Case(each.folder.name, time.perf_counter() - start, tuple(faults))


@contextmanager
def _disk(options: str) -> Iterator[Path | None]:
    """A file system in memory; None where none can be mounted."""
    with tempfile.TemporaryDirectory() as folder:
        mount = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", folder]
        if shutil.which("mount") is None or subprocess.run(mount, capture_output=True, check=False).returncode:
            yield None
            return
        try:
            yield Path(folder)
        finally:
            subprocess.run(["umount", folder], check=True)


def _metafab(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a command to its end."""
    return subprocess.run(**command(*arguments), capture_output=True, check=False, timeout=600.0)


def _started(*arguments: str) -> subprocess.Popen[str]:
    """Start a command in a session of its own, so that all its processes can be found."""
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "start_new_session": True}
    return subprocess.Popen(**command(*arguments), **quiet)


def _finished(process: subprocess.Popen[str]) -> subprocess.CompletedProcess[str]:
    """A started command at its end."""
    _, stderr = process.communicate()
    return subprocess.CompletedProcess([], process.returncode, "", stderr)


def _ended(done: subprocess.CompletedProcess[str], code: int) -> list[str]:
    """Faults of a command that was to end with an exit code, and one message where that is no 0."""
    faults = [] if done.returncode == code else [f"exit {done.returncode}: {done.stderr.strip()[-200:]}"]
    if "Traceback" in done.stderr:
        faults.append(f"a traceback: {done.stderr.strip()[-200:]}")
    return faults


def _results(folder: Path) -> dict[str, bytes]:
    """Bytes of every file that tells no time, by its path in the project."""
    paths = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*") if path.is_file()}
    return {name: path.read_bytes() for name, path in sorted(paths.items()) if path.name not in TIMED}


def _differences(folder: Path, expected: dict[str, bytes], *, unfinished: bool = False) -> list[str]:
    """Files that differ from those of the undisturbed run.

    An unfinished run may lack files and have parts, a checkpoint and its owner, and fewer records.
    """
    found = _results(folder)
    if unfinished:
        known = [name for name in found if name in expected and not name.endswith("steps.json")]
        return [f"{name} differs" for name in known if found[name] != expected[name]]
    changed = [f"{name} differs" for name in expected.keys() & found.keys() if expected[name] != found[name]]
    return sorted(changed + [f"{name} in one of them only" for name in expected.keys() ^ found.keys()])


def processes_of(session: int) -> list[int]:
    """Processes of a session that are no zombies."""
    alive = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            state, _, _, of_session = (folder / "stat").read_text().rpartition(")")[2].split()[:4]
        except OSError:
            continue
        if int(of_session) == session and state != "Z":
            alive.append(int(folder.name))
    return alive


def _left_over(session: int) -> list[int]:
    """Processes of a session that live on after the time that they may, which are ended."""
    end = time.monotonic() + OUTLIVED_S
    while (left := processes_of(session)) and time.monotonic() < end:
        time.sleep(0.02)
    for pid in left:
        _kill(pid)
    return left


def _kill(pid: int) -> None:
    with suppress(ProcessLookupError):  # it has just ended
        os.kill(pid, signal.SIGKILL)


def _row(name: str, cases: Sequence[Case]) -> dict[str, Any]:
    failures = [f"{case.name}: {'; '.join(case.faults)}" for case in cases if case.faults]
    return {
        "name": name if cases else f"{name} (not run: no file system could be mounted, or no `distributed`)",
        "series": "metafab",
        "error": None,
        "seconds": max((case.seconds for case in cases), default=None),
        "peak_rss_mb": resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024 / 1e6,
        "samples": len(cases),
        "failed": len(failures),
        "failures": failures[:20],
    }
