"""The command ``render``: draws pictures and films of a run."""

import argparse
import re
import sys
from pathlib import Path
from typing import Any

from warpcontact.cli.common import add_trust_option

STILLS = (".png",)
FILMS = (".gif", ".mp4")
# Options of films only, with their defaults.
OF_FILMS = {"fps": 25.0, "speed": 1.0}
# Largest number of environments whose numbers are printed.
NAMED = 16


def add_to(commands: Any) -> None:
    """Adds the command and its options to the parsers of all commands."""
    render = commands.add_parser(
        "render",
        help="draw a picture or a film of a run",
        description="Draw a run at one time into a .png file, or film it into a .gif or .mp4 file (requires ffmpeg), "
        "without a display.",
    )
    render.add_argument("folder", metavar="DIR", help="folder of the run")
    render.add_argument("-o", "--out", metavar="FILE", required=True, help="a .png, .gif or .mp4 file")
    render.add_argument(
        "--env",
        "--envs",
        metavar="N",
        nargs="+",
        type=int,
        help="numbers of the environments, side by side (default: the first)",
    )
    render.add_argument(
        "--together", action="store_true", help="several environments in one picture, not side by side"
    )
    render.add_argument(
        "--time",
        metavar="S",
        nargs="+",
        type=float,
        help="for a picture: simulated time, the nearest frame is drawn (default: the last frame of these "
        "environments); for a film: first and last time (default: all)",
    )
    render.add_argument("--fps", metavar="N", type=float, help="pictures per second of a film (default: 25)")
    render.add_argument(
        "--speed",
        metavar="X",
        type=float,
        help="simulated seconds per second of a film (default: 1)",
    )
    render.add_argument(
        "--size", metavar="WIDTHxHEIGHT", type=_size, default=(1280, 720), help="pixels (default: 1280x720)"
    )
    render.add_argument(
        "--from",
        dest="view_from",
        metavar=("AZIMUTH", "ELEVATION"),
        nargs=2,
        type=float,
        help="direction of the camera: degrees from x towards y, and above the horizontal (default: -60 22, or a "
        "direction from which moving bodies are visible)",
    )
    render.add_argument(
        "--look-at",
        metavar=("X", "Y", "Z"),
        nargs=3,
        type=float,
        help="center of the picture [m] (default: chosen automatically)",
    )
    render.add_argument(
        "--distance",
        metavar="M",
        type=float,
        help="distance of the camera from the center (default: all moving bodies are visible)",
    )
    render.add_argument(
        "--fov", metavar="DEGREES", type=float, default=30.0, help="angle of view, top to bottom (default: 30)"
    )
    render.add_argument(
        "--forces",
        action=argparse.BooleanOptionalAction,
        default=None,
        help="contact forces as arrows (default: if they were recorded)",
    )
    render.add_argument(
        "--force-scale", metavar="M/N", type=float, help="length of arrows (default: the largest force fits)"
    )
    render.add_argument(
        "--pressure",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="areas of body contacts, colored by pressure (default: yes)",
    )
    render.add_argument(
        "--max-pressure",
        metavar="PA",
        type=float,
        help="pressure of the upper end of the color scale (default: the largest one)",
    )
    render.add_argument(
        "--color-by", metavar="NAME", help="color moving bodies by a parameter or an outcome, such as ball.mass"
    )
    render.add_argument(
        "--labels",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="numbers of environments, times of films, color bars (default: yes)",
    )
    render.add_argument(
        "--background", metavar="COLOR", default="light", help="light, white, dark or #rrggbb (default: light)"
    )
    render.add_argument(
        "--samples", metavar="N", type=int, default=16, help="maximum rays per pixel (default: 16)"
    )
    render.add_argument(
        "--device", default="auto", metavar="D", help="cpu, cuda:0, … (default: auto, a GPU if any)"
    )
    render.add_argument("--threads", type=int, metavar="N", help="threads on the CPU (default: one per core)")
    add_trust_option(render)
    render.set_defaults(work=run)


