"""Makes the pictures of the gallery and stores the output of the examples. A maintainer runs it and commits both.

    python docs/pictures.py                  # all examples, several minutes
    python docs/pictures.py buoy pendulum

The cube tosses need measured data in the folder named by the environment variable ``WARPCONTACT_SHARED``.
"""

import argparse
import contextlib
import io
import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

from gallery import EXAMPLES, Example, examples
from PIL import Image

import warpcontact as wc

#: Maximum number of pixels along a side, and of bytes, of a picture.
SIDE, BYTES = 1000, 150_000
#: Output that is not stored: times, paths and messages of Warp.
PASSING = re.compile(
    r"^(?:.* s on .* environment steps per second|  \w+ +results/.*|(?:wrote|pictures?:|plot:|animation:) .*"
    r"|Warp [0-9.]+ initialized:\n(?: {3}.*\n)*?  +Kernel cache:\n.*|Module .* load on device .*)\n",
    re.MULTILINE,
)


def run(command: str, folder: Path) -> str:
    """Returns the output of a command, run with the programs of this virtual environment."""
    program, *arguments = shlex.split(command)
    there = {"python": sys.executable, "warpcontact": str(Path(sys.executable).with_name("warpcontact"))}
    print(command, flush=True)
    return subprocess.run(
        [there[program], *arguments], cwd=folder, stdout=subprocess.PIPE, text=True, check=True
    ).stdout


def make(example: Example, folder: Path) -> None:
    """Runs an example in a folder, and stores its picture and its output."""
    picture = folder / f"{example.name}.png"
    first = example.files[0]
    if "recording" in example.recipe:
        printed = draw_recording(first, example.recipe["recording"], picture)
    else:
        printed = run(example.command(first, picture.name), folder)
    if "render" in example.recipe:
        if first != example.files[-1]:
            run(example.command(example.files[-1], picture.name), folder)
        run(example.render(picture.name), folder)
    if "left" in example.recipe:
        picture = folder / "results" / example.name / example.recipe["left"]
    shrink(picture, example.picture)
    example.printed.write_text(PASSING.sub("", printed).strip() + "\n", encoding="utf-8")


def draw_recording(script: Path, options: dict[str, Any], picture: Path) -> str:
    """Runs a script in this process, draws its last recording, and returns its output.

    For a script without a recording, the current state of its last model is drawn.
    """
    models, recordings = [], []

    def keeping(function: Callable[..., Any], kept: list[Any]) -> Callable[..., Any]:
        def wrapper(*arguments: Any, **keywords: Any) -> Any:
            kept.append(function(*arguments, **keywords))
            return kept[-1]

        return wrapper

    print(script, flush=True)
    with (
        mock.patch.object(wc.Scene, "build", keeping(wc.Scene.build, models)),
        mock.patch.object(wc.Simulation, "run", keeping(wc.Simulation.run, recordings)),
        mock.patch.object(sys, "argv", [str(script)]),
        contextlib.redirect_stdout(io.StringIO()) as printed,
    ):
        runpy.run_path(str(script), run_name="__main__")
    recording = recordings[-1] if recordings else wc.Simulation(models[-1], dt=1e-6).run(1e-6)
    wc.render(recording, picture, **options)
    return printed.getvalue()


def shrink(source: Path, target: Path) -> None:
    """Writes a picture of limited size: plots with a reduced palette, others as JPEG.

    Raises:
        ValueError: If the picture is larger than ``BYTES`` at the lowest quality.
    """
    with Image.open(source) as original:
        picture = original.convert("RGB")
    picture.thumbnail((SIDE, SIDE), Image.Resampling.LANCZOS)
    for quality in (90, 80, 70, 60):
        if target.suffix == ".jpg":
            picture.save(target, quality=quality, optimize=True)
        else:
            picture.quantize(2 * quality, dither=Image.Dither.NONE).save(target, optimize=True)
        if target.stat().st_size <= BYTES:
            return
    raise ValueError(f"{source}: takes {target.stat().st_size} bytes at a quality of {quality}, more than {BYTES}")


def main() -> None:
    """Makes the requested pictures."""
    every = {example.name: example for example in examples()}
    parser = argparse.ArgumentParser(description="Makes the pictures of the gallery.")
    parser.add_argument("names", nargs="*", metavar="NAME", help="examples (default: all)")
    options = parser.parse_args()
    if unknown := sorted(set(options.names) - set(every)):
        parser.error(f"no example {', '.join(unknown)}; there are {', '.join(every)}")
    for name in options.names or every:
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            (folder / "examples").symlink_to(EXAMPLES)
            if shared := os.environ.get("WARPCONTACT_SHARED"):
                shutil.copy(Path(shared, "data", "cube_tosses.npz"), folder)
            make(every[name], folder)
            print(f"{every[name].picture}: {every[name].picture.stat().st_size} bytes", flush=True)


if __name__ == "__main__":
    main()
