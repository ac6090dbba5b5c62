"""Coulomb's cone: projection, the law of one contact, and its exact solution."""

import json

import numpy as np
import pytest
import warp as wp
from warpcontact.kernels.nonsmooth import cone
from warpcontact.kernels.types import structs

COUNT = 100_000
EPS = {wp.float32: float(np.finfo(np.float32).eps), wp.float64: float(np.finfo(np.float64).eps)}
BOTH = pytest.mark.parametrize("real", [wp.float32, wp.float64], ids=["float32", "float64"])


@pytest.fixture(scope="module")
def cone_functions(device):
    """Returns a function that computes bases, projections, solutions and residuals of many contacts."""

    def build(real):
        f, t = cone.functions(real), structs(real)
        vec3, mat33 = t.vec3, t.mat33
        basis, project, one_contact, residual = f.basis, f.project, f.one_contact, f.residual

        @wp.kernel(module="unique", enable_backward=False)
        def each(
            W: wp.array(dtype=mat33), b: wp.array(dtype=vec3), mu: wp.array(dtype=real),
            tangents: wp.array2d(dtype=vec3), nearest: wp.array(dtype=vec3),
            lam: wp.array(dtype=vec3), r: wp.array(dtype=real),
        ):  # fmt: skip
            i = wp.tid()
            first, second = basis(wp.normalize(b[i]))
            tangents[i, 0] = first
            tangents[i, 1] = second
            nearest[i] = project(b[i], mu[i])
            lam[i] = one_contact(W[i], b[i], mu[i])
            r[i] = residual(lam[i], W[i] * lam[i] + b[i], mu[i], real(3.0) / wp.trace(W[i]))

        def run(W, b, mu):
            n = len(b)
            inputs = [wp.array(x, dtype=d, device=device) for x, d in ((W, mat33), (b, vec3), (mu, real))]
            outputs = [wp.zeros(shape, d, device=device)
                       for shape, d in (((n, 2), vec3), (n, vec3), (n, vec3), (n, real))]  # fmt: skip
            wp.launch(each, n, inputs=[*inputs, *outputs], device=device)
            return [x.numpy().astype(float) for x in outputs]

        return run

    built = {}
    return lambda real: built.setdefault(real, build(real))


def many(seed, real, *, rank=3):
    """Random W, b and μ of single contacts; W = G Gᵀ with moderate or strong coupling; rounded to ``real``."""
    random = np.random.default_rng(seed)
    G = random.normal(size=(COUNT, 3, rank))
    # The mobility of some contacts depends strongly on direction.
    G *= np.exp(random.uniform(-2.0, 2.0, (COUNT, 3, 1)))
    W = G @ np.swapaxes(G, 1, 2)
    b = random.normal(size=(COUNT, 3)) * np.exp(random.uniform(-4.0, 4.0, (COUNT, 3)))
    if rank == 3:
        W += 1e-3 * np.trace(W, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        # Some barely approach.
        b[1::7, 0] *= 10.0 ** random.uniform(-20.0, 0.0, len(b[1::7]))
    else:
        # As in a mechanism, immobile directions have zero velocity.
        b = (G @ random.normal(size=(COUNT, rank, 1)))[..., 0]
    W *= 10.0 ** random.uniform(-6.0, 6.0, (COUNT, 1, 1))
    mu = random.uniform(0.0, 2.0, COUNT)
    mu[::10] = 0.0
    dtype = wp.dtype_to_numpy(real)
    return [x.astype(dtype).astype(float) for x in (W, b, mu)]


def test_single_contact_solution_matches_reference(cone_functions, shared):
    data = json.loads((shared / "spec" / "oracle_signorini.json").read_text())["contact3d"]
    W = np.array(data["W"])
    cases = [data[name] for name in ("open", "stick", "slip")]
    _, _, lam, r = cone_functions(wp.float64)(np.stack([W] * 3), [c["b"] for c in cases], [c["mu"] for c in cases])
    np.testing.assert_allclose(lam, [c["l"] for c in cases], atol=1e-14)
    w = lam @ W + [c["b"] for c in cases]
    np.testing.assert_allclose(w, [c["w"] for c in cases], atol=1e-14)
    assert (r < 1e-15).all()


@BOTH
def test_contact_tangents_are_orthonormal_and_right_handed(cone_functions, real):
    W, b, mu = many(1, real)
    b[:6] = [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, -1, 0), (1e-20, 0, -1), (1, 0, -1e-20)]
    tangents = cone_functions(real)(W, b, mu)[0]
    frame = np.concatenate([(b / np.linalg.norm(b, axis=1, keepdims=True))[:, None], tangents], axis=1)
    np.testing.assert_allclose(frame @ np.swapaxes(frame, 1, 2), np.broadcast_to(np.eye(3), frame.shape),
                               atol=8 * EPS[real])  # fmt: skip
    np.testing.assert_allclose(np.linalg.det(frame), 1.0, atol=8 * EPS[real])


