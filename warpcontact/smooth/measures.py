"""What is measured of smooth contacts only when it is asked for."""

from typing import TYPE_CHECKING

import warp as wp

from warpcontact.kernels.smooth import measures

if TYPE_CHECKING:
    from warpcontact.model import Model


def measure(name: str, model: "Model") -> None:
    """Computes the measure ``name`` of all smooth contacts, as they were computed last."""
    a, real = model.arrays, model.types.real
    for own in model.smooth:
        for kinds, items in own.ranges:
            mounts = own.shapes[kinds[1]].arrays.mount
            wp.launch(
                measures.points(real),
                dim=(model.envs, items.stop - items.start),
                inputs=[a.state, items.start, own.first, own.members, mounts, own.settings, own.smooth],
                outputs=[getattr(a, name)],
                device=model.device,
            )
