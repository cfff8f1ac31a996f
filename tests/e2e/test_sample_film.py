"""The film that the documentation makes: most of a frame is what the last one showed, and its depths are right."""

from __future__ import annotations

from metafab.spec import load_scene
from metafab.steps.images import FilmFigures, decoded_film
from tests.conftest import MainJob
from tests.main_job import ROOT


def test_most_of_the_sample_film_is_kept_from_frame_to_frame(main_job: MainJob) -> None:
    scene = load_scene(ROOT / "layouts" / "scenes" / "moving_disc.toml")
    film = list(decoded_film(scene, main_job.folder / "psf.h5", None))
    figures = FilmFigures.of(film)
    assert len(film) == scene.frames
    # The first frame and two second looks are whole; else the disc and what its blur reaches.
    assert sum(share < 0.5 for share in figures.changed_share) >= scene.frames - 3
    assert max(figures.worst_object_error) < 0.005
    # What stands still keeps its depth to the bit; the disc is measured anew.
    last, before = figures.objects[-1], figures.objects[-2]
    assert (last[1], last[3]) == (before[1], before[3])
    assert last[2] != before[2]
