"""The command line, one file per command."""

from warpcontact.cli.commands import main

__all__ = ["main"]
