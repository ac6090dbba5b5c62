"""Explains compile errors of user-defined laws and other device models."""

import contextlib
import dataclasses
import inspect
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import warp as wp

from warpcontact import kernels
from warpcontact.kernels.catalogue.device_model import Formula
from warpcontact.validation.custom_law_hints import advice, mixes_types

# The steps of Warp's parser to an error, and Warp's names of types.
_STEP = re.compile(r'Error while parsing function "([^"]*)" at ([^\n]*):(\d+):\n([^\n]*)\n;?')
_TYPE = re.compile(r"<class '(?:\w+\.)*(\w+)'>|wp::| \((?:[\w<>]+\.)+\w+\)")
# Folders with code that is not user-defined.
_LIBRARY_ERRORS = tuple(Path(str(package.__file__)).parent for package in (kernels, wp))


def has_user_code(formulas: Iterable[type[Formula]]) -> bool:
    """Whether any of these classes is user-defined, and may not compile."""
    return not all(formula.__module__.startswith("warpcontact.kernels.") for formula in formulas)


@contextlib.contextmanager
def explain_compile_errors(
    formulas: Mapping[str, type[Formula]],
    real: type,
    state: Callable[[str], tuple[str, Any]],
    about_constants: str,
    about_results: str,
) -> Iterator[None]:
    """Converts errors during compilation to a ``TypeError`` that lists what the functions of its classes can use.

    Args:
        formulas: Classes of the kernel, by part, such as ``"law"``.
        real: Floating-point type of the simulation.
        state: Returns name and struct of the state argument of a part.
        about_constants: Advice for arguments of different types.
        about_results: Advice for results of the wrong type.
    """
    try:
        yield
    except Exception as error:
        text = compile_error_text(
            error, formulas.values(), {formula: state(part)[1] for part, formula in formulas.items()}
        )
        hint = about_constants if mixes_types(text) else ""
        if _read(error)[1] is None:
            # Each function compiles by itself: a return type does not match its caller.
            text = _return_types(formulas.values()) or text
            hint = about_results
        named = " with ".join(f"{part} {formula.__name__}" for part, formula in formulas.items())
        raise TypeError(
            f"{named} does not compile in {real.__name__}: {text}\n"
            + "\n".join(_available_members(part, formula, *state(part)) for part, formula in formulas.items())
            + hint
        ) from error


def compile_error_text(
    error: BaseException, formulas: Iterable[type], states: Mapping[type, Any] | None = None
) -> str:
    """Returns Warp's message about a user-defined function with file, line, source and advice.

    Args:
        error: Error raised by Warp.
        formulas: Classes of the functions.
        states: Struct of the state argument by class; ``None``: no state.
    """
    formulas = list(formulas)
    text, step = _read(error)
    if step is None:
        return text
    user_step = [one for one in formulas if issubclass(one, Formula) and has_user_code([one])]
    names, vectors, numbers = _members(user_step, states or {})
    source = step.source.strip()
    with_advice = advice(text, source, names, vectors, next(iter(numbers), ""))
    return (
        f"{_place(step, formulas)}: {text.removesuffix('.') if with_advice else text}{with_advice}\n    {source}"
    )


def _members(
    formulas: Iterable[type[Formula]], states: Mapping[type, Any]
) -> tuple[dict[str, list[str]], set[str], list[str]]:
    """Returns the members of function arguments, and those that are vectors, and the scalars of the state.

    Arguments have the names that the user gave them, such as ``{"p": ["stiffness"]}``.
    """
    names: dict[str, list[str]] = {}
    vectors, numbers = set(), []
    for formula in formulas:
        state = states.get(formula)
        given = list(_arguments(formula, "state", state).values())
        shapes = {field.name: field.metadata["shape"] for field in dataclasses.fields(formula)}
        for function in (*formula.functions, *(["advance"] if formula.memories else [])):
            called = inspect.signature(getattr(formula, function).func).parameters
            for number, (name, members) in enumerate(zip(called, given, strict=False)):
                names.setdefault(name, []).extend(members)
                if number == 0:
                    vectors |= {f"{name}.{one}" for one in members if shapes.get(one, ())}
                elif number == 1 and state is not None:
                    scalar = {one: wp.types.type_is_float(state.vars[one].type) for one in members}
                    vectors |= {f"{name}.{one}" for one in members if not scalar[one]}
                    numbers += [f"{name}.{one}" for one in members if scalar[one]]
    return names, vectors, numbers


