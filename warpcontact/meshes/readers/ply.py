"""Reader of PLY, binary in both byte orders and text."""

import re
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from warpcontact.meshes.readers.content import Content, Unreadable, from_polygons

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}
_CORNERS = ("vertex_indices", "vertex_index")


@dataclass
class _Element:
    """Element of the header: its number of rows, and the content of a row.

    ``properties`` are name, type, and type of the list length, which is empty for a single value.
    """

    name: str
    count: int
    properties: list[tuple[str, str, str]] = field(default_factory=list)

    @property
    def has_lists(self) -> bool:
        return any(length for _, _, length in self.properties)


# Content of rows by property name: values (n,), or lengths and concatenated entries of lists.
_Columns = dict[str, Any]


def read_ply(data: bytes) -> Content:
    """Returns vertices and faces of a PLY file; colors and other properties are ignored."""
    order, elements, start = _header(data)
    for element in elements:
        for name, kind, length in element.properties:
            if element.name == "face" and name in _CORNERS and length and kind[0] == "f":
                raise Unreadable(f"not valid PLY: {name} must be a list of an integer type, got {kind}")
    body: _Body = _TextBody(data[start:], elements) if not order else _BinaryBody(data, start, order)
    vertices, counts, corners = np.empty((0, 3)), np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    for element in elements:
        columns = body.rows(element)
        if element.name == "vertex":
            if element.has_lists:
                raise Unreadable("list properties of vertices are not supported")
            if not {"x", "y", "z"} <= columns.keys():
                raise Unreadable("not valid PLY: vertices must have x, y and z")
            vertices = np.stack([columns[axis].astype(np.float64) for axis in "xyz"], axis=1)
        elif element.name == "face" and element.count:
            found = [columns[name] for name in _CORNERS if name in columns]
            if not found or not isinstance(found[0], tuple):
                raise Unreadable(f"not valid PLY: faces must have a list {' or '.join(_CORNERS)}")
            counts, corners = found[0]
    if (counts < 3).any():
        i = int((counts < 3).argmax())
        raise Unreadable(f"face {i} must have at least 3 vertices, got {counts[i]}")
    return from_polygons(vertices, counts, corners)


def _header(data: bytes) -> tuple[str, list[_Element], int]:
    """Returns the byte order (empty for text), the elements, and the offset of the rows."""
    end = re.search(rb"(?m)^end_header[ \t]*(\r\n|\n|\r)", data)
    if not data.startswith(b"ply") or not end:
        raise Unreadable("no PLY header")
    order, elements = None, list[_Element]()
    for line in data[: end.start()].decode(errors="replace").splitlines()[1:]:
        match line.split():
            case ["format", name, *_] if name in _ORDERS:
                order = _ORDERS[name]
            case ["element", name, count] if count.isascii() and count.isdigit():
                elements.append(_Element(name, int(count)))
            case ["property", "list", length, kind, name] if (
                elements and kind in _TYPES and _TYPES.get(length, "f")[0] in "iu"
            ):
                elements[-1].properties.append((name, _TYPES[kind], _TYPES[length]))
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1].properties.append((name, _TYPES[kind], ""))
            case [] | ["comment" | "obj_info", *_]:
                pass
            case _:
                raise Unreadable(f"not valid PLY: invalid header line {line[:80]!r}")
    for element in elements:
        names = [name for name, _, _ in element.properties]
        if len(set(names)) < len(names) or not names:
            raise Unreadable(
                f"not valid PLY: properties of {element.name} must be distinct and not empty, got {names[:20]}"
            )
    if order is None:
        raise Unreadable(f"not valid PLY: the header has no format; allowed: {', '.join(_ORDERS)}")
    return order, elements, end.end()


class _Body(ABC):
    """Rows of all elements, read one element after the other."""

    @abstractmethod
    def rows(self, element: _Element) -> _Columns:
        """Reads the rows of the next element."""


class _TextBody(_Body):
    def __init__(self, text: bytes, elements: list[_Element]) -> None:
        if b"_" in text:  # Python accepts 1_0 as 10
            word = next(word for word in text.split() if b"_" in word)
            raise Unreadable(f"not valid PLY: {word[:80].decode(errors='replace')!r} is not a number")
        self.lines = [words for words in (line.split() for line in text.splitlines()) if words]
        self.next = 0
        announced = sum(element.count for element in elements)
        if len(self.lines) < announced:
            raise Unreadable(
                f"the header announces {announced} lines, but there are {len(self.lines)}; is the file cut short?"
            )

    def rows(self, element: _Element) -> _Columns:
        lines = self.lines[self.next : self.next + element.count]
        self.next += element.count
        width = len(element.properties)
        if not element.has_lists:
            for i, words in enumerate(lines):
                if len(words) < width:
                    raise _short(element, i, words)
            values = np.array([words[:width] for words in lines], dtype=np.float64).reshape(-1, width)
            return {name: values[:, k] for k, (name, _, _) in enumerate(element.properties)}
        lists: dict[str, tuple[list[int], list[int]]] = {name: ([], []) for name, _, n in element.properties if n}
        for i, words in enumerate(lines):
            at = 0
            for name, _, length in element.properties:
                count = int(words[at]) if length and at < len(words) else 0
                entries = words[at + 1 : at + 1 + count] if length else words[at : at + 1]
                if count < 0 or len(entries) != (count if length else 1) or at >= len(words):
                    raise _short(element, i, words)
                at += 1 + count
                if name in _CORNERS and length:
                    lists[name][0].append(count)
                    lists[name][1].extend(map(int, entries))
        return {
            name: (np.array(counts, dtype=np.int64), np.array(entries, dtype=np.int64))
            for name, (counts, entries) in lists.items()
            if name in _CORNERS
        }


