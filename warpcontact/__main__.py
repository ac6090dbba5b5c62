"""Runs the command line as ``python -m warpcontact``."""

import sys

from warpcontact.cli import main

sys.exit(main())
