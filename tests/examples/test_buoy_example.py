"""The moored buoy of the examples comes to rest at the closed-form equilibrium of its lines."""

from pathlib import Path

import numpy as np
from scipy.optimize import brentq

import warpcontact as wc

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "buoy.toml"
LENGTH, WEIGHT, STIFFNESS = 130.0, 80.0 * 9.81, 4e8


def line(height, run):
    """Tension at the upper end of a cable that rises from the seabed, and its vertical component."""

    def parts(h):
        # T + T²/(2 EA) = h + h²/(2 EA) + w z
        total = h + h**2 / (2 * STIFFNESS) + WEIGHT * height
        tension = 2 * total / (1 + np.sqrt(1 + 2 * total / STIFFNESS))
        return tension, np.sqrt(tension**2 - h**2)

    def reach(h):
        _, v = parts(h)
        hanging = h * np.arcsinh(v / h) / WEIGHT + h * v / (STIFFNESS * WEIGHT)
        return hanging + (LENGTH - v / WEIGHT) * (1 + h / STIFFNESS)

    return parts(brentq(lambda h: reach(h) - run, 1.0, 1e6, xtol=1e-9, rtol=1e-14))


def test_buoy_example_comes_to_rest_at_the_center(device, tmp_path):
    run = wc.Experiment.from_toml(EXAMPLE).run(tmp_path / "buoy", device=device)
    recording = run.recording
    last = recording.isel(time=-1)
    place = brentq(lambda z: 440e3 - 20e3 * 9.81 - 125e3 * z - 4 * line(49.0 + z, 108.0)[1], -1.0, 1.0)
    tension, vertical = line(49.0 + place, 108.0)
    # After one minute, the sway of 9 m has decayed to some micrometers.
    np.testing.assert_allclose(last["buoy.position"], [[0.0, 0.0, place]] * 6, atol=1e-4)
    np.testing.assert_allclose(last["east.tension_b"], tension, rtol=1e-6)
    np.testing.assert_allclose(last["west.tension_b"], tension, rtol=1e-6)
    np.testing.assert_allclose(last["west.grounded_length"], LENGTH - vertical / WEIGHT, rtol=1e-6)
    assert (last["east.status"] == wc.CatenaryStatus.GROUNDED).all()
    # Upright, as in the first record.
    np.testing.assert_allclose(last["buoy.orientation"], [[0, 0, 0, 1]] * 6, atol=1e-6)
    assert float(recording["buoy.position"].isel(time=0, env=5, axis=0)) == 8.0
    # Figures in the text of the example.
    text = EXAMPLE.read_text()
    for figure in (f"{-place:.4f} m below", f"{tension / 1e3:.2f} kN", f"{LENGTH - vertical / WEIGHT:.2f} m on"):
        assert figure in text
