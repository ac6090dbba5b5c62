"""Memory of laws and frictions: what a formula declares by ``memory``, one struct per contact and environment.

The force stage never changes it. It *recalls* the memory of the last accepted step, lets the formula advance it
to the present instant, answers with the force, and *keeps* the result in a second array; ``history.py`` takes
that over once the step is accepted. So a force can be asked for at any trial state, any number of times.

A tangent vector is kept in the axes of the surface and laid into the present tangent plane at its old length, so
that it turns with the surface and with the normal.
"""

import functools
import linecache
from typing import Any, NamedTuple

import warp as wp
from warpcontact.kernels.formula import Formula, named_struct
from warpcontact.kernels.types import structs


def memory_struct(formula: type[Formula], real: type) -> Any:
    """Returns the struct of what ``formula`` remembers; of a formula without memory it is never looked at."""
    vec3 = structs(real).vec3
    fields = tuple((name, vec3 if field.tangent else real) for name, field in formula.memories.items())
    return named_struct(f"{formula.__name__}Memory", (*fields, ("elapsed", real)))


class Functions(NamedTuple):
    """Device functions of one part of a contact."""

    #: ``(memory, env, member, at_most, q_WS, n_W)``: the memory in W, with no more than ``at_most`` [s] elapsed.
    recall: wp.Function
    #: ``(p, x, m)``: the memory advanced to the present, and the force.
    respond: wp.Function
    #: ``(memory, env, member, m, dt, q_WS, n_W)``: writes it.
    keep: wp.Function
    #: ``(memory, env, member, dt)``: writes an empty one.
    forget: wp.Function


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
        return _without_memory(real, Struct, force)
    advance = formula.advance

    @wp.func
    def of_length(v: vec3, size: real):
        """``v`` at length ``size``: a rounded quaternion scales what it rotates, and every step would again."""
        length = wp.length(v)
        if length > real(0.0):
            return (size / length) * v
        return vec3()

    @wp.func
    def laid(v: vec3, n_W: vec3):
        """``v`` in the tangent plane, or along the normal."""
        if wp.static(along_normal):
            return wp.dot(v, n_W) * n_W
        return v - wp.dot(v, n_W) * n_W

    @wp.func
    def to_world(v_S: vec3, q_WS: quat, n_W: vec3):
        return of_length(laid(wp.quat_rotate(q_WS, v_S), n_W), wp.length(v_S))

    @wp.func
    def to_surface(v_W: vec3, q_WS: quat, n_W: vec3):
        return of_length(wp.quat_rotate_inv(q_WS, v_W), wp.length(v_W))

    tangents = [name for name, field in formula.memories.items() if field.tangent]
    all_to_world = _for_each(tangents, Struct, to_world, quat, vec3)
    all_to_surface = _for_each(tangents, Struct, to_surface, quat, vec3)

    @wp.func
    def recall(memory: Array, env: int, member: int, at_most: real, q_WS: quat, n_W: vec3):
        m = memory[env, member]
        if at_most < m.elapsed:
            m.elapsed = at_most
        return all_to_world(m, q_WS, n_W)

    @wp.func
    def respond(p: Any, x: Any, m: Struct):
        advanced = advance(p, x, m)
        return advanced, force(p, x, advanced)

    @wp.func
    def keep(memory: Array, env: int, member: int, m: Struct, dt: real, q_WS: quat, n_W: vec3):
        m.elapsed = dt
        memory[env, member] = all_to_surface(m, q_WS, n_W)

    @wp.func
    def forget(memory: Array, env: int, member: int, dt: real):
        m = Struct()
        m.elapsed = dt
        memory[env, member] = m

    return Functions(recall, respond, keep, forget)


def _without_memory(real: type, Struct: Any, force: wp.Function) -> Functions:
    """The same functions for a formula that remembers nothing."""
    t = structs(real)
    vec3, quat = t.vec3, t.quat
    Array = wp.array2d(dtype=Struct)

    @wp.func
    def recall(memory: Array, env: int, member: int, at_most: real, q_WS: quat, n_W: vec3):
        return Struct()

    @wp.func
    def respond(p: Any, x: Any, m: Struct):
        return m, force(p, x)

    @wp.func
    def keep(memory: Array, env: int, member: int, m: Struct, dt: real, q_WS: quat, n_W: vec3):
        pass

    @wp.func
    def forget(memory: Array, env: int, member: int, dt: real):
        pass

    return Functions(recall, respond, keep, forget)


def _for_each(fields: list[str], Struct: Any, turned: wp.Function, quat: Any, vec3: Any) -> wp.Function:
    """Returns the device function ``(m, q_WS, n_W)`` that applies ``turned`` to all ``fields`` of a struct.

    Warp has no loop over the fields of a struct, so its lines are written here.
    """
    lines = ["def all_turned(m: Struct, q_WS: quat, n_W: vec3):"]
    lines += [f"    m.{name} = turned(m.{name}, q_WS, n_W)" for name in fields]
    lines += ["    return m"]
    file = f"<memory of {Struct.key}>"
    # Where inspect, and with it Warp, looks for source that is in no file.
    linecache.cache[file] = (0, None, [f"{line}\n" for line in lines], file)
    scope = {"Struct": Struct, "turned": turned, "quat": quat, "vec3": vec3}
    exec(compile("\n".join(lines), file, "exec"), scope)
    return wp.func(scope["all_turned"])
