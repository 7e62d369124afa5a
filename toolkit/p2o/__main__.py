"""`python -m p2o` is the command `p2o`."""

import sys

from p2o.cli import main

if __name__ == "__main__":
    sys.exit(main())
