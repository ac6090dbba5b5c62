"""Islands: sets of bodies that contacts connect, with their rows. Each island is a contact problem of its own.

Rows between a body and the world, or a body without mobility, connect nothing.
"""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels.nonsmooth.rows import solve_types


class Functions(NamedTuple):
    """Device functions of islands."""

    #: ``(rows, body_response, velocity_change, scratch, env, count)``: sets ``row`` of ``scratch``, so that the rows of an
    #: island are consecutive and in their order in ``rows``, and ``island`` and ``next_member`` of bodies.
    find_islands: wp.Function
    #: ``(velocity_change, env, body_1, body_2)``: the island of a row between two bodies; the index of a body.
    island_of_row: wp.Function


@functools.cache
def functions(real: type, has_joints: bool, Scratch: type) -> Functions:
    """Returns the device functions for ``real``; with ``has_joints`` some bodies have joints.

    ``Scratch`` is the struct of a row.
    """
    Rows, _, BodyResponse, VelocityChange = solve_types(real, has_joints)
    Scratches = wp.array2d(dtype=Scratch)
    zero = wp.constant(real(0.0))

    @wp.func
    def is_mobile(body_response: BodyResponse, env: int, body: int):
        """Returns whether impulses move a body."""
        C = body_response[env, body].inverse_inertia
        response = C[0, 0] + C[1, 1] + C[2, 2]
        if wp.static(has_joints):
            A = body_response[env, body].inverse_mass_matrix
            response += A[0, 0] + A[1, 1] + A[2, 2]
        else:
            response += body_response[env, body].inverse_mass
        return response > zero

    @wp.func
    def root(velocity_change: VelocityChange, env: int, body: int):
        """Returns the body that represents the island of a body, and shortens the path to it."""
        one = body
        parent = velocity_change[env, one].island
        while parent != one:
            grandparent = velocity_change[env, parent].island
            velocity_change[env, one].island = grandparent
            one = parent
            parent = grandparent
        return one

    @wp.func
    def island_of_row(velocity_change: VelocityChange, env: int, body_1: int, body_2: int):
        # A body without mobility is alone in its island.
        if body_1 < 0 or (body_2 >= 0 and velocity_change[env, body_1].is_mobile == 0):
            return velocity_change[env, body_2].island
        return velocity_change[env, body_1].island

    @wp.func
    def find_islands(
        rows: Rows,
        body_response: BodyResponse,
        velocity_change: VelocityChange,
        scratch: Scratches,
        env: int,
        count: int,
    ):
        bodies = velocity_change.shape[1]
        for body in range(bodies):
            velocity_change[env, body].island = body
            velocity_change[env, body].next_member = -1
            velocity_change[env, body].next_row = 0
            velocity_change[env, body].is_mobile = wp.where(is_mobile(body_response, env, body), 1, 0)
        for row in range(count):
            body_1 = rows[env, row].body_1
            body_2 = rows[env, row].body_2
            if body_1 >= 0 and body_2 >= 0:
                if velocity_change[env, body_1].is_mobile == 1 and velocity_change[env, body_2].is_mobile == 1:
                    root_1 = root(velocity_change, env, body_1)
                    root_2 = root(velocity_change, env, body_2)
                    velocity_change[env, wp.max(root_1, root_2)].island = wp.min(root_1, root_2)
        # The root of an island is its first body.
        for reverse in range(bodies):
            body = bodies - 1 - reverse
            island = root(velocity_change, env, body)
            velocity_change[env, body].island = island
            if island != body:
                velocity_change[env, body].next_member = velocity_change[env, island].next_member
                velocity_change[env, island].next_member = body
        for row in range(count):
            island = island_of_row(velocity_change, env, rows[env, row].body_1, rows[env, row].body_2)
            velocity_change[env, island].next_row = velocity_change[env, island].next_row + 1
        start = wp.int32(0)
        for body in range(bodies):
            number = velocity_change[env, body].next_row
            velocity_change[env, body].next_row = start
            start += number
        for row in range(count):
            island = island_of_row(velocity_change, env, rows[env, row].body_1, rows[env, row].body_2)
            index = velocity_change[env, island].next_row
            scratch[env, index].row = row
            velocity_change[env, island].next_row = index + 1

    return Functions(find_islands=find_islands, island_of_row=island_of_row)
