"""The command ``laws``: prints entries of the catalogue or of user files, and plots laws and friction models."""

import argparse
import contextlib
import dataclasses
import functools
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from warpcontact.experiment.user_code import UserFiles

# Options of plots of laws, and of friction models.
OF_LAWS = ("restitution", "mass", "speed", "depth")
OF_FRICTIONS = ("load",)


def add_to(commands: Any) -> None:
    """Adds the command and its options to the parsers of all commands."""
    laws = commands.add_parser(
        "laws",
        help="list laws and friction models, or plot some",
        description="List the laws and friction models of the library, or plot their behavior in one impact or slip "
        "test. NAME is one of these, or FILE.py:CLASS for a user-defined class; the file is executed.",
    )
    laws.add_argument("name", metavar="NAME", nargs="?", help="print this entry only")
    laws.add_argument("--plot", metavar="FILE", help="plot it into an .svg or .png file")
    laws.add_argument(
        "--compare", metavar="NAME", nargs="+", help="plot these laws, or friction models, side by side"
    )
    laws.add_argument(
        "--set",
        metavar="PARAMETER=VALUE",
        nargs="+",
        action="extend",
        help="parameters of the entries that have them, such as stiffness=1.5e6 mu_static=0.8 (default: chosen "
        "automatically)",
    )
    laws.add_argument(
        "--restitution",
        metavar="E",
        nargs="+",
        type=float,
        help="restitutions of the plotted loops (default: 0.2 … 1)",
    )
    laws.add_argument("--mass", metavar="KG", type=float, help="mass of the impacting sphere (default: 1)")
    laws.add_argument("--speed", metavar="M/S", type=float, help="impact speed (default: 1)")
    laws.add_argument(
        "--depth",
        metavar="M",
        type=float,
        help="penetration without damping for which stiffnesses are chosen (default: 0.001, or that of a given one)",
    )
    laws.add_argument("--load", metavar="N", type=float, help="normal force for friction models (default: 10)")
    laws.set_defaults(work=run)


@dataclasses.dataclass(frozen=True)
class SelectedFormula:
    """A law or friction model with its name on the command line, its class, and its file if it is user-defined."""

    name: str
    formula: Any
    own: "UserFiles | None" = None


def run(arguments: argparse.Namespace) -> None:
    """Prints entries of the catalogue or plots some.

    Raises:
        ValueError: If options cannot be combined, or a name, a value or the file is not allowed.
    """
    from warpcontact.cli import law_list

    options = {name: getattr(arguments, name) for name in (*OF_LAWS, *OF_FRICTIONS)}
    options = {name: value for name, value in options.items() if value is not None}
    _check_words(arguments, options)
    names = list(dict.fromkeys(arguments.compare or ([arguments.name] if arguments.name else [])))
    selected = [_find_formula(name) for name in names]
    if arguments.plot:
        _plot(selected, arguments.plot, _values(arguments.set or (), selected), options)
        print(f"picture: {arguments.plot}")
    elif selected:
        print("\n".join(law_list.entry(selected[0].formula)))
    else:
        print(law_list.catalogue())


def _check_words(arguments: argparse.Namespace, options: dict[str, Any]) -> None:
    """Raises ``ValueError`` if options cannot be combined."""
    if arguments.compare is not None:
        if arguments.name:
            raise ValueError(f"NAME must be left out with --compare, got {arguments.name}")
        if len(set(arguments.compare)) < 2:
            raise ValueError(f"--compare requires at least two names, got {' '.join(arguments.compare)}")
        if not arguments.plot:
            raise ValueError("--compare requires --plot FILE")
    elif arguments.plot and not arguments.name:
        raise ValueError("--plot requires the NAME of a law or friction model, or --compare NAME NAME …")
    if (options or arguments.set) and not arguments.plot:
        raise ValueError(f"--{next(iter(options), 'set')} requires --plot FILE")


def _find_formula(name: str) -> SelectedFormula:
    """Returns the law or friction model ``name``, of the catalogue or as ``FILE.py:CLASS``.

    The file may be in any folder, because the user names it explicitly, as with ``python FILE.py``.
    """
    from warpcontact.cli import law_list

    file, colon, class_name = name.rpartition(":")
    if not colon or not file.endswith(".py"):
        return SelectedFormula(name, law_list.find(name))
    from warpcontact import friction, laws
    from warpcontact.experiment.user_code import UserFiles

    try:
        path = Path(file).resolve()
    except (OSError, ValueError, RuntimeError) as error:  # for example a loop of links, or a null character
        raise ValueError(f"{name}: {file!r} cannot be read: {error}") from None
    own = UserFiles(path.parent, lambda text: None, trusted=True)
    try:
        return SelectedFormula(name, own.find(path.name, class_name, laws.Law, friction.Friction), own)
    except ValueError as error:
        raise ValueError(f"{name}{error}") from None


