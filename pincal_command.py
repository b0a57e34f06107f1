"""Where the ``pincal`` command begins: Ctrl-C ends it silently while the package is loaded.

Beside the package, not in it: to find a module in the package, Python loads the package first.
"""

import signal


def main() -> None:
    """Load the package, in which there is nothing to clean up yet, and run the command line."""
    own = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if own:  # and not ignored, as in the background
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from pincal.cli import main as run

    if own:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    run()
