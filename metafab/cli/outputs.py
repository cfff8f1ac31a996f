"""Where results go: the options ``-o``, and checks before the work that a result can stand there."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

from metafab.core.errors import InputError


def require_file_output(path: Path, read: Iterable[Path] = ()) -> None:
    """Refuse the name of a folder for a result that is one file, and what :func:`require_output` refuses."""
    require_output(path, read)
    _require_no_folder(path)


def require_folder_output(path: Path, read: Iterable[Path] = ()) -> None:
    """Refuse the name of a file for a result that is a folder, and what :func:`require_output` refuses."""
    require_output(path, read)
    if path.exists() and not path.is_dir():
        raise InputError.single("--output", "output", "a folder, old or new", f"the file {path}", "name another")


def require_output(path: Path, read: Iterable[Path] = ()) -> None:
    """Refuse the place of a result before the work: InputError for one of the files ``read``, or a closed place.

    A file without a name is made in the nearest folder that exists: rights alone do not show what root cannot write.
    """
    from tempfile import TemporaryFile  # a command without a result does not need it

    try:
        is_read = path.is_file() and any(each.is_file() and each.samefile(path) for each in read)
        folder = path if path.is_dir() else next(each for each in path.absolute().parents if each.exists())
        with TemporaryFile(dir=folder):
            pass
    except OSError as error:
        expected, got = "a place that can be written", f"{path} ({error.strerror})"
        raise InputError.single("--output", "output", expected, got, "name another") from error
    if is_read:
        expected, got = "a file of its own", f"{path}, which is read"
        raise InputError.single("--output", "output", expected, got, "name another")


def require_hdf5_name(path: Path | None) -> Path | None:
    """Return the name of a result in HDF5, or None for no result; InputError for neither .h5 nor .hdf5."""
    if path is None:
        return None
    from metafab.core.storage.files import HDF5_SUFFIXES

    _require_no_folder(path)
    if path.suffix.lower() not in HDF5_SUFFIXES:
        raise InputError.single(str(path), "output", "a name ending with .h5", repr(path.suffix))
    return path


def _require_no_folder(path: Path) -> None:
    if path.is_dir():
        raise InputError.single("--output", "output", "the name of a file", f"the folder {path}", "name a file in it")


#: What may stand at the place of ``--output``, by its metavar.
CHECKS = {"FILE": require_file_output, "DIR": require_folder_output, "PATH": require_output}

_FILE = typer.Option("-o", "--output", metavar="FILE", help="File of the result.")
_HDF5 = typer.Option("-o", "--output", metavar="FILE", help="File of the result.", callback=require_hdf5_name)
Output = Annotated[Path | None, _FILE]
Hdf5Output = Annotated[Path | None, _HDF5]
#: Likewise, of a command that always writes the file and names it itself by default.
NamedOutput = Annotated[Path, _FILE]
NamedHdf5Output = Annotated[Path, _HDF5]
OutputFolder = Annotated[Path | None, typer.Option("-o", "--output", metavar="DIR", help="Folder of the files.")]
