"""``python -m pincal`` is the ``pincal`` command."""

from pincal.cli import main

main()
