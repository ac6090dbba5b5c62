"""Picture of a run without series."""

import numpy as np
import pytest
import xarray as xr

import warpcontact as wc
from warpcontact.experiment import picture
from warpcontact.scene.status import EnvironmentStatus

pytestmark = pytest.mark.installed

ENVS = 50


@pytest.fixture
def outcome():
    """A scalar, a vector, a count, an outcome that is NaN in many environments, and the standard entries."""
    rng = np.random.default_rng(0)
    status = np.full(ENVS, EnvironmentStatus.ACTIVE)
    status[:3] = EnvironmentStatus.FROZEN
    late = np.where(np.arange(ENVS) < 10, np.nan, 1.5)
    return xr.Dataset(
        {
            "peak": ("env", rng.normal(5.0, 1.0, ENVS), {"units": "N", "long_name": "largest force"}),
            "place": (("env", "axis"), np.zeros((ENVS, 3)), {"units": "m"}),
            "hits": ("env", np.arange(ENVS) % 4, {"units": "-"}),
            "late": ("env", late, {"units": "s"}),
            "status": ("env", status),
            "end_time": ("env", np.ones(ENVS), {"units": "s"}),
        }
    )


@pytest.fixture
def drawn(monkeypatch, tmp_path):
    """Draws outcomes; returns the figure."""

    def draw(outcome):
        figures = []
        save = picture.Figure.savefig
        monkeypatch.setattr(
            picture.Figure,
            "savefig",
            lambda self, *to, **how: (figures.append(self), save(self, *to, **how)),
        )
        path = tmp_path / "picture.png"
        assert picture.write_outcome_picture(path, outcome, "study")
        assert path.read_bytes().startswith(b"\x89PNG")
        return figures[0]

    return draw


def counted(axes):
    return [bar.get_height() for bar in axes.patches]


def test_scalar_outcomes_are_plotted_and_frozen_environments_counted(outcome, drawn):
    figure = drawn(outcome)
    assert figure.get_suptitle() == "study: 50 environments, 3 frozen excluded"
    assert [axes.get_title() for axes in figure.axes] == ["peak", "hits", "late"]
    peak, hits, late = figure.axes
    assert peak.get_xlabel() == "largest force [N]"
    assert sum(counted(peak)) == ENVS - 3
    # One bar per integer: 0 to 3 in turn, without the first three.
    assert counted(hits) == [12, 12, 11, 12]
    assert sum(counted(late)) == 40
    assert [text.get_text() for text in late.texts] == ["7 without a finite value"]
    assert not peak.texts


def test_outcome_plot_mentions_no_frozen_environments_if_there_are_none(outcome, drawn):
    outcome["status"][:] = EnvironmentStatus.STOPPED
    assert drawn(outcome).get_suptitle() == "study: 50 environments"


def test_at_most_six_outcomes_are_plotted(outcome, drawn):
    more = outcome.assign({f"peak_{i}": outcome["peak"] for i in range(8)})
    assert [axes.get_title() for axes in drawn(more).axes][:4] == ["peak", "hits", "late", "peak_0"]
    assert len(drawn(more).axes) == 6


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, 3.4e38, -3.7])
def test_constant_outcomes_are_plotted(outcome, drawn, value):
    outcome["peak"][:] = value
    assert sum(counted(drawn(outcome).axes[0])) == (ENVS - 3 if np.isfinite(value) else 0)


def test_outcomes_spanning_float32_are_plotted(outcome, drawn):
    outcome["peak"][3:5] = [-3.4e38, 3.4e38]
    assert sum(counted(drawn(outcome).axes[0])) == ENVS - 3


def test_outcomes_of_only_frozen_environments_are_plotted(outcome, drawn):
    outcome["status"][:] = EnvironmentStatus.FROZEN
    figure = drawn(outcome)
    assert figure.get_suptitle() == "study: 50 environments, 50 frozen excluded"
    assert [text.get_text() for text in figure.axes[0].texts] == ["all are frozen"]


def test_no_plot_is_written_without_scalar_outcomes(outcome, tmp_path):
    path = tmp_path / "picture.png"
    assert not picture.write_outcome_picture(path, outcome[["place", "status", "end_time"]], "study")
    assert not path.exists()


@pytest.mark.smoke
def test_run_without_series_has_a_plot_of_its_outcomes(device, tmp_path):
    fall = {
        "envs": 3,
        "duration": 0.01,
        "dt": 1e-3,
        "body": [{"name": "ball", "mass": 1, "inertia": [1, 1, 1]}],
        "outcome": {"way": {"type": "Change", "of": "ball.position", "component": "z"}},
        "record": {"series": False},
    }
    run = wc.Experiment.from_dict(fall).run(tmp_path / "out", device=device)
    assert run.files["picture"].read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("first", "width", "offset"),
    [(0.0, 3e-9, " (×1e−9)"), (1e9, 1e2, " (+1e9)"), (-1e9, 1e2, " (−1e9)"), (0.0, 5.0, "")],
)
def test_axis_label_includes_scale_and_offset_of_ticks(first, width, offset, outcome, drawn):
    outcome["peak"][:] = first + np.linspace(0.0, width, ENVS)
    axes = drawn(outcome).axes[0]
    assert axes.get_xlabel() == f"largest force [N]{offset}"
    assert not axes.xaxis.offsetText.get_visible()
