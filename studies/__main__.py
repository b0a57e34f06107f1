"""``python -m studies 5R -o FOLDER``: the same as ``pincal study 5R -o FOLDER``."""

import sys

from pincal_command import main

sys.argv[:1] = ["pincal", "study"]
main()
