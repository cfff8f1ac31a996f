"""Showing: figures, and one self-contained HTML page a run. Nothing here computes physics.

- ``style``         palette, colour maps, panels, scales
- ``render``        a figure -> PNG, SVG, or both in one drawing
- ``figures``       figure functions: results and axes in, axes out
- ``run_folder``    the files of a run, opened; notes for what is missing
- ``mask_picture``  a written mask as a grey map and rectangles, in one pass over its tiles
- ``accounts``      loss chain, error budget, depth against truth, as rows
- ``draw``          which figures a run has; PNG files and SVG
- ``viewers``       data of the page's live views
- ``html``          tables, figures, sections as HTML
- ``sections``      the page's sections
- ``write``         run folder -> ``figures/*.png`` and ``report.html``
- ``library_page``  one library -> one picture
- ``proposal_page``  proposed helices -> one picture
- ``comparison_page``  a design beside other cameras -> one picture
- ``film``          a decoded film as a moving picture
- ``stokes_page``   a decoded full-Stokes frame -> one picture
- ``benchmark``     benchmark rows -> table, plots, JSON
- ``page.html``, ``style.css``, ``page.js``  the page's template, style and script

In: the files of a run folder, a Library, benchmark rows. Out: PNG, HTML, JSON.
"""

from metafab.report.film import require_film_name, write_film
from metafab.report.pages.benchmark import benchmark_page
from metafab.report.pages.comparison import comparison_figure
from metafab.report.pages.library import library_figure
from metafab.report.pages.proposal import proposal_figure
from metafab.report.pages.stokes import stokes_figure
from metafab.report.write import write

__all__ = [
    "benchmark_page",
    "comparison_figure",
    "library_figure",
    "proposal_figure",
    "require_film_name",
    "stokes_figure",
    "write",
    "write_film",
]
