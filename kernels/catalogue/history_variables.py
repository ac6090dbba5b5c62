"""History variables of laws and friction models: one struct per contact and environment.

A model declares them by ``history_in``. The force stage reads the variables of the last accepted step, lets the
model advance them to the present instant, evaluates the force and writes the advanced variables to a second array.
``history.py`` copies them once the step is accepted. So a force can be evaluated any number of times. The time
since the last advance is one of the variables.

A tangent vector is stored in the axes of the surface, so that it rotates with it, and is transported by the
smallest rotation from the last normal to the present one.
"""

import functools
import linecache
from typing import Any, NamedTuple

import warp as wp
from warpcontact.kernels.catalogue.device_model import Formula, named_struct
from warpcontact.kernels.types import Struct, structs


def memory_struct(formula: type[Formula], real: type) -> Struct:
    """Returns the struct of the history variables of ``formula``; unused if there are none."""
    vec3 = structs(real).vec3
    fields = tuple((name, vec3 if field.tangent else real) for name, field in formula.memories.items())
    return named_struct(f"{formula.__name__}Memory", (*fields, ("elapsed", real), ("_normal", vec3)))


class Functions(NamedTuple):
    """Device functions of one model of a contact."""

    #: ``(history_in, history_out, env, member, p, x, max_elapsed, dt, q_WS, n_W)``: returns the force; writes the
    #: history, advanced by at most ``max_elapsed`` [s], to ``history_out``.
    evaluate: wp.Function
    #: ``(p, x)``: returns the force at the start of a contact.
    start_force: wp.Function
    #: ``(history_out, env, member, dt)``: clears the history.
    clear_history: wp.Function


@functools.cache
def functions(formula: type[Formula], real: type, vectors: str = "tangent") -> Functions:
    """Returns the device functions of one model of a contact.

    Args:
        formula: Class of the law or friction model.
        real: Scalar type, ``wp.float32`` or ``wp.float64``.
        vectors: Directions of its vectors: "tangent"; "normal", as in torsion; or "any", if a component along the normal
            stands for torsion.
    """
    t = structs(real)
    vec3, quat = t.vec3, t.quat
    Struct = memory_struct(formula, real)
    Array = wp.array2d(dtype=Struct)
    force = formula.force
    if not formula.memories:
        return _without_memory(real, Array, force)
    advance = formula.advance

    @wp.func
    def with_length(v: vec3, size: real):
        """Returns ``v`` scaled to length ``size``; a rounded quaternion changes lengths in each step."""
        length = wp.length(v)
        if length == real(0.0):
            return v
        return (size / length) * v

    @wp.func
    def transport(v: vec3, before: vec3, after: vec3):
        """Returns ``v`` rotated by the smallest rotation from unit vector ``before`` to ``after``."""
        axis = wp.cross(before, after)
        cosine = wp.dot(before, after)
        if cosine < real(-0.999):
            # Opposite normals: the rotation is undefined, and a zero vector adds no energy.
            return vec3()
        rotated = wp.cross(axis, v)
        return v + rotated + wp.cross(axis, rotated) / (real(1.0) + cosine)

    @wp.func
    def project(v: vec3, n: vec3):
        """Removes rounding errors from the direction of a vector, as ``vectors`` requires."""
        if wp.static(vectors == "any"):
            return v
        if wp.static(vectors == "normal"):
            return wp.dot(v, n) * n
        return v - wp.dot(v, n) * n

    @wp.func
    def to_world(m: Struct, v_S: vec3, q_WS: quat, n_S: vec3):
        """Transports a vector to the present normal and rotates it to world axes."""
        transported_S = project(transport(v_S, m._normal, n_S), n_S)
        return with_length(
            wp.quat_rotate(q_WS, transported_S), wp.min(wp.length(v_S), real(1.001) * wp.length(transported_S))
        )

    @wp.func
    def to_surface(m: Struct, v_W: vec3, q_WS: quat, n_S: vec3):
        return with_length(wp.quat_rotate_inv(q_WS, v_W), wp.length(v_W))

    tangents = [name for name, field in formula.memories.items() if field.tangent]
    all_to_world = _for_each(tangents, Struct, to_world, quat, vec3)
    all_to_surface = _for_each(tangents, Struct, to_surface, quat, vec3)

    @wp.func
    def evaluate(
        history_in: Array,
        history_out: Array,
        env: int,
        member: int,
        p: Any,
        x: Any,
        max_elapsed: real,
        dt: real,
        q_WS: quat,
        n_W: vec3,
    ):
        n_S = wp.quat_rotate_inv(q_WS, n_W)
        m = all_to_world(history_in[env, member], q_WS, n_S)
        if max_elapsed < m.elapsed:
            m.elapsed = max_elapsed
        advanced = advance(p, x, m)
        value = force(p, x, advanced)
        advanced.elapsed = dt
        advanced._normal = n_S
        history_out[env, member] = all_to_surface(advanced, q_WS, n_S)
        return value

    @wp.func
    def start_force(p: Any, x: Any):
        return force(p, x, advance(p, x, Struct()))

    @wp.func
    def clear_history(history_out: Array, env: int, member: int, dt: real):
        m = Struct()
        m.elapsed = dt
        history_out[env, member] = m

    return Functions(evaluate, start_force, clear_history)


def _without_memory(real: type, Array: Any, force: wp.Function) -> Functions:
    """Returns the same functions for a model without history variables."""
    t = structs(real)
    vec3, quat = t.vec3, t.quat

    @wp.func
    def evaluate(
        history_in: Array,
        history_out: Array,
        env: int,
        member: int,
        p: Any,
        x: Any,
        max_elapsed: real,
        dt: real,
        q_WS: quat,
        n_W: vec3,
    ):
        return force(p, x)

    @wp.func
    def start_force(p: Any, x: Any):
        return force(p, x)

    @wp.func
    def clear_history(history_out: Array, env: int, member: int, dt: real):
        pass

    return Functions(evaluate, start_force, clear_history)


def _for_each(fields: list[str], Struct: Any, rotated: wp.Function, quat: Any, vec3: Any) -> wp.Function:
    """Returns the device function ``(m, q_WS, n_S)`` that applies ``rotated`` to all ``fields`` of a struct.

    Warp has no loop over the fields of a struct, so its lines are written here.
    """
    lines = ["def all_turned(m: Struct, q_WS: quat, n_S: vec3):"]
    lines += [f"    m.{name} = turned(m, m.{name}, q_WS, n_S)" for name in fields]
    lines += ["    return m"]
    file = f"<memory of {Struct.key}>"
    # Registered with linecache, where inspect, and so Warp, finds the source of code without a file.
    linecache.cache[file] = (0, None, [f"{line}\n" for line in lines], file)
    scope = {"Struct": Struct, "turned": rotated, "quat": quat, "vec3": vec3}
    exec(compile("\n".join(lines), file, "exec"), scope)
    return wp.func(scope["all_turned"])
