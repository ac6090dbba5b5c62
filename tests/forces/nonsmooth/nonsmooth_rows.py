"""Handmade problems of one nonsmooth step: bodies and rows in NumPy, their dense system, and device solvers."""

from dataclasses import dataclass, field

import numpy as np
import warp as wp
from warpcontact.kernels.lowlevel.warps import LANES
from warpcontact.kernels.nonsmooth import accelerated, gauss_seidel
from warpcontact.kernels.nonsmooth.rows import body_response_struct, row_structs, velocity_change_struct
from warpcontact.kernels.types import WORLD, LaunchRange

SOLVERS = {"gauss_seidel": gauss_seidel, "accelerated": accelerated}
# Device of the solvers.
DEVICE = "cpu"
UP = np.array([0.0, 0.0, 1.0])
G = 9.81
# Time during which gravity acted before the step [s].
DT = 1e-2
HALF = 0.05  # half an edge of the boxes of a tower [m]


def cross(a):
    """Matrix of the cross product a ×."""
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def frame(n):
    """Rotation from contact axes, normal first, to the world."""
    n = np.asarray(n, float)
    t = np.cross(n, np.eye(3)[np.argmin(np.abs(n))])
    t /= np.linalg.norm(t)
    return np.column_stack([n, t, np.cross(n, t)])


def project(z, mu):
    """Projection of z onto Coulomb's cone."""
    across = np.linalg.norm(z[1:])
    if across <= mu * z[0]:
        return z
    if mu * across <= -z[0]:
        return np.zeros(3)
    a = (z[0] + mu * across) / (1 + mu * mu)
    return np.concatenate([[a], a * mu * z[1:] / across])


@dataclass
class Row:
    first: int
    second: int
    arm_1: np.ndarray
    arm_2: np.ndarray
    normal: np.ndarray
    mu: float = 0.0
    restitution_speed: float = 0.0
    rolling: float = 0.0
    spinning: float = 0.0
    impulse: np.ndarray = field(default_factory=lambda: np.zeros(3))
    couple: np.ndarray = field(default_factory=lambda: np.zeros(3))


