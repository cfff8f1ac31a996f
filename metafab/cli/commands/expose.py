"""Commands ``expose`` and ``process fit``: electron exposure of a written mask, and the process from its sizes."""

from __future__ import annotations

import csv
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from metafab.cli.app import Copy, DesignOption, Json, LayoutFile, Workers, app, faults_of_options
from metafab.cli.console import announce, open_work, show
from metafab.cli.outputs import NamedOutput, require_file_output, require_folder_output
from metafab.core.errors import InputError

if TYPE_CHECKING:
    from metafab.exposure import BeamPsf, SampledPillar
    from metafab.spec import Design
    from metafab.steps.exposure import ExposedMask


@app.command("expose")
def expose_command(
    layout: LayoutFile,
    design: DesignOption,
    correct: Annotated[
        bool, typer.Option("--correct", help="Correct doses (or shapes) for proximity effects.")
    ] = False,
    sample: Annotated[
        int, typer.Option("--sample", min=0, max=1_000_000, metavar="N", help="Number of random pillars to list.")
    ] = 0,
    sample_csv: Annotated[
        Path | None, typer.Option("--sample-csv", metavar="OUT.csv", help="Table of the listed pillars.")
    ] = None,
    dose_datatypes: Annotated[
        bool,
        typer.Option("--dose-datatypes", help="Also write doses.gds, whose datatypes are 1000 times the dose (Raith)."),
    ] = False,
    copy: Copy = 1,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", metavar="PATH", help="Folder of the corrected mask, or .json file of the size errors."
        ),
    ] = None,
    workers: Workers = None,
    json_: Json = False,
) -> None:
    """Predict printed sizes from the electron exposure of a mask, and correct its doses.

    With --correct and -o DIR, the corrected mask is written to DIR: one datatype per dose class with the tables
    doses.csv, doses.jdi and doses.txt, or corrected shapes. If DIR holds the mask itself, or a run, it is written to
    DIR/corrected. With -o DIR/exposure.json in a run folder, the next report shows the size errors;
    with --correct, before and after the correction.
    """
    from metafab.spec import load_design
    from metafab.steps.exposure import expose_mask, save_exposure, write_corrected

    if (sample > 0) != (sample_csv is not None):
        expected = "`--sample N` together with `--sample-csv OUT.csv`"
        raise InputError.single("--sample", "sample", expected, "one of them")
    record, folder = _record_or_folder(output, layout, design, correct=correct)
    spec = load_design(design)
    process = None if spec.process is None else spec.process.exposure
    by_dose = folder is not None and process is not None and process.correction == "dose"
    if dose_datatypes and not (by_dose and "gds" in spec.mask.formats):
        expected = '`--correct -o DIR`, a correction of doses, and "gds" in `mask.formats`'
        raise InputError.single("--dose-datatypes", "option", expected, "another command or design")
    files: tuple[Path, ...] = ()
    with open_work(workers) as (work, cost):
        exposed = expose_mask(
            layout, spec, work, correct=correct, samples=sample, copy=copy, keep_plain=record is not None
        )
        if folder is not None:
            files = write_corrected(exposed, spec, folder, work.progress, dose_datatypes=dose_datatypes)
        if record is not None:
            save_exposure(exposed, layout, spec, record)
            files = (record,)
    result = exposed.exposure
    if sample_csv is not None:
        _write_samples(result.samples, sample_csv)
    asked_classes = "auto" if process is None else process.classes
    if result.figures.rounds and asked_classes != "auto" and 1 < result.figures.classes < asked_classes:
        announce([f"{result.figures.classes} of {asked_classes} classes: doses of `mask.copies` need datatypes too"])
    show(
        result.figures,
        json_,
        beside=[asdict(one) for one in exposed.beside],
        psf=_described(exposed.psf),
        seconds=cost.seconds,
        peak_rss_mb=cost.peak_rss_mb,
        **({"files": {path.name: path.stat().st_size for path in files}} if files else {}),
        **({} if folder is None else {"folder": str(folder)}),
        **_of_copies(exposed, spec),
    )


def _record_or_folder(
    output: Path | None, layout: Path, design: Path, *, correct: bool
) -> tuple[Path | None, Path | None]:
    """File of the size errors, or folder of the corrected mask; one of them or both are None."""
    from metafab.steps.exposure import corrected_folder

    if output is None:
        return None, None
    if output.suffix.lower() == ".json":
        require_file_output(output, [layout, design])
        return output, None
    if not correct:
        expected = "a name ending with .json, or `--correct` with a folder"
        raise InputError.single("--output", "output", expected, f"{output} without a correction", "add `--correct`")
    require_folder_output(output)
    folder = corrected_folder(output, layout)
    if folder != output:
        announce([f"{output} keeps its mask: the corrected one goes to {folder}"])
    return None, folder


