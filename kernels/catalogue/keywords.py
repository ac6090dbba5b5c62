"""Errors for unknown keyword arguments: the called function, the closest argument, and all arguments.

``explain_keywords`` decorates a function, ``explain_keywords_of`` a class with its constructor and public methods.
Signatures are unchanged for editors, type checkers and documentation. Subclasses of ``Formula`` are decorated when
they are defined.
"""

import functools
import inspect
from collections.abc import Callable, Collection, Iterable
from types import FunctionType
from typing import Any, ParamSpec, TypeVar, get_args

from warpcontact.kernels.catalogue.names import closest, present_name

P = ParamSpec("P")
R = TypeVar("R")
C = TypeVar("C")


def explain_keywords(function: Callable[P, R]) -> Callable[P, R]:
    """Decorates a function, method or ``__init__`` so that a ``TypeError`` for an unknown keyword is explained.

    Errors for missing arguments name the class of the object, not the class that defines the method.

    ``**options`` are known if they are annotated with ``Unpack`` of a ``TypedDict``.
    """
    code = inspect.unwrap(function).__code__  # type: ignore[attr-defined]
    if code.co_flags & inspect.CO_VARKEYWORDS:
        known = frozenset(keywords_of(function))
    else:  # as ``keywords_of``, without the time that a signature takes
        known = frozenset(code.co_varnames[code.co_posonlyargcount : code.co_argcount + code.co_kwonlyargcount])

    @functools.wraps(function)
    def explained(*args: P.args, **keywords: P.kwargs) -> R:
        if not known.issuperset(keywords):
            raise TypeError(unexpected(_called(function, args), keywords, keywords_of(function)))
        try:
            return function(*args, **keywords)
        except TypeError as error:
            # Only a call that does not match the signature has no frame of the function.
            if error.__traceback__ is None or error.__traceback__.tb_next is not None:
                raise
            what = str(error).removeprefix(f"{function.__qualname__}()")
        raise TypeError(f"{_called(function, args)}(){what}") from None

    return explained


def explain_keywords_of(kind: type[C]) -> type[C]:
    """Decorates a class: its constructor and public methods explain unknown keywords, see ``explain_keywords``."""
    for name, value in list(vars(kind).items()):
        if name != "__init__" and name.startswith("_"):
            continue
        if isinstance(value, classmethod | staticmethod):
            setattr(kind, name, type(value)(explain_keywords(value.__func__)))
        elif isinstance(value, FunctionType):
            setattr(kind, name, explain_keywords(value))
    return kind


def keywords_of(function: Callable[..., Any]) -> list[str]:
    """Returns the names of the arguments that a function takes by keyword, without ``self`` and ``cls``."""
    names = []
    for one in inspect.signature(function).parameters.values():
        if one.kind is inspect.Parameter.VAR_KEYWORD:
            names += [name for options in get_args(one.annotation) for name in options.__annotations__]
        elif one.kind in (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY):
            names += [one.name] * (one.name not in ("self", "cls"))
    return names


def refuse_unknown(called: str, given: Collection[str], known: Iterable[str]) -> None:
    """Raises ``TypeError`` if a function with ``**options`` was called with a keyword that is not known."""
    names = list(known)
    if not set(names).issuperset(given):
        raise TypeError(unexpected(called, given, names))


def unexpected(called: str, given: Iterable[str], known: Collection[str]) -> str:
    """Returns the message about unknown keywords.

    Args:
        called: Function or class that the user called.
        given: Keywords in the call, known or not.
        known: All known keywords.
    """
    words = list(given)
    unknown = [name for name in words if name not in known]
    if new := {name: now for name in unknown if (now := present_name(name, known)) is not None}:
        return "; ".join(f"{called}(): the keyword {name!r} is now {now!r}" for name, now in new.items())
    left = [name for name in known if name not in words]
    meant = dict.fromkeys(found for found in (closest(name, left) for name in unknown) if found is not None)
    what = "an unexpected keyword argument" if len(unknown) == 1 else "unexpected keyword arguments"
    hint = f"; did you mean {' and '.join(map(repr, meant))}? It" if meant else "; it"
    return f"{called}() got {what} {', '.join(map(repr, unknown))}{hint} takes {', '.join(known) or 'none'}"


def _called(function: Callable[..., Any], args: tuple[Any, ...]) -> str:
    """Returns what the user called: the class of a constructor, ``Class.method``, or the function."""
    name = function.__name__
    first = next(iter(inspect.signature(function).parameters), "")
    if first not in ("self", "cls") or not args:
        return function.__qualname__.rpartition("<locals>.")[2]
    owner = args[0].__name__ if first == "cls" else type(args[0]).__name__
    return owner if name == "__init__" else f"{owner}.{name}"
