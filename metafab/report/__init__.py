"""Figures, and one self-contained HTML page for each run. No physics is computed here.

- ``run_folder``    files of a run, opened; notes for missing files
- ``accounts``      loss chain, depth against truth
- ``style``         palette, colour maps, panels, scales
- ``figures``       figure functions: results and axes in, axes out
- ``render``        a figure as PNG, or as PNG and SVG in one drawing
- ``draw``          all figures of a run
- ``viewers``       data of the live views of the page
- ``html``          tables, figures, sections as HTML
- ``sections``      sections of the page
- ``assets``        template, style and script of the page
- ``write``         figures and page of a run folder
- ``pages``         pages, pictures and films of single results
- ``cards``         small pictures of results for notebooks

In: the files of a run folder, or a single result. Out: PNG, HTML, JSON, GIF, MP4.
"""

from metafab.report.pages.benchmark import benchmark_page
from metafab.report.pages.film import require_film_name, write_film
from metafab.report.pages.pictures import comparison_figure, library_figure, proposal_figure, stokes_figure
from metafab.report.write import write

__all__ = [
    "write",
    "library_figure",
    "proposal_figure",
    "comparison_figure",
    "stokes_figure",
    "write_film",
    "require_film_name",
    "benchmark_page",
]  # most useful first
