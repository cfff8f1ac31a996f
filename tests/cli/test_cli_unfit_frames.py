"""``metafab decode`` of frames that no camera takes: refused with 2, and what lay under the output's name stays."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from metafab import decode, optics
from metafab.core.errors import InputError
from metafab.steps import restore
from tests.conjugate_pair import helix_psf
from tests.main_job import metafab

SHAPE = (176, 350)


@pytest.fixture(scope="module")
def psf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("unfit") / "psf.h5"
    optics.save(helix_psf(np.linspace(0.0025, 0.0034, 7), window_px=32), path)
    return path


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.ones((8, 8)), "does not hold both images"),
        (np.full(SHAPE, np.nan), "no finite number"),
        (np.full(SHAPE, -5.0), "at most -5"),
        (np.full(SHAPE, 1e308), "up to 1e\\+15"),
    ],
    ids=["small", "nan", "negative", "huge"],
)
def test_an_unfit_frame_replaces_nothing(tmp_path: Path, psf: Path, values: np.ndarray, message: str) -> None:
    raw, output = tmp_path / "raw.npy", tmp_path / "decoded.h5"
    np.save(raw, values)
    output.write_bytes(b"an older result")
    with pytest.raises(InputError, match=f"`frame`: .*{message}"):
        restore(raw, psf, output)
    assert output.read_bytes() == b"an older result"
    # A run goes on: its report says why there is no image.
    assert "reason" in restore(raw, psf, output, unfit="empty").details
    assert not np.isfinite(decode.load(output).depth_m).any()


def test_the_command_exits_with_2_for_an_unfit_frame_and_says_that_one_is_dark(tmp_path: Path, psf: Path) -> None:
    raw, output = tmp_path / "raw.npy", tmp_path / "decoded.h5"
    np.save(raw, np.full(SHAPE, np.nan))
    answer = metafab("decode", raw, "--psf", psf, "-o", output, "--json")
    assert (answer.code, answer.stdout, output.exists()) == (2, "", False)
    np.save(raw, np.zeros(SHAPE))
    answer = metafab("decode", raw, "--psf", psf, "-o", output, "--json")
    assert answer.code == 0, answer.stderr
    assert f"metafab: {raw}: {decode.NO_LIGHT}" in answer.stderr
    assert answer.json["reason"] == decode.NO_LIGHT
    assert not np.isfinite(decode.load(output).depth_m).any()
