"""``python -m metafab.cli`` is ``metafab``."""

from metafab.cli import main

main()
