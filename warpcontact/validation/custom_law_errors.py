"""Explains compile errors of user-defined laws and other device models, with advice for lines that Warp cannot compile.

Warp does not mix types in arithmetic: an integer next to a number of the simulation is an error, and so are a power
with an integer exponent, and a float32 constant in a float64 simulation.
"""

import ast
import contextlib
import dataclasses
import inspect
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import warp as wp

from warpcontact import kernels
from warpcontact.kernels.catalogue.device_model import Formula
from warpcontact.kernels.catalogue.names import closest, suggestion

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


_ATTRIBUTE = re.compile(r"`(\w+)` is not an attribute of '(\w+)'")
_SYMBOL = re.compile(r"Referencing undefined symbol: (\w+)")
_FUNCTION = re.compile(r"Could not find function ([\w.]+)")
_TYPES = re.compile(r"types must be the same|function overload for|must be of the same type|same scalar type")
# Python modules whose functions users call by mistake.
_MODULES = ("math", "np", "numpy")
_CONVERSION = re.compile(r"wp\.(float|int|uint)\d+|range")
# Largest exponent for which a product is suggested instead of a power.
_LONGEST_PRODUCT = 4


def mixes_types(text: str) -> bool:
    """Whether a message of Warp is about arguments of different types."""
    return _TYPES.search(text) is not None or "returned different types" in text


def advice(
    text: str, source: str, names: Mapping[str, Sequence[str]], vectors: Collection[str] = (), number: str = ""
) -> str:
    """Returns advice that begins with ``"; "``, or an empty string if there is none for the error.

    Args:
        text: Message of Warp.
        source: The line of the error.
        names: Members of the arguments of the function, such as ``{"p": ["stiffness"]}``.
        vectors: Members that are no scalars, such as ``s.velocity``.
        number: A scalar of the simulation for lines without one, such as ``c.delta``.
    """
    if found := _ATTRIBUTE.search(text):
        return suggestion(found[1], names.get(found[2], ()))
    if found := _SYMBOL.search(text):
        return _of_symbol(found[1], names)
    if found := _FUNCTION.search(text):
        functions = [name for name in dir(wp) if isinstance(getattr(wp, name), wp.Function)]
        other = closest(found[1].rpartition(".")[2], functions)
        return "" if other is None else f"; did you mean wp.{other}?"
    if "vec" in text or not mixes_types(text):
        return ""
    line = _Line(source, vectors, number)
    if "returned different types" in text:
        typed = line.typed(0.0)
        return typed and f"; every return must have the same type: write return {typed} instead of return 0"
    return "".join(f"; write {new} instead of {old}" for old, new in dict(line.replacements(line.tree)).items())


def _of_symbol(name: str, names: Mapping[str, Sequence[str]]) -> str:
    """Returns advice for an undefined name."""
    if name in _MODULES:
        return f"; use the functions of Warp: wp.sqrt instead of {name}.sqrt"
    meant = closest(name, [one for members in names.values() for one in members])
    owner = next((owner for owner, members in names.items() if meant in members), None)
    return "" if owner is None else f"; did you mean {owner}.{meant}?"


class _Line:
    """A line of a function, with replacements for constants and powers that Warp does not accept."""

    def __init__(self, source: str, vectors: Collection[str], number: str) -> None:
        self.vectors, self.default = vectors, number
        self.source, self.tree = source, ast.parse("")
        # The line may be the head of a block, or an incomplete statement, for which there is no advice.
        for text in (source, f"{source} pass", f"{source.removeprefix('el')} pass"):
            with contextlib.suppress(SyntaxError):
                self.source, self.tree = text, ast.parse(text)
                break

    def typed(self, value: float, within: ast.AST | None = None) -> str:
        """Returns a constant converted to the type of a number in the line, or an empty string if there is none."""
        tree = self.tree if within is None else within
        number = next(self._numbers(tree), None) or next(self._numbers(self.tree), self.default)
        return f"type({number})({value})" if number else ""

    def replacements(self, node: ast.AST) -> Iterator[tuple[str, str]]:
        """Iterates over expressions that Warp does not accept, with their replacements."""
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow) and _constant(node.right) is not None:
            yield from self._power(node, node.left, node.right)
            yield from self.replacements(node.left)
        elif isinstance(node, ast.Call) and ast.unparse(node.func) in ("wp.pow", "pow") and len(node.args) == 2:
            yield from self._power(node, *node.args)
        elif (value := _constant(node)) is not None:
            if typed := self.typed(value):
                yield self._text(node), typed
        elif not isinstance(node, ast.Subscript) and not _converts(node):
            for child in ast.iter_child_nodes(node):
                yield from self.replacements(child)

    def _power(self, node: ast.AST, base: ast.AST, exponent: ast.AST) -> Iterator[tuple[str, str]]:
        value, factor = _constant(exponent), self._text(base)
        typed = self._text(exponent) if value is None else self.typed(value, base)
        powers = [f"wp.pow({factor}, {typed})"] * bool(typed)
        if value is not None and value.is_integer() and 2 <= value <= _LONGEST_PRODUCT:
            factor = factor if isinstance(base, ast.Name | ast.Attribute | ast.Call) else f"({factor})"
            powers.insert(0, " * ".join([factor] * int(value)))
        if powers:
            yield self._text(node), " or ".join(powers)

    def _numbers(self, tree: ast.AST) -> Iterator[str]:
        """Iterates over expressions that are scalars of the simulation, such as ``c.delta``, attributes first."""
        nodes = list(ast.walk(tree))
        parts = {id(node.func) for node in nodes if isinstance(node, ast.Call)}
        parts |= {id(node.value) for node in nodes if isinstance(node, ast.Attribute | ast.Subscript)}
        for kind in (ast.Attribute, ast.Name):
            for node in nodes:
                if isinstance(node, kind) and id(node) not in parts:
                    text = self._text(node)
                    if text not in self.vectors and text.partition(".")[0] not in ("wp", *_MODULES):
                        yield text

    def _text(self, node: ast.AST) -> str:
        return ast.get_source_segment(self.source, node) or ast.unparse(node)


def _constant(node: ast.AST) -> float | None:
    """Returns the value of a literal number, also of ``-2`` and ``float(2)``; ``None``: it is no literal number."""
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        value = _constant(node.operand)
        return None if value is None else -value
    if isinstance(node, ast.Call) and ast.unparse(node.func) in ("float", "int") and len(node.args) == 1:
        return _constant(node.args[0])
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
        return float(node.value)
    return None


def _converts(node: ast.AST) -> bool:
    """Whether a call already converts the type, such as ``type(c.delta)(2.0)`` and ``wp.float64(2.0)``."""
    if not isinstance(node, ast.Call):
        return False
    return isinstance(node.func, ast.Call) or bool(_CONVERSION.fullmatch(ast.unparse(node.func)))