def _of_copies(exposed: ExposedMask, design: Design) -> dict[str, Any]:
    """Figures of the lenses of ``mask.copies``; empty for a single lens."""
    from metafab.steps.exposure import copy_figures, errors_of_copies_nm

    if not (copies := copy_figures(exposed, design)):
        return {}
    rms_nm, max_nm = errors_of_copies_nm(copies)
    return {"copies": [asdict(one) for one in copies], "copies_rms_nm": rms_nm, "copies_max_nm": max_nm}


def _described(psf: BeamPsf) -> dict[str, object]:
    """Every parameter of the point-spread function, and the sum that gives the listed energies."""
    gaussians = [
        {"kind": "gauss", "weight": float(weight), "range_nm": float(beta)}
        for weight, beta in zip(psf.weight, psf.range_nm, strict=True)
    ]
    return {
        "source": psf.source,
        "form": "sum over terms of weight / (pi range_nm^2) exp(-r^2 / range_nm^2)",
        "energy": "base_over_clearing_dose times the sum, over all pillars and all shapes counted in `beside`, of dose "
        "times the integral of the form over the drawn shape; copies have their doses, layers of `beside` 1; at "
        "edges the mean over the middles of two opposite edges",
        "given": [asdict(term) for term in psf.terms],
        "blur_nm": psf.blur_nm,
        "fit_error": psf.fit_error,
        "fit_ratio": psf.fit_ratio,
        "terms": gaussians,
    }


def _write_samples(samples: tuple[SampledPillar, ...], path: Path) -> None:
    """Write one row for each sampled pillar, under the names of its figures."""
    from metafab.core.storage.files import whole_file
    from metafab.exposure import SampledPillar

    with whole_file(path) as part, part.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow([item.name for item in fields(SampledPillar)])
        writer.writerows(asdict(pillar).values() for pillar in samples)


@app.command("process fit")
def process_fit_command(
    measured: Annotated[
        Path,
        typer.Argument(
            metavar="CD.csv", help="Measured sizes: x_um, y_um, width_nm, length_nm [copy, dose, focus_um]."
        ),
    ],
    layout: LayoutFile,
    design: DesignOption,
    free: Annotated[
        list[str] | None,
        typer.Option(
            "--free",
            metavar="NAME",
            help="threshold, eta, bias, blur, microloading, convergence or focus [default: the first three].",
        ),
    ] = None,
    copy: Copy = 1,
    output: NamedOutput = Path("process.toml"),
    workers: Workers = None,
    json_: Json = False,
) -> None:
    """Fit dose to clear, backscatter and bias to measured sizes, and write a process file for later designs.

    The table lists pillars by place, from the axis of their lens, at one or several doses and focuses; a design uses
    the written file by `process = "process.toml"`. Columns height_nm, sidewall_angle_deg and corner_radius_nm become
    those of the etch, and of a unit cell beside the file.
    """
    from metafab.exposure.process_file import fitted_process, process_files, save_process
    from metafab.exposure.size_model import PARAMETERS
    from metafab.spec import load_design

    names = free or ["threshold", "eta", "bias"]
    if unknown := sorted(set(names) - set(PARAMETERS)):
        raise InputError.single("--free", "free", f"some of {', '.join(PARAMETERS)}", ", ".join(unknown))
    spec = load_design(design)
    with open_work(workers) as (work, cost), faults_of_options({"free": "--free"}):
        chosen = [name for name in PARAMETERS if name in names]
        fitted = fitted_process(measured, layout, spec, chosen, copy, work)
    read = [file for file in (measured, layout, design, spec.library) if file.is_file()]
    for file in process_files(output, fitted):
        if file.is_file() and any(file.samefile(each) for each in read):
            raise InputError.single("--output", "output", "files of its own", f"{file}, which is read", "name another")
    files = save_process(fitted, output)
    announce(f"hardly counts: {size}" for size in fitted.fit.far)
    if fitted.fit.largest_correlation > 0.99:
        one, other = fitted.fit.correlated
        announce([f"{one} and {other} are hardly told apart (correlation {fitted.fit.largest_correlation:.3f})"])
    show(fitted.fit, json_, files=[str(file) for file in files], seconds=cost.seconds, peak_rss_mb=cost.peak_rss_mb)
