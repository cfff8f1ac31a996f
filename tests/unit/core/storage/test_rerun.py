"""An answer is given again only while design, code, inputs and the run folder are as they were."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from metafab.core.storage.rerun import Rerun, all_older, code_mark, find_rerun, folder_marks, marks
from metafab.core.storage.tables import typed


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Run folder of a design with one input, and the answer in it."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lens.toml").write_text('name = "lens"\n')
    (tmp_path / "index.csv").write_text("800, 1.5\n")
    folder = Path("runs") / "lens"
    (folder / "figures").mkdir(parents=True)
    for name in ("mask.oas", "figures/phase.png", "summary.json"):
        (folder / name).write_text(name)
    inputs = marks([tmp_path / "lens.toml", tmp_path / "index.csv"])
    texts = ("lens", str(tmp_path / "lens.toml"), str(folder.resolve()), code_mark())
    answer = Rerun(*texts, inputs, folder_marks(folder), {"name": "lens"}, {"pillars": "9"}, (), 0)
    answer.keep(folder)
    return folder


def test_the_answer_and_its_summary_come_back(folder: Path) -> None:
    for output in (None, folder, folder.resolve()):
        (folder / "summary.json").unlink()
        found = find_rerun(Path("lens.toml"), output, code_mark())
        assert found is not None
        assert found[0].headlines == {"pillars": "9"}
        assert found[1] == (output or folder)
        assert json.loads((folder / "summary.json").read_text()) == {"name": "lens"}


def _touch(path: str) -> Callable[[Path], None]:
    return lambda place: os.utime(place / path, ns=(0, 1))


def _write(path: str, text: str) -> Callable[[Path], None]:
    def change(place: Path) -> None:
        (place / path).write_text(text)

    return change


def _replace(path: str, text: str) -> Callable[[Path], None]:
    """Another file of equal size and time takes the place, as from an archive."""

    def change(place: Path) -> None:
        other, time_ns = place / "other", (place / path).stat().st_mtime_ns
        other.write_text(text)
        os.utime(other, ns=(time_ns, time_ns))
        other.replace(place / path)

    return change


def _edit(key: str, value: object) -> Callable[[Path], None]:
    def change(place: Path) -> None:
        path = place / "runs" / "lens" / ".rerun.json"
        path.write_text(json.dumps(json.loads(path.read_text()) | {key: value}))

    return change


@pytest.mark.parametrize(
    "change",
    [
        _touch("lens.toml"),
        _touch("runs/lens/mask.oas"),
        _touch("runs/lens/figures/phase.png"),
        _write("index.csv", "800, 1.51\n"),
        _replace("index.csv", "800, 1.6\n"),
        _write("runs/lens/tolerance.json", "{}"),
        _write("runs/lens/.run.lock", "{}"),
        _write("runs/lens/.rerun.json", "{}"),
        _write("runs/lens/.rerun.json", "[1]"),
        _write("runs/lens/.rerun.json", '{"name": '),
        _write("runs/lens/.rerun.json", "[" * 200_000),
        _edit("headlines", []),
        _edit("headlines", {"pillars": "8"}),
        _edit("announcements", [1]),
        _edit("violations", "none"),
        lambda place: (place / "index.csv").unlink(),
        lambda place: (place / "runs" / "lens" / "mask.oas").unlink(),
        lambda place: (place / "lens.toml").rename(place / "other.toml"),
    ],
)
def test_any_change_leaves_the_answer_to_the_pipeline(folder: Path, change: Callable[[Path], None]) -> None:
    change(Path())
    design = next(Path().glob("*.toml"))
    for output in (None, folder):
        assert find_rerun(design, output, code_mark()) is None


def test_other_code_or_another_design_leaves_the_answer_to_the_pipeline(folder: Path) -> None:
    assert find_rerun(Path("lens.toml"), folder, "other code") is None
    assert find_rerun(Path("index.csv"), folder, code_mark()) is None
    assert find_rerun(Path("index.csv"), None, code_mark()) is None
    # A name within a table is another folder's, even if its answer is for this design.
    moved = folder.rename(folder.with_name("part"))
    assert find_rerun(Path("lens.toml"), moved, code_mark()) is None, "its files name others from where it stood"
    Path("lens.toml").write_text('[[phase]]\nname = "part"\n')
    table = json.loads(Path("runs/part/.rerun.json").read_text())
    table |= {"inputs": marks(table["inputs"]), "folder": str(moved.resolve())}
    typed(Rerun, table).keep(Path("runs/part"))
    assert find_rerun(Path("lens.toml"), Path("runs/part"), code_mark()) is not None
    assert find_rerun(Path("lens.toml"), None, code_mark()) is None


def test_a_file_renamed_or_written_during_a_run_is_not_older(folder: Path) -> None:
    now = time.time_ns()
    assert all_older(folder.glob("*"), now + 10**10)
    assert not all_older(folder.glob("*"), now + 10**9), "a clock of two seconds a tick"
    assert not all_older(folder.glob("*"), 0)
    os.utime(folder / "mask.oas", ns=(0, 0))
    began = time.time_ns() - 10**9
    (folder / "mask.oas").rename(folder / "other.oas")
    assert not all_older([folder / "other.oas"], began)


def test_a_summary_that_cannot_be_replaced_leaves_no_part(folder: Path) -> None:
    (folder / "summary.json").unlink()
    (folder / "summary.json").mkdir()
    assert find_rerun(Path("lens.toml"), None, code_mark()) is None
    assert list(folder.glob(".*.part")) == []


def test_a_folder_of_many_foreign_files_keeps_no_answer(folder: Path) -> None:
    for number in range(10_000):
        (folder / "figures" / str(number)).touch()
    with pytest.raises(OSError, match="more than 10000 files"):
        folder_marks(folder)


def test_code_that_cannot_be_read_has_no_mark(tmp_path: Path) -> None:
    (tmp_path / "module.py").touch()
    assert code_mark(tmp_path)
    (tmp_path / ".#module.py").symlink_to("somebody@somewhere")
    assert code_mark(tmp_path) == ""
