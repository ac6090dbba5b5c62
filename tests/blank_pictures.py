"""Replaces the pictures of runs, which take longer than small runs, in tests that do not check them."""

import base64
import sys
from types import SimpleNamespace

# One white pixel.
PNG = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAAAAAA6fptVAAAACklEQVR4nGP4DwABAQEAGwWWrgAAAABJRU5ErkJggg=="
)
MODULE = "warpcontact.experiment.picture"
FUNCTIONS = ("write_picture", "write_outcome_picture")


def write_blank(path, *_):
    """Writes one pixel, as the function that it replaces writes a picture."""
    from warpcontact.files.atomic_files import open_for_writing

    with open_for_writing(path) as file:
        file.write(PNG)


def replace_module():
    """Replaces the module that draws runs, in a process that has not imported it; Matplotlib is not imported."""
    sys.modules[MODULE] = SimpleNamespace(**dict.fromkeys(FUNCTIONS, write_blank))
