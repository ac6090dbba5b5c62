"""Reader of GLB, binary glTF 2. Names of nodes, meshes and materials become groups."""

import base64
import json
import struct
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from warpcontact.meshes.readers.content import Content, Unreadable
from warpcontact.meshes.readers.parts import Parts

_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
# Required extensions without which the file is incomplete but its triangles are valid.
_ALLOWED = ("KHR_mesh_quantization", "KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_")


def read_glb(data: bytes, most_faces: int) -> Content:
    """Returns the triangles of the scene of a GLB file, each part at its position."""
    if len(data) < 20 or data[:4] != b"glTF":
        raise Unreadable("no GLB header")
    version, length, header, kind = struct.unpack_from("<IIII", data, 4)
    if version != 2:
        raise Unreadable(f"GLB version must be 2, got {version}")
    if length != len(data):
        raise Unreadable(f"the header announces {length} bytes, but the file has {len(data)}")
    if kind != 0x4E4F534A or 20 + header > len(data):
        raise Unreadable("not valid GLB: it does not begin with its JSON")
    tree = json.loads(data[20 : 20 + header])
    return _Scene(tree, data[20 + header :]).content(most_faces)


class _Scene:
    """A glTF document.

    Args:
        tree: Parsed JSON.
        rest: Data after the JSON in the file: the binary chunk, if there is one.
    """

    def __init__(self, tree: dict[str, Any], rest: bytes) -> None:
        self.tree = tree
        self.binary = b""
        if len(rest) >= 8:
            length, kind = struct.unpack_from("<I4s", rest)
            if kind == b"BIN\0" and 8 + length <= len(rest):
                self.binary = rest[8 : 8 + length]
        if (version := str(tree["asset"]["version"])).partition(".")[0] != "2":
            raise Unreadable(f"glTF version must be '2.0', got {version[:80]!r}")
        for extension in tree.get("extensionsRequired", []):
            if not extension.startswith(_ALLOWED):
                raise Unreadable(f"the file needs the extension {extension[:80]!r}, which is not supported")
        for i, buffer in enumerate(tree.get("buffers", [])):
            if i and "uri" not in buffer:
                raise Unreadable(f"buffer {i} has no data; only buffer 0 can be the binary part of the file")
            if not buffer.get("uri", "data:").startswith("data:"):
                raise Unreadable(f"buffer {i} is in another file, {buffer['uri'][:80]!r}")

    def content(self, most_faces: int) -> Content:
        """Returns the triangles of the scene."""
        parts = Parts(most_faces)
        omitted = total = deformed = 0
        instanced = False
        read: dict[tuple[int, int], tuple[Any, Any]] = {}
        for node, matrix in self._placed():
            number = node["mesh"]
            mesh = self._entry("meshes", number)
            instanced |= "EXT_mesh_gpu_instancing" in node.get("extensions", {})
            morphed = any(node.get("weights", mesh.get("weights", [])))
            for i, primitive in enumerate(mesh["primitives"]):
                total += 1
                if primitive.get("mode", _TRIANGLES) not in (_TRIANGLES, _STRIP, _FAN):
                    omitted += 1
                    continue
                deformed += "skin" in node or (morphed and "targets" in primitive)
                if (number, i) not in read:
                    read[number, i] = self._triangles(primitive)
                material = self._entry("materials", primitive["material"]) if "material" in primitive else {}
                names = [str(thing["name"]) for thing in (node, mesh, material) if thing.get("name")]
                label = str(mesh.get("name") or f"mesh {number}")
                parts.add(label, *read[number, i], matrix, names=names)
        content = parts.content()
        content.unit = 1.0  # glTF is always in meters
        if omitted:
            content.warnings.append(f"{omitted} of {total} parts are points or lines and were omitted")
        if deformed:
            content.warnings.append(
                f"{deformed} of {total} parts have a skin or morph targets, which were ignored"
            )
        if instanced:
            content.warnings.append(
                "instances of EXT_mesh_gpu_instancing were ignored; such parts are included once"
            )
        return content

    def _placed(self) -> Iterator[tuple[dict[str, Any], npt.NDArray[np.float64]]]:
        """Iterates over nodes with a mesh, in file order, with matrices (4, 4) to the world, for column vectors."""
        nodes = self.tree.get("nodes", [])
        if scenes := self.tree.get("scenes"):
            roots = scenes[self._index("scenes", self.tree.get("scene", 0))].get("nodes", [])
        elif nodes:
            roots = sorted(
                set(range(len(nodes))) - {child for node in nodes for child in node.get("children", [])}
            )
        else:
            for number in range(len(self.tree.get("meshes", []))):
                yield {"mesh": number}, np.eye(4)
            return
        stack = [(number, np.eye(4)) for number in reversed(roots)]
        seen = set()
        while stack:
            number, above = stack.pop()
            if number in seen:  # a node can have only one parent
                raise Unreadable(f"not valid GLB: node {number} is more than once in the scene")
            seen.add(number)
            node = self._entry("nodes", number)
            with np.errstate(all="ignore"):  # the examination reports overflow
                matrix = above @ _matrix(node)
            if "mesh" in node:
                yield node, matrix
            stack += [(child, matrix) for child in reversed(node.get("children", []))]

    def _triangles(self, primitive: dict[str, Any]) -> tuple[Any, Any]:
        """Returns vertices and triangles of a part of a mesh."""
        for extension in primitive.get("extensions", {}):
            if "compression" in extension:
                raise Unreadable(f"compression ({extension[:80]}) is not supported")
        if "POSITION" not in primitive["attributes"]:
            raise Unreadable("not valid GLB: a part has no POSITION")
        vertices = self._accessor(primitive["attributes"]["POSITION"], "VEC3")
        if "indices" in primitive:
            indices = self._accessor(primitive["indices"], "SCALAR").reshape(-1)
            if indices.dtype.kind != "u":
                raise Unreadable(
                    f"not valid GLB: vertex numbers must be unsigned integers, not normalized; got {indices.dtype}"
                )
            indices = indices.astype(np.int64)
        else:
            indices = np.arange(len(vertices))
        mode = primitive.get("mode", _TRIANGLES)
        if mode == _TRIANGLES:
            if len(indices) % 3:
                raise Unreadable(
                    f"not valid GLB: the number of vertex indices must be a multiple of 3, got {len(indices)}"
                )
            return vertices, indices.reshape(-1, 3)
        first, second, third = indices[:-2], indices[1:-1], indices[2:]
        if mode == _FAN:
            return vertices, np.stack((np.broadcast_to(indices[:1], third.shape), second, third), axis=1)
        faces = np.stack((first, second, third), axis=1)
        faces[1::2] = faces[1::2, [1, 0, 2]]  # every second triangle of a strip has reverse winding
        # Triangles with repeated vertices only connect strips.
        return vertices, faces[(faces != faces[:, [1, 2, 0]]).all(axis=1)]

    def _accessor(self, number: Any, kind: str) -> npt.NDArray[Any]:
        """Returns the values of an accessor, (count, width)."""
        accessor = self._entry("accessors", number)
        if "bufferView" not in accessor or "sparse" in accessor:
            raise Unreadable(f"accessor {number} is compressed or sparse, which is not supported")
        if accessor["type"] != kind or accessor["componentType"] not in _COMPONENTS:
            raise Unreadable(
                f"not valid GLB: accessor {number} must be of type {kind}, got {accessor['type']!r} of "
                f"{accessor['componentType']!r}"
            )
        view = self._entry("bufferViews", accessor["bufferView"])
        dtype, width = np.dtype(_COMPONENTS[accessor["componentType"]]), _WIDTHS[kind]
        size = dtype.itemsize * width
        count, offset = accessor["count"], accessor.get("byteOffset", 0)
        stride, begin = view.get("byteStride", size), view.get("byteOffset", 0)
        buffer = self._buffer(view["buffer"])[begin : begin + view["byteLength"]]
        is_valid = all(type(value) is int and value >= 0 for value in (count, offset, stride, begin))
        if not is_valid or stride < size or (count and offset + stride * (count - 1) + size > len(buffer)):
            raise Unreadable(
                f"not valid GLB: accessor {number} announces {count!r} values, but there are {len(buffer)} bytes "
                f"for it (offset {offset!r}, stride {stride!r}); is the file cut short?"
            )
        if not count:
            return np.empty((0, width), dtype)
        values = np.ndarray((count, width), dtype, buffer, offset, (stride, dtype.itemsize)).copy()
        if accessor.get("normalized") and dtype.kind in "iu":
            return np.maximum(values / np.iinfo(dtype).max, -1.0)
        return values

    def _buffer(self, number: Any) -> bytes:
        buffer = self._entry("buffers", number)
        if "uri" in buffer:
            return base64.b64decode(buffer["uri"].partition(",")[2], validate=True)
        return self.binary

    def _entry(self, key: str, number: Any) -> dict[str, Any]:
        entry = self.tree.get(key, [])[self._index(key, number)]
        if not isinstance(entry, dict):
            raise Unreadable(f"not valid GLB: {key}[{number}] must be an object")
        return entry

    def _index(self, key: str, number: Any) -> int:
        """Returns a valid index into ``key``; a negative one would count from the end."""
        count = len(self.tree.get(key, []))
        if type(number) is not int or not 0 <= number < count:
            raise Unreadable(f"not valid GLB: an index into {key} must be from 0 to {count - 1}, got {number!r}")
        return number


def _matrix(node: dict[str, Any]) -> npt.NDArray[np.float64]:
    """Returns the transform of a node to its parent, (4, 4), for column vectors."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T  # column-major in the file
    matrix = np.eye(4)
    x, y, z, w = np.array(node.get("rotation", (0, 0, 0, 1)), dtype=np.float64)
    rotation = [
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    ]
    matrix[:3, :3] = np.array(rotation) * np.array(node.get("scale", (1, 1, 1)), dtype=np.float64).reshape(3)
    matrix[:3, 3] = np.array(node.get("translation", (0, 0, 0)), dtype=np.float64).reshape(3)
    return matrix
