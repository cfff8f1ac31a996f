"""Budget of memory and time for reading one mask file, spent before anything is expanded."""

from __future__ import annotations

from pathlib import Path

from metafab.core.storage.limits import beyond, limit

#: Sites of a design that is not known, or has no lattice: a lens of 1.4 mm.
UNKNOWN_SITES = 1 << 24
#: Default of the limit ``memory_mb``, bytes, for a block or a list.
_BYTES = 256e6
#: Default of the limit ``seconds``: for any file, or for each byte of it, whichever is more.
_SECONDS, _SECONDS_OF_A_BYTE = 2.5, 2.5e-7
#: Added to that default for each site of the design.
_SECONDS_OF_A_SITE = 1e-7
#: Added for each tile of the design, a cell of its file: rules of rectangles read it three times, in 3.4e-4 s.
_SECONDS_OF_A_TILE = 5e-4
#: Estimated processor time, s, of a byte of a block or a list, and of a shape at its place.
_SECONDS_TO_INFLATE, _SECONDS_OF_A_PLACE = 1.5e-9, 1e-7


class Budget:
    """Bytes of inflated blocks and of lists, and processor time by records, which all passes over a file share.

    ``sites`` and ``tiles`` are the numbers of the design's. A block or list is given back before the next, unless the
    file is ``held`` as a whole.
    """

    def __init__(self, path: Path, sites: int = UNKNOWN_SITES, *, tiles: int = 0, held: bool = False) -> None:
        self._source = str(path)
        self._held = held
        self._most_mb = limit("memory_mb", 1e-6 * _BYTES)
        default_s = max(_SECONDS, _SECONDS_OF_A_BYTE * path.stat().st_size) + _SECONDS_OF_A_SITE * sites
        default_s += _SECONDS_OF_A_TILE * tiles
        self._most_s = limit("seconds", default_s)
        self._mb = self._seconds = 0.0

    def inflate(self, size: int) -> None:
        """Spend bytes that a block or a list expands to; InputError for more than the limits of memory or time."""
        self._mb = 1e-6 * size + (self._mb if self._held else 0.0)
        if self._mb > self._most_mb:
            expected = f"blocks and lists of at most {self._most_mb:.0f} MB"
            raise beyond(self._source, "file", "memory_mb", expected, "more")
        self.work(_SECONDS_TO_INFLATE * size)

    def place(self, shapes: int) -> None:
        """Spend the time to put shapes at their places; InputError for more than the limit ``seconds``."""
        self.work(_SECONDS_OF_A_PLACE * shapes)

    def work(self, seconds: float) -> None:
        """Spend processor time, an estimate for what is read next; InputError for more than the limit ``seconds``."""
        self._seconds += seconds
        if self._seconds > self._most_s:
            expected = f"records that take about {self._most_s:.3g} s at most"
            raise beyond(self._source, "file", "seconds", expected, "more", "is it another design's?")
