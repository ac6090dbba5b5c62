"""Figures of laws and friction models: values, classes, units, and notes about hidden curves."""

import functools
import re

import custom_law
import numpy as np
import pytest
from matplotlib.text import Text
from warpcontact.kernels.laws.linear_dashpot import restitution_of_damping_ratio

import warpcontact as wc
from warpcontact.analysis import compare
from warpcontact.analysis.compare.friction_tests import breakaway_coefficients

L, F = wc.laws, wc.friction
PLASTIC = custom_law.Plastic(loading=1e6, unloading=4e6)


def texts(figure):
    """All texts of a figure."""
    return [text.get_text() for text in figure.findobj(Text) if text.get_text()]


def footnotes(figure):
    return figure.get_supxlabel().split("\n")


def panels(figure):
    """The panels of a figure by their titles."""
    axes = [*figure.axes, *(axes for part in figure.subfigs for axes in part.axes)]
    return {axes.get_title(): axes for axes in axes}


@pytest.mark.slow
def test_friction_models_slide_with_equal_coefficient_by_default(device):
    classes = [friction for friction in F.CATALOGUE if friction not in (F.Frictionless, F.Viscous)]
    steady = compare.slips(classes, [1.0], device=device)["coefficient"].isel(speed=0)
    # Threlfall stays 5 % below μ; Stribeck and others have almost reached it.
    expected = np.where(steady["friction"] == "Threlfall", 0.95 * 0.4, 0.4)
    np.testing.assert_allclose(steady, expected, rtol=2e-3)
    given = compare.slips([functools.partial(F.Tanh, mu=0.7), F.Dahl], [1.0], device=device)["coefficient"]
    np.testing.assert_allclose(given[:, 0], [0.7, 0.4], rtol=1e-6)


def test_class_next_to_instance_reaches_the_depth_of_the_instance(device):
    soft = L.HuntCrossley(stiffness=1.5e6, restitution=0.5)
    # ½ m v² = K δ^2.5/2.5
    own = (0.5 * 2.5 / 1.5e6) ** 0.4
    for laws in ({"class": L.Hooke, "soft": soft}, {"soft": soft, "class": L.Hooke}):
        data = compare.impacts(laws, 1.0, device=device)
        np.testing.assert_allclose(data["greatest_penetration"], own, rtol=1e-3)
        np.testing.assert_allclose(data.attrs["depth"], own, rtol=1e-3)
        assert data.attrs["depth_of"] == "soft"
    # The stiffness given to a class counts like that of an instance.
    data = compare.impacts([L.Hooke, functools.partial(L.Hertz, stiffness=1.5e6)], 1.0, device=device)
    np.testing.assert_allclose(data["greatest_penetration"], own, rtol=1e-3)
    deeper = compare.impacts({"class": L.Hooke, "soft": soft}, 1.0, depth=2e-3, device=device)
    np.testing.assert_allclose(deeper["greatest_penetration"][:, 0], [2e-3, own], rtol=1e-3)
    assert (deeper.attrs["depth"], deeper.attrs["depth_of"]) == (2e-3, "")
    assert compare.impacts(L.Hooke, 1.0, device=device).attrs["depth"] == 1e-3


def test_laws_of_very_different_stiffness_share_one_scene(device):
    """The size of the sphere follows from the penetration of the softest law, not from a fixed value."""
    data = compare.impacts({"soft": L.Hooke(stiffness=1e2), "hard": L.Hooke(stiffness=1e4)}, 1.0, device=device)
    np.testing.assert_allclose(data["greatest_penetration"][:, 0], [0.1, 0.01], rtol=1e-3)


def test_given_class_arguments_are_not_varied(device):
    damped = functools.partial(L.KelvinVoigt, damping=200.0)
    data = compare.impacts(
        {"damped": damped, "half": functools.partial(L.HuntCrossley, restitution=0.5)}, [0.2, 0.8], device=device
    )
    assert data["varied"].values.tolist() == ["", ""]
    assert "damping 200 N·s/m" in data["settings"].values[0]
    np.testing.assert_allclose(data["effective_restitution"][1], 0.5, atol=1e-3)
    # ξ = c/(2 √(K m)), with the stiffness of 1 mm: K = m v²/δ²
    expected = restitution_of_damping_ratio(200.0 / (2.0 * np.sqrt(1e6)))
    np.testing.assert_allclose(data["effective_restitution"][0], expected, atol=1e-3)


def test_law_with_fixed_restitution_is_plotted_and_labeled(device):
    figure = compare.plot_laws({"plastic": PLASTIC, "hc": L.HuntCrossley}, device=device)
    drawn = panels(figure)
    assert "plastic, e = 0.5" in drawn
    legends = [
        text.get_text() for part in figure.subfigs for legend in part.legends for text in legend.get_texts()
    ]
    assert legends[:2] == ["plastic, e = 0.5", "hc"]
    for title in ("effective restitution (dotted: prescribed)", "over speed, e = 0.6 at 1 m/s"):
        np.testing.assert_allclose(drawn[title].lines[0].get_ydata(), 0.5, atol=2e-3)
    # The color of its loop differs from all colors that stand for a restitution.
    (loop,) = drawn["plastic, e = 0.5"].lines
    assert loop.get_color() not in [tuple(line.get_color()) for line in drawn["hc"].lines]
    alone = compare.plot_laws(PLASTIC, device=device)
    assert "e = 0.5" in texts(alone)
    assert len(panels(alone)["force over penetration"].lines) == 1
    for title in ("effective restitution (dotted: prescribed)", "restitution over impact speed"):
        np.testing.assert_allclose(panels(alone)[title].lines[0].get_ydata(), 0.5, atol=2e-3)


