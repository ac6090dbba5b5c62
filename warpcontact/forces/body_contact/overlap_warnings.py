"""Warnings about overlap: bodies that compliant body contact ejects at the start, and deep contacts at the end of a run.

The elastic energy of a pair is K h^(n+1)/(n+1), with the mean depth h of its columns, times the area if the law is a pressure. The part
e² of it becomes kinetic energy of both bodies, in proportion to their mobility. Overlaps are evaluated only if those of the bounding
boxes of solids could eject a body.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpcontact.forces.body_contact.body_sums import touching_boxes
from warpcontact.forces.body_contact.step_warnings import PairEstimates, is_movable
from warpcontact.forces.contact_warnings import column_of, expected_speed
from warpcontact.scene.elements import Body
from warpcontact.validation.checks import Array
from warpcontact.validation.warning_levels import RunWarning, WarningLevel

if TYPE_CHECKING:
    from warpcontact.forces.body_contact.solid_tables import SolidTables
    from warpcontact.model.environments import Environments
    from warpcontact.scene.body_contact import BodyContact

# Ratio of ejection speed and expected speed above which a warning is issued.
_EXCESS = 2.0
# Depth over the size of the smaller solid above which a warning is issued, for nonsmooth and compliant contacts.
_DEEP, _DEEP_COMPLIANT = 0.01, 0.1


@dataclass(frozen=True)
class _Ejections:
    """Bodies that overlaps eject.

    Attributes:
        bodies: The bodies.
        speed: Their speeds, (envs, bodies) [m/s].
        excess: Speed minus twice the expected speed, (envs, bodies) [m/s].
    """

    bodies: list[Body]
    speed: Array
    excess: Array


def overlaps_may_eject(model: "Environments", tables: "SolidTables", estimates: Sequence[PairEstimates]) -> bool:
    """Returns whether the overlap of bounding boxes could eject a body, so that contacts must be evaluated."""
    if not estimates:
        return False
    gaps, areas = touching_boxes(model, tables, estimates)
    return bool((_ejections(model, estimates, np.maximum(-gaps, 0.0), areas).excess > 0.0).any())


def body_overlap_warnings(model: "Environments", estimates: Sequence[PairEstimates]) -> list[str]:
    """Returns a warning about the body that is ejected fastest; contacts must have been evaluated."""
    measured = {
        key: np.concatenate([column_of_sensor(model, f"{one.contact.name}.{key}") for one in estimates], axis=1)
        for key in ("depth", "volume", "area")
    }
    height = measured["volume"] / np.where(measured["area"] > 0.0, measured["area"], 1.0)
    found = _ejections(model, estimates, height, measured["area"])
    if not (found.excess > 0.0).any():
        return []
    env, number = np.unravel_index(int(np.argmax(found.excess)), found.excess.shape)
    body = found.bodies[number]
    pairs = [(one.contact, pair) for one in estimates for pair in one.contact.pairs]
    own = [i for i, (_, pair) in enumerate(pairs) if body in (pair[0].body, pair[1].body)]
    deepest = own[int(np.argmax(measured["depth"][env, own]))]
    return [
        f"{pairs[deepest][0].name}: initial penetration is {measured['depth'][env, deepest]:.3g} m in environment "
        f"{model.first_env + env}. The contact force will eject {body.name} at about {found.speed[env, number]:.3g} m/s. "
        "Start outside, or at the depth at rest"
    ]


def deep_contact_warnings(
    model: "Environments", tables: "SolidTables", contacts: Sequence["BodyContact"], *, nonsmooth: bool
) -> list[RunWarning]:
    """Returns a warning about the deepest pair of contacts, relative to the size of its smaller solid, if it is deep.

    Args:
        model: The model.
        tables: The solids.
        contacts: Body contacts that are all nonsmooth, or all compliant.
        nonsmooth: Whether they are nonsmooth.
    """
    worst, limit = None, _DEEP if nonsmooth else _DEEP_COMPLIANT
    for contact in contacts:
        depth = column_of_sensor(model, f"{contact.name}.depth")
        for number, pair in enumerate(contact.pairs):
            sizes = [2.0 * tables.bounding_box(model, solid)[1].max(axis=1) for solid in pair]
            ratio = np.nan_to_num(depth[:, number] / np.minimum(*sizes))
            env = int(ratio.argmax())
            if ratio[env] > limit and (worst is None or ratio[env] > worst[0]):
                worst = ratio[env], env, depth[env, number], contact, pair
    if worst is None:
        return []
    ratio, env, deepest, contact, pair = worst
    advice = (
        "Impulses stop bodies but do not separate them: overlap at the start or of a fast impact remains. Set recovery_time of "
        "MoreauJean, for example to 20 steps, or start outside"
        if nonsmooth
        else "The law is too soft for this load, or a body was faster than its size in a few steps. Use a stiffer law or a shorter dt"
    )
    text = (
        f"{contact.name}: {pair[0].name} and {pair[1].name} overlap by {deepest:.3g} m at the end of the run, "
        f"{100.0 * ratio:.2g} % of the size of the smaller one, in environment {model.first_env + env}. {advice}"
    )
    return [RunWarning(text, WarningLevel.CAUTION)]


def column_of_sensor(model: "Environments", name: str) -> Array:
    """Returns a sensor of a body contact as (envs, pairs)."""
    return np.asarray(model.sensor(name), dtype=np.float64).reshape(model.envs, -1)


def _ejections(
    model: "Environments", estimates: Sequence[PairEstimates], height: Array, area: Array
) -> _Ejections:
    """Returns the ejections for mean depths [m] and areas [m²] of all pairs in the first environments, (envs, pairs)."""
    envs = len(height)
    energies: dict[Body, Array] = {}
    start = 0
    for one in estimates:
        own = slice(start, start + one.contact.count)
        start += one.contact.count
        if one.elastic is None:
            continue
        stiffness, exponent = (values[:envs] for values in one.elastic)
        energy = stiffness * height[:, own] ** (exponent + 1.0) / (exponent + 1.0)
        if one.contact.per_area:
            energy = energy * area[:, own]
        energy = (
            energy
            * one.mass[:envs]
            * np.broadcast_to(one.restitution, (model.envs, one.contact.count))[:envs] ** 2
        )
        for k, pair in enumerate(one.contact.pairs):
            for solid in pair:
                body = solid.body
                if body is not None and is_movable(body):
                    energies[body] = energies.get(body, 0.0) + energy[:, k]
    bodies = list(energies)
    speed, excess = np.zeros((envs, len(bodies))), np.zeros((envs, len(bodies)))
    for number, body in enumerate(bodies):
        # The energy of a pair times its effective mass over that of the body is the part of the body.
        speed[:, number] = np.sqrt(2.0 * energies[body]) / column_of(model, f"{body.name}.mass")[:envs, 0]
        excess[:, number] = speed[:, number] - _EXCESS * expected_speed(model, body)[:envs, 0]
    return _Ejections(bodies, speed, excess)
