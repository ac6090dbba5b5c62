"""Memory of laws and friction models: what a formula declares by ``history_in``, one struct per contact and environment.

The force stage never changes it. It recalls the memory of the last accepted step, lets the formula advance it to
the present instant, answers with the force, and keeps the result in a second array; ``history.py`` takes that over
once the step is accepted. So a force can be asked for any number of times. How long ago the memory was advanced is
part of it.

A tangent vector is kept in the axes of the surface, so that it turns with it, and follows the normal by the
smallest rotation from the last normal to the present one.
"""

import functools
import linecache
from typing import Any, NamedTuple

import warp as wp
from warpcontact.kernels.catalogue.device_model import Formula, named_struct
from warpcontact.kernels.types import structs


def memory_struct(formula: type[Formula], real: type) -> Any:
    """Returns the struct of what ``formula`` remembers; of a formula without memory it is never looked at."""
    vec3 = structs(real).vec3
    fields = tuple((name, vec3 if field.tangent else real) for name, field in formula.memories.items())
    return named_struct(f"{formula.__name__}Memory", (*fields, ("elapsed", real), ("_normal", vec3)))


class Functions(NamedTuple):
    """Device functions of one part of a contact."""

    #: ``(memory, kept, env, member, p, x, max_elapsed, dt, q_WS, n_W)``: the force, from the memory advanced by no
    #: more than ``max_elapsed`` [s], which is kept.
    evaluate: wp.Function
    #: ``(p, x)``: the force of a contact that has just begun.
    start_force: wp.Function
    #: ``(kept, env, member, dt)``: keeps an empty memory.
    clear_history: wp.Function


@functools.cache
def functions(formula: type[Formula], real: type, along_normal: bool = False) -> Functions:
    """Returns the device functions of one part of a contact.

    Args:
        formula: Law or friction.
        real: Precision.
        along_normal: Whether its vectors lie along the normal, as in torsion, not in the tangent plane.
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
        """``v`` at length ``size``: a rounded quaternion scales what it rotates, and every step would again."""
        length = wp.length(v)
        if length == real(0.0):
            return v
        return (size / length) * v

    @wp.func
    def transport(v: vec3, before: vec3, after: vec3):
        """``v`` by the smallest rotation from unit vector ``before`` to ``after``."""
        axis = wp.cross(before, after)
        cosine = wp.dot(before, after)
        if cosine < real(-0.999):
            # Turned over: no direction is the right one, and no memory gives nothing back.
            return vec3()
        rotated = wp.cross(axis, v)
        return v + rotated + wp.cross(axis, rotated) / (real(1.0) + cosine)

    @wp.func
    def project_tangent(v: vec3, n: vec3):
        """``v`` without the rounding that is not in the tangent plane, or not along the normal."""
        if wp.static(along_normal):
            return wp.dot(v, n) * n
        return v - wp.dot(v, n) * n

    @wp.func
    def to_world(m: Struct, v_S: vec3, q_WS: quat, n_S: vec3):
        """Follows the normal and takes a vector to world axes."""
        transported_S = project_tangent(transport(v_S, m._normal, n_S), n_S)
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
    """The same functions for a formula that remembers nothing."""
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
    # Where inspect, and with it Warp, looks for source that is in no file.
    linecache.cache[file] = (0, None, [f"{line}\n" for line in lines], file)
    scope = {"Struct": Struct, "turned": rotated, "quat": quat, "vec3": vec3}
    exec(compile("\n".join(lines), file, "exec"), scope)
    return wp.func(scope["all_turned"])