def run(arguments: argparse.Namespace) -> None:
    """Draws a picture or a film, and prints the environments and times that it shows.

    Raises:
        ValueError: If the folder holds no valid run, or an option is not allowed.
        OSError: If writing fails.
    """
    file = Path(arguments.out)
    _check_words(arguments, file)
    from warpcontact.experiment.run import open_run

    try:
        _draw(arguments, file, open_run(arguments.folder, trust=arguments.trust))
    except ValueError as error:
        raise ValueError(_with_option_name(str(error))) from None


def _draw(arguments: argparse.Namespace, file: Path, found: Any) -> None:
    from warpcontact.visualize.rendering.pictures import film, still
    from warpcontact.visualize.rendering.render_style import RenderStyle

    style = {name: value for name, value in vars(arguments).items() if name in RenderStyle.__dataclass_fields__}
    style["forces"] = arguments.forces is not False
    time = arguments.time
    if file.suffix.lower() in FILMS:
        fps = OF_FILMS["fps"] if arguments.fps is None else arguments.fps
        speed = OF_FILMS["speed"] if arguments.speed is None else arguments.speed
        made = film(found, file, env=arguments.env, time=time, fps=fps, speed=speed, **style)
        envs, forces, count, partial = made.envs, made.forces, len(made.times), made.partial
        shown = f"{made.times[0]:g} to {made.times[-1]:g} s in {count} pictures, {made.duration:.3g} s long"
    else:
        wanted = time[0] if time else None
        picture = still(found, file, env=arguments.env, time=wanted, scene=None, style=RenderStyle(**style))
        envs, forces, shown, partial = picture.envs, picture.forces, f"{picture.time:g} s", picture.partial
        if wanted is not None and abs(picture.time - wanted) > 1.0e-9 * max(abs(wanted), 1.0):
            shown += f", the frame nearest to {wanted:g} s"
    if partial and not time:
        shown += f",{' the last frame' * (file.suffix.lower() in STILLS)} of a run that is not finished"
    if arguments.forces and not forces:
        print(
            "note: no forces are shown: the run did not record force, normal and point of a contact "
            '([record] sensors = ["<contact>.normal_force", "<contact>.normal", "<contact>.point"])',
            file=sys.stderr,
        )
    numbers = ", ".join(map(str, envs))
    named = f"environment {numbers}" if len(envs) == 1 else f"environments {numbers}"
    print(f"{named if len(envs) <= NAMED else f'{len(envs)} environments'} at {shown}: {file}")


def _check_words(arguments: argparse.Namespace, file: Path) -> None:
    """Raises ``ValueError`` if options cannot be combined."""
    suffix = file.suffix.lower()
    if suffix not in (*STILLS, *FILMS):
        raise ValueError(f"--out {file}: must end in .png, .gif or .mp4, got {suffix or 'no suffix'}")
    count = len(arguments.time or ())
    if suffix in STILLS:
        for name in OF_FILMS:
            if getattr(arguments, name) is not None:
                raise ValueError(f"--{name} requires a film: --out must end in .gif or .mp4, got {file}")
        if count > 1:
            raise ValueError(f"--time must be one time for a picture, got {count}; a film ends in .gif or .mp4")
    elif count not in (0, 2):
        raise ValueError(f"--time must be the first and the last time for a film, got {count}")


def _size(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d+)[x×](\d+)", text)
    if not found:
        raise argparse.ArgumentTypeError(f"must be WIDTHxHEIGHT, such as 1280x720, got {text!r}")
    return int(found[1]), int(found[2])


def _with_option_name(text: str) -> str:
    """Returns an error about an argument with the name of its command-line option."""
    names = {
        "view_from": "from",
        "color_by": "color-by",
        "look_at": "look-at",
        "force_scale": "force-scale",
        "max_pressure": "max-pressure",
    }
    found = re.match(
        r"(view_from|color_by|look_at|force_scale|max_pressure|size|time|fps|speed|distance|fov|samples|threads|background|device)\b",
        text,
    )
    return f"--{names.get(found[1], found[1])}{text[found.end() :]}" if found else text
