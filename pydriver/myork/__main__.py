"""``python -m myork`` is the command ``myork``."""

import sys

from myork.cli import main

if __name__ == "__main__":
    sys.exit(main())
