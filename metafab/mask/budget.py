"""What reading one mask file may take, spent before anything is expanded."""

from __future__ import annotations

from pathlib import Path

from metafab.core.storage.limits import beyond, limit

#: Default of the limit ``memory_mb``, bytes: for a file without sites, and for each site. A pillar takes up to 76
#: bytes, in one or two passes.
_BYTES, _BYTES_OF_A_SITE = 1 << 30, 1024
#: Default of the limit ``seconds``: for any file, for each byte of it, and for each site. A file by other software may
#: hold a polygon of its own for each pillar.
_SECONDS, _SECONDS_OF_A_BYTE, _SECONDS_OF_A_SITE = 4.0, 4e-7, 1e-4


class Budget:
    """Bytes of inflated blocks and of lists, and processor time by records, which all passes over a file share.

    ``sites`` are the design's.
    """

    def __init__(self, path: Path, sites: int) -> None:
        self._source = str(path)
        self._most_mb = limit("memory_mb", 1e-6 * (_BYTES + _BYTES_OF_A_SITE * sites))
        default_s = max(_SECONDS, _SECONDS_OF_A_BYTE * path.stat().st_size, _SECONDS_OF_A_SITE * sites)
        self._most_s = limit("seconds", default_s)
        self._mb = self._seconds = 0.0

    def inflate(self, size: int) -> None:
        """Spend bytes that a block or a list expands to; InputError for more than the limit ``memory_mb``."""
        self._mb += 1e-6 * size
        if self._mb > self._most_mb:
            expected = f"blocks and lists of at most {self._most_mb:.0f} MB"
            raise beyond(self._source, "file", "memory_mb", expected, "more")

    def work(self, seconds: float) -> None:
        """Spend processor time, an estimate for what is read next; InputError for more than the limit ``seconds``."""
        self._seconds += seconds
        if self._seconds > self._most_s:
            expected = f"records that take about {self._most_s:.3g} s at most"
            raise beyond(self._source, "file", "seconds", expected, "more", "is it another design's?")
