"""Sphinx extension: reference entries from declarations in the code, in addition to docstrings.

``.. catalogue:: warpcontact.laws`` documents all public names of a module. For laws, friction models, springs, joints
and shapes it adds the declarations of their classes: formula, source, validity, parameters with units and limits.
``.. force-elements::`` lists the families of force elements in launch order, with the arguments of their elements.
"""

import dataclasses
import importlib
import inspect
import math
import re
from typing import Any, ClassVar

from docutils import nodes
from docutils.parsers.rst import directives
from numpy.typing import ArrayLike
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from sphinx.util.typing import stringify_annotation
from warpcontact.kernels.catalogue.device_model import Formula

import warpcontact
from warpcontact.cli.law_list import PROVENANCE
from warpcontact.forces import registry
from warpcontact.scene.scene_element import SceneElement


def declared(formula: type[Formula]) -> list[str]:
    """Returns the declarations of a formula as lines of reStructuredText."""
    lines = [""]
    if formula.formula:
        lines += [f"| {plain(formula.formula)}", ""]
    fields = dataclasses.fields(formula)
    if formula.exactly_one_of:
        names = " and ".join(f"``{name}``" for name in formula.exactly_one_of)
        lines += [f"Exactly one of {names} is given.", ""]
    lines += [f":param {field.name}: {described(field)}" for field in fields]
    if fields:
        lines.append("")
    if formula.reference:
        known = "; ".join(PROVENANCE[letter] for letter in formula.provenance if letter in PROVENANCE)
        lines += [f"*Source*: {formula.reference}" + (f" ({known})." if known else "."), ""]
    if formula.validity:
        lines += [f"*Holds for*: {formula.validity}.", ""]
    return lines


def declared_arguments(kind: type[SceneElement]) -> list[str]:
    """Returns the arguments of an element of a registered family as lines of reStructuredText."""
    lines = [""]
    for field in kind.arguments():
        of = kind.kind_of(field)
        text = described(field) if "unit" in field.metadata else "true or false" if of is bool else of.__name__
        lines.append(f":param {field.name}: {text}")
    return [*lines, ""]


def described(field: "dataclasses.Field[Any]") -> str:
    """Returns meaning, unit and limits of a parameter."""
    limits = field.metadata
    unit = "" if limits["unit"] == "-" else f" [{limits['unit']}]"
    bounds = [
        f"{sign} {limits[key]:g}"
        for key, sign in (("above", ">"), ("at_least", "≥"), ("at_most", "≤"))
        if math.isfinite(limits[key])
    ]
    return ", ".join((f"{plain(limits['meaning'])}{unit}", *bounds))


def plain(text: str) -> str:
    """Returns the text of a docstring with escaped bars, which reStructuredText would take as substitutions."""
    return re.sub(r"(``.*?``)|\|", lambda found: found[1] or r"\|", text)


def describe(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Adds the declarations of a formula to its docstring."""
    lines[:] = map(plain, lines)
    if inspect.isclass(obj) and issubclass(obj, Formula) and dataclasses.fields(obj):
        lines += declared(obj)
    if inspect.isclass(obj) and issubclass(obj, SceneElement):
        lines += declared_arguments(obj)


def shorten(
    app: Sphinx, what: str, name: str, obj: Any, options: Any, signature: str | None, returned: str | None
) -> tuple[str | None, str | None]:
    """Returns a signature with ``ArrayLike`` instead of its long union type."""
    long = stringify_annotation(ArrayLike, "smart")
    return (signature and signature.replace(long, "ArrayLike")), returned


class Catalogue(SphinxDirective):
    """Documents every class and function that a module exports, in the order of its catalogue.

    With the option ``members`` it also documents the members of classes.
    """

    required_arguments = 1
    option_spec: ClassVar = {"members": directives.flag}

    def run(self) -> list[nodes.Node]:
        """Returns the nodes of all entries."""
        path = self.arguments[0]
        module = getattr(warpcontact, path.rpartition(".")[2])
        source = importlib.import_module(module.__name__)
        self.env.note_dependency(inspect.getfile(source))
        members = ["   :members:"] if "members" in self.options else []
        lines: list[str] = []
        for name in ordered(module):
            entry = getattr(module, name)
            if inspect.isclass(entry):
                lines += [f".. autoclass:: {path}.{name}", *members, ""]
            elif callable(entry):
                lines += [f".. autofunction:: {path}.{name}", ""]
        return self.parse_text_to_nodes("\n".join(lines))


def force_elements() -> list[str]:
    """Returns the families of force elements, in launch order, as lines of reStructuredText."""
    lines: list[str] = []
    for number, family in enumerate(registry.families(), 1):
        home = importlib.import_module(family.home)
        lines += [f"{number}. **{family.name}** (``{family.home}``): {summary(home)}", ""]
        if family.kind is not None:
            lines += [f"   .. autoclass:: {family.kind.__module__}.{family.kind.__qualname__}", ""]
    return lines


def summary(module: Any) -> str:
    """Returns the first sentence of the docstring of a module."""
    return plain(" ".join((inspect.getdoc(module) or "").split())).partition(". ")[0].rstrip(".") + "."


class ForceElements(SphinxDirective):
    """Lists the families of force elements."""

    def run(self) -> list[nodes.Node]:
        """Returns the nodes of the list."""
        self.env.note_dependency(inspect.getfile(registry))
        return self.parse_text_to_nodes("\n".join(force_elements()))


def ordered(module: Any) -> list[str]:
    """Returns the public names of a module that the package does not export itself, catalogues in their order."""
    names = [name for name in module.__all__ if name not in warpcontact.__all__]
    listed = [
        entry.__name__
        for value in (getattr(module, name) for name in names)
        if isinstance(value, tuple)
        for entry in value
        if inspect.isclass(entry)
    ]
    return [*dict.fromkeys((*(name for name in listed if name in names), *names))]


def setup(app: Sphinx) -> dict[str, Any]:
    """Registers the extension with Sphinx."""
    app.add_directive("catalogue", Catalogue)
    app.add_directive("force-elements", ForceElements)
    app.connect("autodoc-process-docstring", describe, priority=600)
    app.connect("autodoc-process-signature", shorten)
    return {"parallel_read_safe": True}