def _short(element: _Element, i: int, words: list[bytes]) -> Unreadable:
    text = b" ".join(words)[:80].decode(errors="replace")
    return Unreadable(f"not valid PLY: {element.name} {i} lacks values, got {text!r}")


class _BinaryBody(_Body):
    def __init__(self, data: bytes, start: int, order: str) -> None:
        self.data, self.at, self.order = data, start, order

    def rows(self, element: _Element) -> _Columns:
        if not element.count:
            return {name: np.empty(0) for name, _, _ in element.properties}
        lengths = self._lengths(element)
        dtype = self._dtype(element, lengths)
        if element.count * dtype.itemsize <= len(self.data) - self.at:
            table = np.frombuffer(self.data, dtype, element.count, self.at)
            if all((table[_length(name)] == n).all() for name, n in lengths.items()):
                self.at += table.nbytes
                return {name: _column(table, name, lengths.get(name)) for name, _, _ in element.properties}
        elif not lengths:
            raise self._truncated(element)
        return self._variable_lists(element)

    def _lengths(self, element: _Element) -> dict[str, int]:
        """Returns the lengths of the lists in the next row."""
        lengths, at = {}, self.at
        for name, kind, length in element.properties:
            if length:
                if at + int(length[1]) > len(self.data):
                    raise self._truncated(element)
                lengths[name] = self._count(element, length, at)
                at += int(length[1]) + lengths[name] * int(kind[1])
                if at > len(self.data):  # before creating a dtype of that length
                    raise self._truncated(element)
            else:
                at += int(kind[1])
        return lengths

    def _count(self, element: _Element, length: str, at: int) -> int:
        """Returns the number of entries of the list that begins at byte ``at``."""
        bytes_of = self.data[at : at + int(length[1])]
        count = int.from_bytes(bytes_of, "big" if self.order == ">" else "little", signed=length[0] == "i")
        if count < 0:
            raise Unreadable(f"not valid PLY: a list of {element.name} has {count} entries")
        return count

    def _dtype(self, element: _Element, lengths: dict[str, int]) -> np.dtype[Any]:
        fields: list[Any] = []
        for name, kind, length in element.properties:
            if length:
                fields += [(_length(name), self.order + length), (name, self.order + kind, (lengths[name],))]
            else:
                fields.append((name, self.order + kind))
        return np.dtype(fields)

    def _variable_lists(self, element: _Element) -> _Columns:
        """Reads the vertex lists of rows whose lists differ in length."""
        name = next((n for n, _, length in element.properties if length and n in _CORNERS), "")
        kind, counts, places, end = "i1", list[int](), list[int](), len(self.data)
        for _ in range(element.count):
            for key, size, length in element.properties:
                if length:
                    if self.at + int(length[1]) > end:
                        raise self._truncated(element)
                    count = self._count(element, length, self.at)
                    self.at += int(length[1])
                    if key == name:
                        kind = size
                        counts.append(count)
                        places.append(self.at)
                    self.at += count * int(size[1])
                else:
                    self.at += int(size[1])
            if self.at > end:
                raise self._truncated(element)
        if not name:
            return {}
        lengths, width = np.array(counts, dtype=np.int64), int(kind[1])
        first = np.repeat(np.array(places) - (np.cumsum(lengths) - lengths) * width, lengths)
        starts = first + np.arange(int(lengths.sum())) * width
        entries = np.frombuffer(self.data, np.uint8)[starts[:, None] + np.arange(width)]
        return {name: (lengths, entries.view(self.order + kind).reshape(-1).astype(np.int64))}

    def _truncated(self, element: _Element) -> Unreadable:
        return Unreadable(
            f"the header announces {element.count} {element.name} rows, but the file ends earlier; "
            "is the file cut short?"
        )


def _column(table: npt.NDArray[Any], name: str, length: int | None) -> Any:
    if length is None:
        return table[name]
    return np.full(len(table), length), table[name].astype(np.int64).reshape(-1)


def _length(name: str) -> str:
    """Returns the column name of the length of list ``name``, which differs from any property name."""
    return f"{name} length"