class _Step(NamedTuple):
    function: str
    file: str
    line: int
    source: str


def _read(error: BaseException) -> tuple[str, _Step | None]:
    """Returns the message, and the innermost step of the parser in user-defined code."""
    text = "; ".join(map(str, error.args)) or str(error)
    steps = [_Step(name, file, int(line), source) for name, file, line, source in _STEP.findall(text)]
    user_step = [step for step in steps if _is_user_file(step.file)]
    text = _TYPE.sub(r"\1", _STEP.sub("", text)).strip().removeprefix("Error, ")
    return text, user_step[-1] if user_step else None


def _is_user_file(file: str) -> bool:
    return not any(Path(file).is_relative_to(folder) for folder in _LIBRARY_ERRORS)


def _place(step: _Step, formulas: Iterable[type]) -> str:
    """Returns file and line of a step.

    Warp counts the lines of most functions from their start, and compiles equal functions once: the file may be a
    different one with an equal function.
    """
    for function in _functions(formulas):
        code, lines = function.func.__code__, getattr(function.adj, "source_lines", ())
        if code.co_name != step.function or not _is_user_file(code.co_filename):
            continue
        for within in (step.line, step.line - code.co_firstlineno):
            if 0 <= within < len(lines) and lines[within].strip() == step.source.strip():
                return f"{code.co_filename}, line {code.co_firstlineno + within}"
    return f"{step.file}, in {step.function}"


def _functions(formulas: Iterable[type]) -> Iterator[wp.Function]:
    """Iterates over the functions of classes, and over the functions that these can call."""
    waiting = [value for formula in formulas for kind in formula.__mro__ for value in vars(kind).values()]
    seen = set()
    while waiting:
        function = waiting.pop(0)
        if isinstance(function, wp.Function) and function.func is not None and function.func not in seen:
            seen.add(function.func)
            yield function
            waiting += [*function.func.__globals__.values()]
            waiting += _enclosed(function.func)


def _enclosed(function: Callable[..., Any]) -> Iterator[Any]:
    """Iterates over the objects in the closure of a function; unset ones are skipped."""
    for cell in function.__closure__ or ():
        with contextlib.suppress(ValueError):
            yield cell.cell_contents


def _return_types(formulas: Iterable[type[Formula]]) -> str:
    """Returns the return types of user-defined functions, as far as Warp has determined them."""
    return_types = []
    for formula in formulas:
        for name in formula.functions:
            function = getattr(formula, name)
            if not _is_user_file(function.func.__code__.co_filename):
                continue
            made = [getattr(one.adj, "return_var", None) for one in (function, *function.user_overloads.values())]
            # The overload that was compiled last.
            types = next((found for found in reversed(made) if found), ())
            names = ", ".join(wp.types.type_repr(variable.type) for variable in types)
            return_types += [f"{formula.__name__}.{name} returns {names}"] * bool(names)
    return "; ".join(return_types)


def _available_members(part: str, formula: type[Formula], letter: str, seen: Any) -> str:
    """Returns the members of the arguments of the functions of ``formula``, as text."""
    given = _arguments(formula, letter, seen)
    parts = [f"{name} has {', '.join(names) or 'nothing'}" for name, names in given.items()]
    return f"In the {part}, {'; '.join(parts)}."


def _arguments(formula: type[Formula], letter: str, seen: Any) -> dict[str, tuple[str, ...]]:
    """Returns the members of the arguments of the functions of ``formula``, by argument."""
    given = {"p": formula.device_names(), letter: () if seen is None else tuple(seen.vars)}
    if formula.memories:
        given["m"] = (*formula.memories, "elapsed")
    if formula.table_field() is not None:
        given["row"] = ("start", "value", "slope", "integral")
    return given
