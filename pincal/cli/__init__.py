"""What people type: the ``pincal`` command."""

from pincal.cli.main import main

__all__ = ["main"]