@BOTH
def test_cone_projection_splits_into_cone_and_polar_cone(cone_functions, real):
    W, z, mu = many(2, real)
    nearest = cone_functions(real)(W, z, mu)[1]
    size, rest = np.linalg.norm(z, axis=1), z - nearest
    # Moreau: z = p + q with p in the cone, q in its polar cone, μ |q_t| ≤ −q_n, and p·q = 0.
    inside = mu * nearest[:, 0] - np.linalg.norm(nearest[:, 1:], axis=1)
    polar = -rest[:, 0] - mu * np.linalg.norm(rest[:, 1:], axis=1)
    rounding = 16 * EPS[real] * (1.0 + mu)
    assert (inside >= -rounding * size).all()
    assert (polar >= -rounding * size).all()
    assert (np.abs((nearest * rest).sum(axis=1)) <= rounding * size**2).all()
    # Every branch occurred.
    assert 0.1 < np.mean((nearest == z).all(axis=1)) < 0.5
    assert 0.1 < np.mean((nearest == 0.0).all(axis=1)) < 0.5


@BOTH
@pytest.mark.parametrize("rank", [3, 2, 1, "no tangential mobility", "no mobility in one tangent", "isotropic"])
def test_single_contact_solution_satisfies_the_contact_law(cone_functions, real, rank):
    W, b, mu = many(3, real, rank=rank if isinstance(rank, int) else 3)
    if rank == "no tangential mobility":
        W[:, 1:, :] = W[:, :, 1:] = 0.0
        b[::2, 1:] = 0.0
    elif rank == "no mobility in one tangent":
        W[:, 2, :] = W[:, :, 2] = 0.0
        b[::2, 2] = 0.0
    elif rank == "isotropic":
        W = np.trace(W, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        W = W.astype(wp.dtype_to_numpy(real)).astype(float)
    lam, r = cone_functions(real)(W, b, mu)[2:]
    w = np.einsum("nij,nj->ni", W, lam) + b
    across, slip = np.linalg.norm(lam[:, 1:], axis=1), np.linalg.norm(w[:, 1:], axis=1)
    # Rounding of sums of W l and b, as a velocity and as a force; l_n is a sum of −b_n / W_nn and other terms.
    trace = np.trace(W, axis1=1, axis2=2)
    velocity = np.linalg.norm(b, axis=1) + trace * np.linalg.norm(lam, axis=1)
    force = velocity / W[:, 0, 0]
    # Velocities below 64 roundings of their terms count as zero, and rounding of W makes some problems unsolvable.
    eps = 300 * EPS[real]
    assert (lam[:, 0] >= 0.0).all()
    assert (w[:, 0] >= -eps * velocity).all()
    assert (lam[:, 0] * w[:, 0] <= eps * velocity * lam[:, 0]).all()
    assert (across <= mu * lam[:, 0] + eps * (1.0 + mu) * force).all()
    # Friction opposes slip and is then at its limit.
    opposed = np.abs(slip * across + (w[:, 1:] * lam[:, 1:]).sum(axis=1))
    assert (opposed <= eps * velocity * across).all()
    assert (slip * (mu * lam[:, 0] - across) <= eps * velocity * (1.0 + mu) * force).all()
    # The residual of the solvers is small as well.
    assert (r <= eps * (1.0 + mu) * force).all()
    # Every mode occurred.
    stuck = (slip <= eps * velocity) & (lam[:, 0] > 0.0)
    assert 0.4 < np.mean(lam[:, 0] == 0.0) < 0.6
    assert np.mean(stuck) > 0.05
    if rank != 1:  # tangential motion is coupled with the normal, which prevents it
        assert np.mean(~stuck & (lam[:, 0] > 0.0)) > 0.1


def test_cone_impulse_is_zero_without_normal_mobility(cone_functions):
    W, b = np.zeros((2, 3, 3)), np.array([(-1.0, 2.0, 0.0), (-1.0, 0.0, 0.0)])
    W[1, 1, 1] = 1.0
    np.testing.assert_array_equal(cone_functions(wp.float64)(W, b, [0.5, 0.5])[2], 0.0)
