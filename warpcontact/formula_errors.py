"""What to say where a user's formula does not compile."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from warpcontact.kernels.formula import Formula


@contextmanager
def explained(
    formulas: Mapping[str, type[Formula]],
    real: type,
    state: Callable[[str], tuple[str, Any]],
    about_constants: str,
    about_results: str,
) -> Iterator[None]:
    """Turns what goes wrong while a kernel compiles into a ``TypeError`` that tells what its formulas may use.

    Args:
        formulas: The formulas that the kernel is made of, by their part.
        real: Precision.
        state: Returns how the state that a part sees is called, and its struct.
        about_constants: What to add about types that do not agree.
        about_results: What to add about results of the wrong type.
    """
    try:
        yield
    except Exception as error:
        text = str(error).replace("\\n", "\n")
        hint = ""
        if "types must be the same" in text:
            hint = about_constants
        elif "array_store" in text:
            hint = about_results
        named = " with ".join(f"{part} {formula.__name__}" for part, formula in formulas.items())
        raise TypeError(
            f"{named} does not compile in {real.__name__}: {text}\n"
            + "\n".join(_what_is_there(part, formula, *state(part)) for part, formula in formulas.items())
            + hint
        ) from error


def _what_is_there(part: str, formula: type[Formula], letter: str, seen: Any) -> str:
    """Returns in words what the functions of ``formula`` are given."""
    given = {"p": formula.device_names() or ("nothing",), letter: tuple(seen.vars)}
    if formula.memories:
        given["m"] = (*formula.memories, "elapsed")
    if formula.table_field() is not None:
        given["row"] = ("start", "value", "slope", "integral")
    parts = [f"{name} has {', '.join(names)}" for name, names in given.items()]
    return f"In the {part}, {'; '.join(parts)}."