def _values(words: Sequence[str], selected: Sequence[SelectedFormula]) -> dict[str, float]:
    """Returns the parameters given by ``--set``, checked.

    Raises:
        ValueError: If one is not ``NAME=VALUE``, is given twice, is of none of ``selected``, or not allowed in one.
    """
    from warpcontact.kernels.catalogue.names import suggestion
    from warpcontact.validation import checks

    values: dict[str, float] = {}
    known = dict.fromkeys(name for entry in selected for name in _parameters(entry))
    for word in words:
        name, equals, text = word.partition("=")
        if not equals:
            raise ValueError(f"--set takes PARAMETER=VALUE, such as stiffness=1e6, got {word!r}")
        if name not in known:
            hint = suggestion(name, known) or f"; there are: {', '.join(known) or 'none'}"
            raise ValueError(
                f"--set {word}: {name} is no parameter of {' or '.join(e.name for e in selected)}{hint}"
            )
        if name in values:
            raise ValueError(f"--set {name} is given twice")
        try:
            values[name] = float(text)
        except ValueError:
            raise ValueError(f"--set {name} must be a number, got {text!r}") from None
        for entry in selected:
            if name in _parameters(entry):
                checks.numbers(f"--set {name}", values[name], (), entry.formula.limits(name))
    return values


def _parameters(entry: SelectedFormula) -> list[str]:
    return [field.name for field in dataclasses.fields(entry.formula)]


def _plot(
    selected: Sequence[SelectedFormula], file: str, values: dict[str, float], options: dict[str, Any]
) -> None:
    """Plots laws or friction models.

    Raises:
        ValueError: If they are mixed, or an option, a value or the file is not allowed.
    """
    from warpcontact import laws
    from warpcontact.analysis import compare
    from warpcontact.analysis.compare import figures, instances

    ours = [entry.name for entry in selected if issubclass(entry.formula, laws.Law)]
    others = [entry.name for entry in selected if entry.name not in ours]
    if ours and others:
        raise ValueError(
            f"laws and friction models cannot be compared with each other: {', '.join(ours)} with {', '.join(others)}"
        )
    for name in options:
        if name in (OF_FRICTIONS if ours else OF_LAWS):
            kind = "friction models" if ours else "laws"
            raise ValueError(f"--{name} is an option of {kind}, not of {', '.join(ours or others)}")
    _check_options(options)
    entries = _entries(selected, values)
    figures.check_count("laws" if ours else "friction models", list(entries))
    if "depth" in options and all(map(instances.is_modulus_given, entries.values())):
        raise ValueError("--depth must be left out, because all stiffnesses are given")
    with _failure_message(selected):
        for entry in entries.values():
            # Check that it can be created, before anything is written or run.
            (instances.law if ours else instances.friction)(entry, 1.0, 1.0e-3)
        compare.check_path(file)
        print("running impacts …" if ours else "running slips …", file=sys.stderr, flush=True)
        draw = compare.plot_laws if ours else compare.plot_friction_models
        draw(entries, file, **options)


def _entries(selected: Sequence[SelectedFormula], values: dict[str, float]) -> dict[str, Any]:
    """Returns the entries to plot by label: the name of the class, or the full name if two classes share it."""
    classes = [entry.formula.__name__ for entry in selected]
    return {
        entry.name if classes.count(name) > 1 else name: functools.partial(
            entry.formula, **{key: value for key, value in values.items() if key in _parameters(entry)}
        )
        for name, entry in zip(classes, selected, strict=True)
    }


def _check_options(options: dict[str, Any]) -> None:
    """Raises ``ValueError`` with the name of the option if a value is not allowed."""
    from warpcontact.analysis.compare import drop_tests, friction_tests, impact
    from warpcontact.validation import checks

    limits = {**drop_tests.LIMITS, "restitution": impact.ALLOWED, "load": friction_tests.LOAD}
    for name, value in options.items():
        for single in value if isinstance(value, list) else [value]:
            checks.numbers(f"--{name}", single, (), limits[name])


@contextlib.contextmanager
def _failure_message(selected: Sequence[SelectedFormula]) -> Iterator[None]:
    """Converts errors of classes to one sentence: missing values, or errors in a user file."""
    from warpcontact.analysis.compare.instances import MissingValues

    try:
        with contextlib.ExitStack() as stack:
            for entry in selected:
                if entry.own is not None:
                    stack.enter_context(entry.own.named_errors())
            yield
    except MissingValues as error:
        given = " ".join(f"{name}=…" for name in error.parameters)
        raise ValueError(f"{error.kind} needs {' and '.join(error.parameters)}: add --set {given}") from None
    except TypeError as error:  # a compile error, whose message has the name of the generated module
        own = [entry.formula for entry in selected if entry.own is not None]
        if not own or "does not compile" not in str(error):
            raise
        text = str(error)
        for formula in own:
            text = text.replace(f"{formula.__module__}.", "")
        raise ValueError(text) from None
