"""Where the ``pincal`` command begins: Ctrl-C ends it silently while the package is loaded.

Beside the package, not in it: to find a module in the package, Python loads the package first.
"""

import signal

CATCHES_CTRL_C = signal.getsignal(signal.SIGINT) is signal.default_int_handler
if CATCHES_CTRL_C:  # and does not ignore it, as in the background
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def main() -> None:
    """Load the package, in which there is nothing to clean up yet, and run the command line."""
    from pincal.cli import main as run

    if CATCHES_CTRL_C:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    run()
