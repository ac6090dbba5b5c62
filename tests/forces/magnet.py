"""Magnets: a family of force elements with a parameter, sensors and a history variable."""

import functools
from typing import ClassVar

import warp as wp
from warpcontact.kernels.couplings import ends
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import ENV_ACTIVE, LaunchRange, structs, task_count, task_env, task_item

import warpcontact as wc
from warpcontact.forces.couplings.point_pair_set import PointPairSet, settings_struct
from warpcontact.forces.registry import register
from warpcontact.scene.scene_element import PointPair
from warpcontact.system.launches import launch_kernel


class Magnet(PointPair):
    """Attraction of two poles by the force strength / distance²."""

    strength: float = wc.parameter("N·m²", "force at a distance of 1 m", at_least=0.0)


@wp.struct
class Magnets:
    """Forces of all magnets, [env, magnet]."""

    force: wp.array2d(dtype=wp.float64)  # attraction [N]
    peak: wp.array2d(dtype=wp.float64)  # history: largest attraction since reset [N]


@functools.cache
def attract(real):
    """Returns the kernel of the forces in one precision; items: magnets."""
    t, points, Settings = structs(real), ends.functions(real), settings_struct(Magnet, real)
    arm, separation, write_end_force = points.arm, points.separation, points.write_end_force

    @unique_kernel()
    def attract_poles(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        model: t.Model,
        state: t.State,
        first: wp.int32,
        settings: wp.array2d(dtype=Settings),
        magnets: Magnets,
        wrenches: t.EndWrenches,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            item = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            end = 2 * (first + item)
            a = model.end_point[end]
            b = model.end_point[end + 1]
            arm_a = arm(model, state, env, a)
            arm_b = arm(model, state, env, b)
            apart = separation(model, state, env, a, b, arm_a, arm_b)
            force = settings[env, item].strength / wp.length_sq(apart)
            write_end_force(wrenches, env, end, arm_a, force * wp.normalize(apart))
            write_end_force(wrenches, env, end + 1, arm_b, -force * wp.normalize(apart))
            magnets.force[env, item] = wp.float64(force)

    return attract_poles


@unique_kernel()
def keep_peak(launch: LaunchRange, status: wp.array(dtype=wp.int32), magnets: Magnets):
    for task in range(wp.tid(), task_count(launch), launch.threads):
        env = task_env(launch, task)
        item = task_item(launch, task)
        if status[env] == ENV_ACTIVE:
            magnets.peak[env, item] = wp.max(magnets.peak[env, item], magnets.force[env, item])


@unique_kernel()
def clear_peak(mask: wp.array(dtype=wp.bool), magnets: Magnets):
    env, item = wp.tid()
    if mask[env]:
        magnets.peak[env, item] = wp.float64(0.0)


class MagnetSet(PointPairSet):
    """Device data of all magnets of a model."""

    family = "magnets"
    kind = Magnet
    struct = Magnets
    transient = ("force",)
    quantities: ClassVar = {
        "force": ("force", "N", "attraction of the poles"),
        "peak": ("peak", "N", "largest attraction since reset, as of the last step"),
    }

    def force_launches(self, plan, state, step, status, *, by_cluster=False):
        a = plan.model.arrays
        return plan.prepare(
            attract(self.types.real),
            self.count,
            status=status,
            model=a.model,
            state=state,
            first=self.first,
            settings=self.settings,
            magnets=self.results,
            wrenches=a.end_wrenches,
        )

    def accept_launches(self, plan, dt, state_in):
        return plan.prepare(keep_peak, self.count, status=plan.model.arrays.status, magnets=self.results)

    def reset_state(self, chosen):
        shape = (len(chosen), self.count)
        launch_kernel(clear_peak, shape, device=chosen.device, mask=chosen, magnets=self.results)


register(Magnet, MagnetSet.declare)