@pytest.mark.slow
def test_fitted_damping_is_labeled(device):
    figure = compare.plot_laws([L.Impact, L.KuwabaraKono, L.Flores], restitution=[0.5, 1.0], device=device)
    impact, kono, flores = footnotes(figure)[1:]
    assert re.search(r"; damping [\d.]+, 0 N·s/m for e = 0\.5, 1$", impact)
    assert re.search(r"; viscosity [\d.e-]+, 0 s for e = 0\.5, 1$", kono)
    assert " for e = " not in flores
    alone = compare.plot_laws(L.KuwabaraKono, restitution=0.5, device=device)
    assert any(re.fullmatch(r"e = 0\.5: viscosity [\d.e-]+ s", text) for text in texts(alone))


@pytest.mark.slow
def test_plot_labels_include_class_and_source_of_depth(device):
    soft = L.HuntCrossley(stiffness=1.5e6, restitution=0.5)
    figure = compare.plot_laws({"soft": soft, "Hertz": L.Hertz}, device=device)
    note, first, second = footnotes(figure)
    assert note == "sphere of 1 kg on a plate at 1 m/s, undamped penetration 0.003701 m, as for soft"
    assert first.startswith("soft (HuntCrossley): stiffness 1.5e+06")
    assert second.startswith("Hertz: stiffness 1.5e+06")
    other = compare.plot_laws({"soft": soft, "Hertz": L.Hertz}, depth=2e-3, device=device)
    assert footnotes(other)[0].endswith("undamped penetration 0.002 m; for soft as given by the stiffness")
    assert compare.plot_laws({"soft": soft}, device=device).get_suptitle().startswith("soft\xa0(HuntCrossley):")
    skate = compare.plot_friction_models({"skate": F.Elliptic}, device=device)
    assert skate.get_suptitle().startswith("skate\xa0(Elliptic):")


@pytest.mark.slow
def test_plot_uses_one_unit_per_quantity(device):
    # At e = 0.1 the force exceeds 500 N; at 0.6 it does not.
    figure = compare.plot_laws([L.Impact, L.KelvinVoigt], restitution=[0.1, 0.6, 1.0], mass=0.3, device=device)
    labels = {text for text in texts(figure) if re.match(r"(normal force|penetration|time)", text)}
    assert len(labels) == 3, labels


@pytest.mark.slow
@pytest.mark.parametrize("kind", [F.CundallStrack, F.Mindlin])
def test_static_friction_is_marked_if_steady_slip_does_not_show_it(kind, device):
    held = breakaway_coefficients(
        {"given": functools.partial(kind, mu_static=0.6), "Tanh": F.Tanh, "Dahl": F.Dahl}, 10.0, device
    )
    # Load steps grow by 0.5 %, so the last one before sliding may be that much below the limit.
    assert 0.995 * 0.6 < held["given"] <= 0.6 + 1e-9
    assert held["Dahl"] <= 0.4
    assert "Tanh" not in held
    figure = compare.plot_friction_models([kind, F.Tanh, F.LuGre], device=device)
    for title in ("steady slip", "steady slip, logarithmic"):
        (mark,) = [line for line in panels(figure)[title].lines if line.get_linestyle() == "-."]
        np.testing.assert_allclose(mark.get_ydata(), 0.5, rtol=5e-3)
        assert panels(figure)[title].get_ylim()[1] > 0.5
    assert "dash-dotted: breakaway coefficient, the largest in slow slip from rest" in footnotes(figure)
    assert "breakaway: 0.5" in texts(compare.plot_friction_models(kind, device=device))


@pytest.mark.slow
def test_plot_labels_include_slip_direction_and_chosen_values(device):
    figure = compare.plot_friction_models([F.Elliptic, F.Tanh], load=20.0, device=device)
    note, along = footnotes(figure)[:2]
    assert note == "pressed on a plate with 20 N; default values: mu = mu_1 = 0.4, mu_2 = 0.2"
    assert along == "slip is along the x axis of the surface; for Elliptic other directions differ"
    assert {"steady slip along x", "steady slip along x, logarithmic", "oscillating slip along x"} <= set(
        panels(figure)
    )
    plain = compare.plot_friction_models([F.Tanh(mu=0.2), functools.partial(F.Dahl, mu=0.3)], device=device)
    assert footnotes(plain)[0] == "pressed on a plate with 10 N"


def test_invalid_partial_is_refused():
    with pytest.raises(TypeError, match=r"a law must be a class or an instance of wc\.Law"):
        compare.impacts(functools.partial(dict, stiffness=1.0))
    with pytest.raises(TypeError, match="unexpected keyword argument 'stifness'"):
        compare.impacts(functools.partial(L.Hertz, stifness=1.0))
    with pytest.raises(ValueError, match=r"Hertz.stiffness must be greater than 0, got -1 N/m\^1.5"):
        compare.impacts(functools.partial(L.Hertz, stiffness=-1.0))


def test_compare_signatures_are_short():
    for function in (compare.impacts, compare.rebounds, compare.slips, compare.swings, compare.plot_laws):
        assert "numpy" not in str(function.__annotations__)


def test_failed_plot_keeps_existing_file(tmp_path):
    path = tmp_path / "a.svg"
    path.write_text("mine")
    with pytest.raises(ValueError, match="greater than 0"):
        compare.plot_laws(L.Hertz, path, mass=-1)
    assert path.read_text() == "mine"
    with pytest.raises(ValueError, match="greater than 0"):
        compare.plot_laws(L.Hertz, tmp_path / "b.svg", mass=-1)
    assert not (tmp_path / "b.svg").exists()