class Step:
    """Bodies and contacts of one environment.

    Args:
        inverse_masses: Inverse masses of the bodies, 6 × 6 each, [[A, B], [Bᵀ, C]], or pairs (mass, inertia in W).
        velocities: Velocities without contact, (linear, angular) each.
        rows: The contacts.
    """

    def __init__(self, inverse_masses, velocities, rows):
        self.has_joints = not all(isinstance(given, tuple) for given in inverse_masses)
        self.inverse = np.array([_inverse(m) for m in inverse_masses])
        self.velocity = np.array([np.concatenate(v) for v in velocities], float)
        self.rows = rows
        self.still = False  # whether all bodies were at rest before the step

    @property
    def rolls(self):
        return any(row.rolling or row.spinning for row in self.rows)

    def guess(self, impulses):
        """Sets the warm start."""
        for row, impulse in zip(self.rows, impulses, strict=True):
            row.impulse = impulse

    def jacobian(self):
        """H (3 × rows, 6 × bodies): relative velocities in contact axes are H v."""
        H = np.zeros((3 * len(self.rows), 6 * len(self.inverse)))
        for i, row in enumerate(self.rows):
            R = frame(row.normal)
            for body, arm, sign in ((row.first, row.arm_1, 1.0), (row.second, row.arm_2, -1.0)):
                if body != WORLD:
                    own = np.hstack([np.eye(3), -cross(arm)])
                    H[3 * i : 3 * i + 3, 6 * body : 6 * body + 6] = sign * R.T @ own
        return H

    def dense(self):
        """W and q of w = W l + q in contact axes."""
        H = self.jacobian()
        M = np.zeros((6 * len(self.inverse),) * 2)
        for i, inverse in enumerate(self.inverse):
            M[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] = inverse
        q = H @ self.velocity.ravel()
        q[::3] -= [row.restitution_speed for row in self.rows]
        return H @ M @ H.T, q

    def residual(self, impulses, velocity):
        """Natural-map residual of impulses in W with the velocities (body, 6) of the bodies."""
        W, q = self.dense()
        w = self.jacobian() @ velocity.ravel()
        w[::3] -= [row.restitution_speed for row in self.rows]
        worst, speed = 0.0, self.speeds(q)
        for i, row in enumerate(self.rows):
            own = slice(3 * i, 3 * i + 3)
            rho = 3.0 / np.trace(W[own, own])
            lifted = w[own] + [row.mu * np.linalg.norm(w[own][1:]), 0.0, 0.0]
            local = frame(row.normal).T @ impulses[i]
            off = np.linalg.norm(local - project(local - rho * lifted, row.mu))
            worst = max(worst, off / (max(rho * speed[i], np.linalg.norm(local)) or 1.0))
        return worst

    def speeds(self, q):
        """V of each row: the largest velocity without contact among the rows that bodies connect with it."""
        speed = np.linalg.norm(q.reshape(-1, 3), axis=1)
        bodies = [{row.first, row.second} - {WORLD} for row in self.rows]
        for _ in self.rows:
            speed = np.array(
                [max(v for v, theirs in zip(speed, bodies, strict=True) if own & theirs) for own in bodies]
            )
        return speed

    def momentum_after(self, impulses, couples=None):
        """Velocities (body, 6) after impulses and torsional impulses in W."""
        after = self.velocity.copy()
        for i, row in enumerate(self.rows):
            couple = np.zeros(3) if couples is None else couples[i]
            for body, arm, sign in ((row.first, row.arm_1, 1.0), (row.second, row.arm_2, -1.0)):
                if body != WORLD:
                    wrench = np.concatenate([impulses[i], np.cross(arm, impulses[i]) + couple])
                    after[body] += sign * self.inverse[body] @ wrench
        return after

    def solve(self, solver, real=wp.float64, tolerance=None, iterations=1000, status=(0, 1, 0)):
        """Solves the step in several environments, some of them inactive; returns the result of the last one."""
        arrays = self.arrays(real, len(status))
        if tolerance is None:
            tolerance = 1e-12 if real == wp.float64 else 1e-5
        launch(solver, arrays, real, self.has_joints, self.rolls, tolerance, iterations, status)
        return Result(arrays, len(self.rows))

    def solve_in_turn(self, solvers, tolerance, iterations, status=(0, 1, 0)):
        """Runs several solvers, each with its number of iterations, if those before have not converged."""
        arrays = self.arrays(wp.float64, len(status))
        change = None
        for solver, most in zip(solvers, iterations, strict=True):
            options = {"has_fallback": True} if change is None else {"is_fallback": True}
            change = launch(
                solver, arrays, wp.float64, self.has_joints, self.rolls, tolerance, most, status, change, **options
            )
        return Result(arrays, len(self.rows))

    def arrays(self, real, envs):
        r = row_structs(real)
        outcome = r.SolveResult()

        def records(struct, values):
            """The same records, by name, in every environment."""
            made = np.zeros((envs, len(next(iter(values.values())))), dtype=struct.numpy_dtype())
            for name in made.dtype.names:
                if name in values:
                    made[name] = np.asarray(values[name])
            return wp.array(made, dtype=struct, device=DEVICE)

        # A spare row beyond the row count, which must not be used.
        spare = Row(9999, 9999, *(np.full(3, np.nan),) * 3, *(np.nan,) * 4, *(np.full(3, np.nan),) * 2)
        every = [*self.rows, spare]
        values = {
            name: [getattr(row, name) for row in every] for name in vars(spare) if name not in ("first", "second")
        }
        values |= {
            "contact": range(len(every)),
            "body_1": [row.first for row in every],
            "body_2": [row.second for row in every],
        }
        rows = records(r.Row, values)
        values = {
            "linear": self.velocity[:, :3],
            "angular": self.velocity[:, 3:],
            "inverse_mass": self.inverse[:, 0, 0],
            "inverse_mass_matrix": self.inverse[:, :3, :3],
            "inverse_mass_coupling": self.inverse[:, :3, 3:],
            "inverse_inertia": self.inverse[:, 3:, 3:],
            "at_rest": [self.still] * len(self.inverse),
        }
        moving = records(body_response_struct(real, self.has_joints), values)
        outcome.count = wp.full(envs, len(self.rows), dtype=wp.int32, device=DEVICE)
        outcome.slack = wp.zeros(envs, dtype=real, device=DEVICE)
        outcome.solved_residual = wp.zeros(envs, dtype=real, device=DEVICE)
        outcome.residual = wp.full(envs, -1.0, dtype=real, device=DEVICE)
        outcome.iterations = wp.full(envs, -1, dtype=wp.int32, device=DEVICE)
        outcome.converged = wp.full(envs, -1, dtype=wp.int32, device=DEVICE)
        return rows, moving, outcome


