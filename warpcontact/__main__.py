"""Runs the command line as ``python -m warpcontact``."""

import sys

from warpcontact.cli.main import main

sys.exit(main())
