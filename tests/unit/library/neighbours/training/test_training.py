"""Training on coarsely solved rows of three pillars: restart, held-out rows, files, evaluation."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab.cell import pillar_cell
from metafab.cell.elements import scattered_by_row
from metafab.cell.supercell import Supercell
from metafab.core.errors import InputError
from metafab.core.figures import LineStatistics
from metafab.library.library import Library, inputs_of
from metafab.library.neighbours import require_neighbours, rows, solve_supercell
from metafab.library.neighbours.blocks import training as blocks
from metafab.library.neighbours.doubt import RowDoubts, error_law
from metafab.library.neighbours.line import LineModel, LineShape
from metafab.library.neighbours.training import growth, held_out, row_sets, training
from metafab.library.neighbours.training.fit import FitLimits, RowSet, fit, loss
from metafab.library.store import load, save
from metafab.spec import UnitCell
from metafab.spec.cell import Neighbours as Training
from metafab.spec.toml import validate

SMALL_SHAPE = LineShape(2, 1, 1)


@pytest.fixture(scope="module")
def coarse() -> Iterator[None]:
    """Rows of three pillars and blocks of four by coarse elements, and a small chain: a training within seconds."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (rows, training, growth, held_out, row_sets):
            patch.setattr(module, "ROW_KINDS", (rows.RowKind(3),))
        for module in (rows, training, held_out):
            patch.setattr(module, "RESOLUTION", 1.0)
        patch.setattr(blocks, "BLOCK_KINDS", (((2, 2), True),))
        patch.setattr(growth, "SHAPES", (SMALL_SHAPE, SMALL_SHAPE))
        patch.setattr(growth, "STARTS", 1)
        # Fits far from their end have all the stages of finished ones.
        patch.setattr(growth, "_STAGE_STEPS", 6)
        patch.setattr(growth, "_LAST_STEPS", 12)
        yield


