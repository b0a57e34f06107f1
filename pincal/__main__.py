"""``python -m pincal`` is the ``pincal`` command."""

from pincal_command import main

main()
