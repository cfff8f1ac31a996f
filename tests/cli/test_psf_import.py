"""``metafab psf import``: stacks of four formats become PSF files that ``metafab decode`` takes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import tifffile
from scipy.io import savemat

from metafab.camera import capture, save_counts
from metafab.cli.entry import spread_depths
from metafab.optics import Psf, load
from metafab.spec import Scene, SceneObject
from tests.closed_form_run import DEPTHS_M, turning_psf
from tests.conjugate_pair import PIXEL_UM, helix_psf
from tests.main_job import metafab

DEPTHS = [f"{depth:g}" for depth in DEPTHS_M]


@pytest.fixture
def files(tmp_path: Path) -> dict[str, Path]:
    """The turning pair in four formats, top row first, on a background of 100."""
    stack = 4000.0 * turning_psf().psf[..., ::-1, :] + 100.0
    paths = {kind: tmp_path / f"stack.{kind}" for kind in ("npy", "tif", "h5", "mat")}
    np.save(paths["npy"], stack)
    tifffile.imwrite(paths["tif"], stack, photometric="minisblack")
    with h5py.File(paths["h5"], "w") as file:
        file["measured"] = stack
    savemat(paths["mat"], {"measured": np.moveaxis(stack, (0, 1), (3, 2))})
    return paths


@pytest.mark.parametrize("kind", ["npy", "tif", "h5", "mat"])
def test_four_formats_give_one_pair(files: dict[str, Path], tmp_path: Path, kind: str) -> None:
    target = tmp_path / "psf.h5"
    answer = metafab(
        "psf", "import", files[kind], "--depths", *DEPTHS, "--pixel-um", "1", "--sampled", "--json", "-o", target
    )
    assert answer.code == 0, answer.stderr
    table, pair, truth = answer.json, load(target), turning_psf()
    assert (table["channels"], table["centring"], table["window_px"]) == (2, "turn", [33, 33])
    assert table["background"] == pytest.approx(100.0, abs=0.05)
    assert "made: split of the images" in answer.stderr
    np.testing.assert_allclose(pair.depth_m, DEPTHS_M)
    assert np.linalg.norm(pair.psf - truth.psf) < 0.01 * np.linalg.norm(truth.psf)


def test_a_camera_s_frame_is_decoded(tmp_path: Path) -> None:
    """Pictures of one image only, depths from a table; the frame is a TIFF of a camera."""
    lens: Psf = helix_psf(np.linspace(0.0025, 0.0034, 9))
    scene = Scene(objects=(SceneObject(depth_m=0.0029, size=(0.08, 0.08)),), field_px=(64, 64), seed=1)
    frame = replace(capture(scene, lens), saturation_e=None)
    save_counts(frame, tmp_path / "raw.tif", black=100)
    np.save(tmp_path / "stack.npy", lens.psf[0])
    np.savetxt(tmp_path / "depths.csv", lens.depth_m)
    split_um = lens.centre_um[1, 0] - lens.centre_um[0, 0]
    made = metafab(
        *("psf", "import", tmp_path / "stack.npy", "--depths", tmp_path / "depths.csv", "--pixel-um", f"{PIXEL_UM}"),
        *("--sampled", "--split-um", f"{split_um[0]:.6f}", f"{split_um[1]:.6f}", "--channels", "1"),
        *("--centre", "none", "--first-row", "bottom", "-o", tmp_path / "psf.h5"),
    )
    assert made.code == 0, made.stderr
    answer = metafab(
        *("decode", tmp_path / "raw.tif", "--psf", tmp_path / "psf.h5", "--black", "100", "--read-noise-e", "2"),
        *("--json", "-o", tmp_path / "decoded.h5"),
    )
    assert answer.code == 0, answer.stderr
    assert [row["depth_m"] for row in answer.json["segments"]] == pytest.approx([0.0029], rel=0.005)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--depths", *DEPTHS[::-1]], "stack.h5:\n  `--depths`: expected finite, increasing depths"),
        (["--depths", "none.csv"], "none.csv"),
        (["--depths", *DEPTHS, "--channels", "1"], "--channels"),
        (["--depths", *DEPTHS, "-o", "psf.txt"], "psf.txt"),
    ],
)
def test_bad_options_leave_no_file(files: dict[str, Path], tmp_path: Path, options: list[str], message: str) -> None:
    answer = metafab("psf", "import", files["h5"], "--pixel-um", "1", *options, cwd=tmp_path)
    assert (answer.code, answer.stdout) == (2, "")
    assert message in answer.stderr
    assert "Traceback" not in answer.stderr
    assert {path.name for path in tmp_path.iterdir()} == {path.name for path in files.values()}


def test_psf_without_import_still_takes_a_mask() -> None:
    answer = metafab("psf", "none.oas", "--design", "layouts/helix_small.toml")
    assert answer.code == 2
    assert "none.oas" in answer.stderr
    assert "Written mask" in metafab("psf", "--help").stdout
    assert "Pictures of a point" in metafab("psf", "import", "--help").stdout


def test_depths_are_numbers_or_a_file() -> None:
    assert spread_depths(["--depths", "-0.1", "0", "--json"]) == ["--depths=-0.1", "--depths=0", "--json"]
    assert spread_depths(["--depths", "table.csv", "0.3"]) == ["--depths", "table.csv", "0.3"]
    assert spread_depths(["--depths"]) == ["--depths"]
