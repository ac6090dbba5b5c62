"""The step as a list of prepared launches.

Each stage reads what earlier ones wrote:

    clear → closest point → contact force (one launch per law) → integrate → hold failed → history
"""

from typing import TYPE_CHECKING, Any

import warp as wp

from warpcontact.kernels import clear, closest_point, history, integrate

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
        model, closest_point.kernel(real), contacts, [a.status, a.model, state, a.history, a.contacts]
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
    model: "Model", integrator: "Integrator", dt: wp.array, state_in: Any, state_out: Any
) -> list[wp.Launch]:
    """Returns the launches of one step from ``state_in`` to ``state_out``."""
    a, real = model.arrays, model.types.real
    bodies, contacts = (model.envs, model.body_count), (model.envs, model.contact_count)
    return [
        *force_stages(model, state_in, dt),
        *_prepare(
            model, integrator.kernel(real), bodies, [a.status, dt, a.model, state_in, a.wrenches, state_out]
        ),
        *_prepare(
            model,
            integrate.hold_failed(real),
            model.envs,
            [a.status, model.body_count, state_in, state_out],
        ),
        *_prepare(model, history.kernel(real), contacts, [a.status, a.contacts, a.history]),
        *(
            launch
            for group in model.groups
            for formula, memory, kept in group.memories()
            for launch in _prepare(
                model,
                history.memory_kernel(formula, real),
                (model.envs, group.count),
                [a.status, kept, memory],
            )
        ),
    ]
