"""``python -m metafab`` is ``metafab``."""

from metafab.cli import main

main()
