"""Returns advice for lines of user-defined device functions that Warp cannot compile.

Warp does not mix types in arithmetic: an integer next to a number of the simulation is an error, and so are a power
with an integer exponent, and a float32 constant in a float64 simulation.
"""

import ast
import contextlib
import re
from collections.abc import Collection, Iterator, Mapping, Sequence

import warp as wp

from warpcontact.kernels.catalogue.names import closest, suggestion

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
