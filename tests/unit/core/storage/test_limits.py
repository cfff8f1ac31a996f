"""Limits of reading: what is stated outside has precedence, and each reader obeys."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from pathlib import Path
from threading import Barrier

import h5py
import numpy as np
import pytest

from metafab.core.errors import InputError
from metafab.core.storage.hdf5 import require_modest
from metafab.core.storage.limits import limit, limited
from metafab.core.storage.pictures import read_array
from metafab.library.foreign.table import read_sweep
from metafab.spec.toml import read_toml


def test_a_limit_stated_outside_has_precedence() -> None:
    assert limit("depth", 100) == 100
    with limited(depth=5, seconds=None):
        with limited(depth=7, seconds=2.0):
            assert (limit("depth", 100), limit("seconds", 1.0)) == (5, 2.0)
        assert (limit("depth", 100), limit("seconds", 1.0)) == (5, 1.0)
    assert limit("depth", 100) == 100


def test_limits_end_with_an_exception() -> None:
    with pytest.raises(ValueError, match="inside"), limited(shapes=3):
        raise ValueError("inside")
    assert limit("shapes", 1) == 1


def test_threads_do_not_mix_their_limits() -> None:
    """Each states its own while the others hold theirs; one without any has the default."""
    together = Barrier(3, timeout=10.0)

    def read_under(shapes: float | None) -> list[float]:
        with limited(shapes=shapes):
            together.wait()
            during = limit("shapes", 1.0)
            together.wait()
        together.wait()
        return [during, limit("shapes", 1.0)]

    with ThreadPoolExecutor(3) as threads, limited(shapes=9.0):
        assert list(threads.map(read_under, [5.0, 7.0, None])) == [[5.0, 1.0], [7.0, 1.0], [1.0, 1.0]]
        assert threads.submit(copy_context().run, limit, "shapes", 1.0).result() == 9.0
    assert limit("shapes", 1.0) == 1.0


def write_hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file.create_dataset("a", (400, 400), "f8", chunks=True, compression="gzip")


def write_npz(path: Path) -> None:
    np.savez_compressed(path, a=np.zeros((400, 400)))


def write_sweep(path: Path) -> None:
    np.savez_compressed(
        path, width_nm=np.arange(1e5), length_nm=np.arange(1e5), t=np.zeros(100_000, dtype=np.complex64)
    )


def read_modestly(path: Path) -> None:
    with h5py.File(path, "r") as file:
        require_modest(file, path)


@pytest.mark.parametrize(
    ("name", "write", "read"),
    [
        ("a.h5", write_hdf5, read_modestly),
        ("a.npz", write_npz, read_array),
        ("a.npy", lambda path: np.save(path, np.zeros((400, 400))), read_array),
        ("sweep.npz", write_sweep, read_sweep),
        ("a.toml", lambda path: path.write_text("a = 1\n# " + "x" * 1_100_000), read_toml),
    ],
)
def test_memory_is_refused_before_it_is_taken(name: str, write: object, read: object, tmp_path: Path) -> None:
    path = tmp_path / name
    assert callable(write) and callable(read)
    write(path)
    read(path)
    with limited(memory_mb=1.0), pytest.raises(InputError, match=r"--limit memory_mb=N"):
        read(path)


def test_a_design_cannot_raise_the_limit_of_its_own_file(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text("a = 1\n# " + "x" * 4_100_000)
    with pytest.raises(InputError, match=r"raise `--limit memory_mb=N`"):
        read_toml(path)
