"""The step as a list of prepared launches.

Each stage reads what earlier ones wrote:

    clear → closest point → contact force (one launch per law) → integrate → sweep → finish → history
"""

from typing import TYPE_CHECKING, Any

import warp as wp

from warpcontact.kernels import clear, closest_point, history, integrate, sweep

if TYPE_CHECKING:
    from warpcontact.integrators import Integrator
    from warpcontact.model import Model


def _prepare(model: "Model", kernel: wp.Kernel, dim: Any, inputs: list[Any]) -> list[wp.Launch]:
    """Returns the launch, recorded once and replayed without packing arguments; none if there is no work."""
    size = dim if isinstance(dim, tuple) else (dim,)
    if 0 in size:
        return []
    return [wp.launch(kernel, dim=dim, inputs=inputs, device=model.device, record_cmd=True)]


def force_stages(model: "Model", state: Any, step: wp.array) -> list[wp.Launch]:
    """Returns the launches that compute contacts and wrenches of ``state``; they change nothing else.

    ``step`` [env, 0] is what the forces act over [s]; zeros for the forces of the instant.
    """
    a, real = model.arrays, model.types.real
    bodies, contacts = (model.envs, model.body_count), (model.envs, model.contact_count)
    launches = _prepare(model, clear.kernel(real), bodies, [a.status, a.wrenches])
    launches += _prepare(
        model,
        closest_point.kernel(real, model.follows),
        contacts,
        [a.status, a.model, state, a.history, a.contacts],
    )
    for group in model.groups:
        launches += _prepare(
            model,
            group.kernel,
            (model.envs, group.count),
            [
                a.status,
                a.model,
                state,
                a.history,
                group.memory,
                step,
                group.first,
                group.coefficients,
                a.contacts,
                group.kept,
                a.wrenches,
            ],
        )
    return launches


def step_stages(
    model: "Model", integrator: "Integrator", dt: wp.array, state_in: Any, state_out: Any, mark: wp.array | None
) -> list[wp.Launch]:
    """Returns the launches that propose a step from ``state_in`` to ``state_out``.

    ``mark`` [0] is set, and the status of the environment changed, where a swept point crosses a surface; with
    ``None`` such a step is taken as it is.
    """
    a, real = model.arrays, model.types.real
    bodies, contacts = (model.envs, model.body_count), (model.envs, model.contact_count)
    launches = force_stages(model, state_in, dt)
    launches += _prepare(
        model, integrator.kernel(real), bodies, [a.status, dt, a.model, state_in, a.wrenches, state_out]
    )
    if model.sweeps:
        marked = wp.zeros(1, dtype=wp.int32, device=model.device) if mark is None else mark
        launches += _prepare(
            model,
            sweep.kernel(real),
            contacts,
            [a.status, a.model, state_in, state_out, a.contacts, int(mark is not None), marked],
        )
    return launches


def change_stages(model: "Model", integrator: "Integrator", change: wp.array, state: Any) -> list[wp.Launch]:
    """Returns the launches that ready ``state`` for steps longer by ``change`` [env, 0] than those before [s]."""
    a, kernel = model.arrays, integrator.change_step(model.types.real)
    if kernel is None:
        return []
    return force_stages(model, state, model.no_step) + _prepare(
        model, kernel, (model.envs, model.body_count), [a.status, change, a.model, a.wrenches, state]
    )


def accept_stages(model: "Model", dt: wp.array, state_in: Any, state_out: Any) -> list[wp.Launch]:
    """Returns the launches that accept a proposed step in all active environments."""
    a, real = model.arrays, model.types.real
    launches = _prepare(
        model, integrate.finish(real), model.envs, [a.status, dt, a.time, model.body_count, state_in, state_out]
    )
    launches += _prepare(
        model,
        history.kernel(real, model.follows),
        (model.envs, model.contact_count),
        [a.status, a.time, dt, a.contacts, a.history],
    )
    for group in model.groups:
        for formula, memory, kept in group.memories():
            launches += _prepare(
                model,
                history.memory_kernel(formula, real),
                (model.envs, group.count),
                [a.status, kept, memory],
            )
    return launches