def tower(masses, push=0.0, mu=0.5):
    """Stacked cubes with four contacts each, after a step under gravity; the top cube is pushed."""
    bodies, velocities, rows = [], [], []
    for i, mass in enumerate(masses):
        bodies.append((mass, np.eye(3) * mass * (2 * HALF) ** 2 / 6))
        top = i == len(masses) - 1
        velocities.append((np.array([push if top else 0.0, 0.0, -G * DT]), np.zeros(3)))
        for x in (-HALF, HALF):
            for y in (-HALF, HALF):
                below = np.array([x, y, HALF if i else 0.0])
                rows.append(Row(i, i - 1, np.array([x, y, -HALF]), below, UP, mu))
    return Step(bodies, velocities, rows)


def launch(solver, arrays, real, has_joints, rolls, tolerance, iterations, status, change=None, **options):
    """Runs a solver once on all environments; returns the arrays it has changed."""
    rows, moving, outcome = arrays
    module = SOLVERS[solver]
    scratch = wp.zeros(rows.shape, dtype=module.scratch(real, rolls), device=DEVICE)
    if change is None:
        change = wp.zeros(moving.shape, dtype=velocity_change_struct(real), device=DEVICE)
    kernel = module.kernel(real, has_joints, rolls, **options)
    launch = LaunchRange()
    launch.envs, launch.items = len(status), 1
    # Lanes of a warp share an environment in the accelerated solver.
    lanes = LANES if solver == "accelerated" else 1
    launch.threads = launch.envs * lanes if wp.get_device(DEVICE).is_cuda else 1
    states = wp.array(np.asarray(status, np.int32), device=DEVICE)
    inputs = [launch, states, rows, moving, outcome, real(tolerance), iterations, scratch, change]
    wp.launch(kernel, launch.threads, inputs, device=DEVICE)
    return change


class Result:
    """Result of a solver in the last environment, as NumPy arrays in float64."""

    def __init__(self, arrays, count):
        rows, moving, outcome = arrays
        self.arrays = arrays
        row, body = rows.numpy()[-1, :count], moving.numpy()[-1]
        self.impulse, self.couple = row["impulse"].astype(float), row["couple"].astype(float)
        self.velocity = np.concatenate([body["linear"], body["angular"]], -1).astype(float)
        self.residual = float(outcome.residual.numpy()[-1])
        self.iterations = int(outcome.iterations.numpy()[-1])
        self.converged = bool(outcome.converged.numpy()[-1] == 1)


def _inverse(given):
    if isinstance(given, tuple):
        mass, inertia = given
        inverse = np.zeros((6, 6))
        inverse[:3, :3] = np.eye(3) / mass
        inverse[3:, 3:] = np.linalg.inv(np.asarray(inertia, float))
        return inverse
    return np.asarray(given, float)