@pytest.fixture(scope="module")
def asked(smooth_library: Library) -> Library:
    """A library whose unit cell asks for a model of neighbours."""
    return replace(
        smooth_library, unit_cell=replace(smooth_library.unit_cell, neighbours=Training(60, more_modes=0, blocks=2))
    )


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Checkpoint of the training of ``trained``."""
    return tmp_path_factory.mktemp("training") / "rows"


@pytest.fixture(scope="module")
def trained(asked: Library, coarse: None, checkpoint: Path) -> Library:
    """The library with its model."""
    return replace(asked, neighbours=training.train(asked, checkpoint=checkpoint))


@pytest.fixture
def solved_rows(trained: Library, checkpoint: Path, tmp_path: Path) -> Path:
    """Checkpoint with the same rows and blocks solved, and no chain fitted."""
    for name in ("rows", "rows.blocks"):
        if (solved := checkpoint.with_name(name)).is_file():
            shutil.copy(solved, tmp_path / name)
    return tmp_path / "rows"


@pytest.mark.usefixtures("coarse")
def test_training_restarts_and_is_stored(asked: Library, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[int] = []

    def counted(*args: object) -> object:
        calls.append(1)
        if len(calls) == 50:
            raise KeyboardInterrupt
        return scattered_by_row(*args)  # type: ignore[arg-type]

    monkeypatch.setattr(rows, "scattered_by_row", counted)
    with pytest.raises(KeyboardInterrupt):
        training.train(asked, checkpoint=tmp_path / "rows")
    steps: list[str] = []
    model = training.train(asked, checkpoint=tmp_path / "rows", progress=lambda step, done, total: steps.append(step))
    # 2 chains x (60 rows and 5 chosen ones), one chunk of two rows lost by the stop, and the rows solved again at finer
    # truncation.
    assert 130 + 6 <= len(calls) - 1 <= 130 + 6 + 2
    fits = {"first fits of the chains", "last fits of the chains", "fit to all rows"}
    assert set(steps) == {"rows of unlike pillars", "blocks of unlike pillars", *fits}
    assert model.shares_directions
    statistics = model.along[0].statistics
    assert (statistics.rows, statistics.held_out) == (55, 10)
    assert statistics.error > 0.0
    assert statistics.solver_error > 0.0
    # Half of the held-out rows have steady phases.
    assert 0.0 < statistics.local_period_error_alike < np.sqrt(2.0) * statistics.local_period_error

    path = tmp_path / "library.h5"
    save(replace(asked, neighbours=model), path)
    again = require_neighbours(load(path))
    assert np.array_equal(again.across[1].model.vector, model.across[0].model.vector)
    coupling, stored = model.across[0].coupling, again.across[1].coupling
    assert coupling is not None and stored is not None and np.array_equal(stored, coupling)
    assert again.along[0].statistics == statistics
    assert again.inputs_sha256 == model.inputs_sha256
    assert "held-out rows" in load(path).key_figures()["neighbours"]


@pytest.mark.usefixtures("coarse")
def test_a_stopped_training_keeps_its_fits(
    asked: Library, solved_rows: Path, trained: Library, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    checkpoint = solved_rows
    begun: list[int] = []
    start, finish = growth.start_of, growth.finish_of

    def counted(task: object) -> LineModel:
        begun.append(1)
        return start(task)  # type: ignore[arg-type]

    def stopped(task: object) -> LineModel:
        if len(list(tmp_path.glob("*.fits"))) == 1 and not stops:
            stops.append(1)
            raise KeyboardInterrupt
        return finish(task)  # type: ignore[arg-type]

    stops: list[int] = []
    monkeypatch.setattr(growth, "start_of", counted)
    monkeypatch.setattr(growth, "finish_of", stopped)
    with pytest.raises(KeyboardInterrupt):
        training.train(asked, checkpoint=checkpoint)
    assert len(begun) == 2

    def none_left(*_: object) -> LineModel:
        raise AssertionError("a chain that was fitted is fitted again")

    def unfitted(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(growth, "start_of", none_left)
        patch.setattr(growth, "_refit", unfitted)
        with pytest.raises(KeyboardInterrupt):
            training.train(asked, checkpoint=checkpoint)
    monkeypatch.setattr(growth, "start_of", none_left)
    monkeypatch.setattr(growth, "finish_of", none_left)
    model = training.train(asked, checkpoint=checkpoint)
    assert trained.neighbours is not None
    for one, other in zip(model.lines, trained.neighbours.lines, strict=True):
        np.testing.assert_array_equal(one.model.vector, other.model.vector)


@pytest.mark.usefixtures("coarse")
def test_the_best_start_is_fitted_to_all_rows(
    asked: Library, solved_rows: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fits: list[tuple[LineModel, list[RowSet], FitLimits, LineModel]] = []

    def recorded(model: LineModel, sets: list[RowSet], limits: FitLimits) -> LineModel:
        fits.append((model, sets, limits, fit(model, sets, limits)))
        return fits[-1][-1]

    monkeypatch.setattr(growth, "STARTS", 2)
    monkeypatch.setattr(growth, "fit", recorded)
    lines = training.train(asked, checkpoint=solved_rows).lines
    # Three stages for each of two starts of two chains, the last fit of each chain, and that to all rows.
    assert len(fits) == 3 * 4 + 2 + 2
    for number, line in enumerate(lines):
        begun, sets, limits, end = fits[12 + number]
        starts = fits[6 * number : 6 * number + 3], fits[6 * number + 3 : 6 * number + 6]
        for start in starts:
            assert [sum(len(fitted.size_nm) for fitted in each[1]) for each in start] == [13, 25, 50]
            assert [(each[0].shape.even, each[0].shape.odd) for each in start] == [(1, 0), (1, 0), (2, 1)]
        first, second = (loss(start[-1][-1], sets, limits) for start in starts)
        assert first != second
        assert np.array_equal(begun.vector, starts[int(second < first)][-1][-1].vector)
        refitted = fits[14 + number]
        assert refitted[0] is end
        assert line.model is refitted[-1]
        assert sum(len(fitted.size_nm) for fitted in refitted[1]) == 55
        # The strongest order of each row with steady phases counts most.
        steady = [fitted for fitted in sets if np.ptp(fitted.weight) > fitted.weight.min()]
        assert sum(len(fitted.size_nm) for fitted in steady) == 25
        for fitted in steady:
            assert np.all(np.argmax(np.abs(fitted.amplitude[1]), axis=1) == np.argmax(fitted.weight))


@pytest.mark.usefixtures("coarse")
def test_more_modes_come_in_a_stage_of_their_own(trained: Library, asked: Library, solved_rows: Path) -> None:
    cell = replace(asked.unit_cell, neighbours=Training(60, more_modes=1, blocks=0))
    lines = training.train(replace(asked, unit_cell=cell), checkpoint=solved_rows).lines
    for line, fewer in zip(lines, require_neighbours(trained).lines, strict=True):
        assert line.model.shape == LineShape(3, 2, 1)
        assert line.statistics.error_fitted < fewer.statistics.error_fitted


@pytest.mark.usefixtures("coarse")
def test_rows_are_chosen_by_their_gain(trained: Library) -> None:
    """Numbers beyond the solved rows: those of random sizes whose field moves most with errors of the matrices."""
    sampler, model = training.row_samplers(trained)[0], require_neighbours(trained).along[0].model
    chosen = growth.Plan(sampler, dict.fromkeys(range(60), ()), [], [], 0).unsure(model)
    random = [number for number in range(60, 300) if number % 2 == 0]
    size_nm = np.stack([sampler.pillars(number) for number in random])
    t = sampler.t[[np.flatnonzero(np.all(sampler.size_nm == each, axis=1))[0] for each in size_nm.reshape(-1, 2)], 0]
    gain = RowDoubts.of(model, size_nm, t.reshape(-1, 3), np.zeros((len(random), 3))).gain
    assert len(chosen) == 5
    assert set(chosen) == {random[k] for k in np.argsort(gain)[-5:]}


@pytest.mark.usefixtures("coarse")
def test_workers_fit_the_same_chains(trained: Library, asked: Library, solved_rows: Path) -> None:
    with ThreadPoolExecutor(2) as executor:
        model = training.train(asked, executor=executor, checkpoint=solved_rows)
    for line, serial in zip(model.lines, require_neighbours(trained).lines, strict=True):
        assert np.array_equal(line.model.vector, serial.model.vector)
        assert line.statistics == serial.statistics


def test_few_held_out_rows_state_enough() -> None:
    """Errors scatter log-normally, by 0.5, about powers of the predictors; half of the rows have a tenth of the bend.

    The median ratio is exp(0.5 t sqrt(1 + 5/n)), t the quantile 1e-3 of Student's distribution: 36 and 5.
    """
    rng = np.random.default_rng(3)
    for held, most in ((10, 45.0), (160, 6.0)):
        shape = (200, held + 100)
        values = np.exp(
            rng.uniform(
                [[[-4.0]], [[-2.0]], [[-1.0]], [[1.0]], [[0.0]]],
                [[[0.0]], [[0.0]], [[1.0]], [[3.0]], [[3.0]]],
                (5, *shape),
            )
        )
        values[2, :, ::2] *= 0.1
        errors = 0.03 * values[0] ** 0.3 * values[2] ** 0.5 * values[3] ** 0.4 * np.exp(0.5 * rng.normal(size=shape))
        ratios = []
        for one, error in zip(values.swapaxes(0, 1), errors, strict=True):
            law = error_law(RowDoubts(*one[:, :held]), error[:held])
            stated = RowDoubts(*one[:, held:]).stated_errors(law)
            ratios.append(stated / error[held:])
        assert np.mean(np.less(ratios, 1.0)) < 3e-3
        assert np.median(ratios) < most


def test_a_stated_error_needs_three_rows_of_unlike_pillars() -> None:
    doubts, errors = RowDoubts(*np.full((5, 4), 0.1)), np.array([0.01, 0.02, 0.03, 0.0])
    doubts.correction[-1] = 1e-16  # equal pillars, to rounding
    law = error_law(doubts, errors)
    assert errors[:3].max() < doubts.stated_errors(law)[0] < np.inf
    with pytest.raises(ValueError, match="three held-out rows of unlike pillars or more, got 2"):
        error_law(RowDoubts(*np.full((5, 2), 0.1)), errors[:2])


def test_older_files_state_a_power_of_correction_times_step() -> None:
    doubts = RowDoubts(*np.array([[0.1], [0.5], [7.0], [7.0], [7.0]]))
    stated = doubts.stated_errors(LineStatistics(error_floor=0.01, error_slope=2.0, error_power=0.5))
    assert stated == pytest.approx(0.01 + 2.0 * 0.05**0.5)


def test_supercells_by_the_model(trained: Library) -> None:
    library = trained
    cell = pillar_cell(library.unit_cell, 0.0, 0.0)
    equal = solve_supercell(library, Supercell(cell, np.full((1, 4, 2), 150.0)))
    zero = np.all(equal.order == 0, axis=1)
    known = library.at_sizes(150.0, 150.0)
    passive = min(1.0, abs(complex(1.7601)) ** 0.5 / abs(complex(known.t_xx)))
    assert np.abs(equal.t[~zero]).max() < 1e-12
    assert abs(equal.t[zero][0, 0, 0] - passive * complex(known.t_xx)) < 1e-12

    sizes = 100.0 + 2.0 * np.random.default_rng(1).integers(0, 76, (2, 3, 2))
    for shape in ((1, 3), (2, 1), (2, 3)):
        block = Supercell(cell, sizes[: shape[0], : shape[1]])
        answer = solve_supercell(library, block)
        turned = solve_supercell(library, block.exchanged())
        assert answer.t.shape == (len(block.propagating_orders("x")), 2, 2)
        assert answer.error > 0.0
        for axis, light in enumerate(("x", "y")):
            power = block.relative_power(answer.order, answer.t[:, :, axis], light)
            assert power.sum() <= 1.0 + 1e-12
        # The cell is the same with x and y exchanged, and so are the chains, but for the library's t in closed form.
        match = [int(np.flatnonzero(np.all(turned.order == order[::-1], axis=1))[0]) for order in answer.order]
        assert np.abs(turned.t[match][:, ::-1, ::-1] - answer.t).max() < 1e-9


def test_sizes_outside_and_libraries_without_a_model_are_refused(asked: Library, smooth_library: Library) -> None:
    cell = pillar_cell(asked.unit_cell, 0.0, 0.0)
    with pytest.raises(InputError, match="table `\\[neighbours\\]`"):
        solve_supercell(smooth_library, Supercell(cell, np.full((1, 2, 2), 150.0)))


def test_pillars_outside_the_sweep_are_refused(trained: Library) -> None:
    cell = pillar_cell(trained.unit_cell, 0.0, 0.0)
    for size in (0.0, 98.0, 252.0):
        with pytest.raises(InputError, match="sizes of the model"):
            solve_supercell(trained, Supercell(cell, np.full((1, 2, 2), size)))


@pytest.mark.parametrize(
    ("table", "change"),
    [
        ("hexagonal", {"cell": {"lattice": "hexagonal"}}),
        ("ellipse", {"cell": {"shape": "ellipse"}}),
        ("corner", {"cell": {"corner_radius_nm": 10.0}}),
        ("wall", {"cell": {"sidewall_angle_deg": 88.0}}),
        ("meep", {"solver": {"name": "meep"}}),
    ],
)
def test_cells_without_training_rows_are_refused(table: str, change: dict[str, dict[str, object]]) -> None:
    content: dict[str, dict[str, object]] = {
        "cell": {"period_nm": 350.0, "height_nm": 600.0},
        "materials": {"pillar": {"n": 3.6941}, "substrate": {"n": 1.76}},
        "illumination": {"wavelength_nm": 800.0},
        "sweep": {"width_nm": [100.0, 250.0], "length_nm": [100.0, 250.0], "size_grid_nm": 2.0},
        "neighbours": {"rows": 100},
    }
    assert validate(UnitCell, content, "cell.toml").neighbours == Training(100)
    for name, values in change.items():
        content[name] = content.get(name, {}) | values
    with pytest.raises(InputError, match="the model of neighbours needs"):
        validate(UnitCell, content, "cell.toml")


def test_the_table_does_not_change_the_library_itself(unit_cell: UnitCell) -> None:
    asked = replace(unit_cell, neighbours=Training(rows=100))
    assert inputs_of(asked) == inputs_of(unit_cell)
    assert training.inputs_of_training(asked) != training.inputs_of_training(replace(unit_cell, neighbours=Training()))
