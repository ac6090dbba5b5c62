"""Warnings have a level: in Python, on the command line, in run.json and in the report."""

import pickle
from types import SimpleNamespace

import numpy as np
import pytest
from scenes import dropped_sphere

import warpcontact as wc
from warpcontact.experiment.progress import WarningLog
from warpcontact.meshes.report import MeshReport, RepairStep
from warpcontact.stepping.run_warnings import (
    MAX_HARMLESS_RESIDUAL,
    MAX_TOLERABLE_RESIDUAL,
    RunWarnings,
)
from warpcontact.validation.warning_levels import labeled, split_label
from warpcontact.visualize.report import facts

NOTE, CAUTION, ERROR = wc.WarningLevel.NOTE, wc.WarningLevel.CAUTION, wc.WarningLevel.ERROR


@pytest.mark.parametrize("kind", [wc.ContactWarning, wc.RunWarning])
def test_level_survives_label_and_pickle(kind):
    assert kind("text").level == CAUTION
    for level in wc.WarningLevel:
        warning = pickle.loads(pickle.dumps(kind("touch: dt is too long", level)))
        assert (warning.level, str(warning)) == (level, "touch: dt is too long")
        assert split_label(labeled(warning)) == (level, "touch: dt is too long")


@pytest.mark.parametrize("text", ["touch: dt is too long", "no level", "warning: of an earlier version", ""])
def test_text_without_a_level_is_a_caution(text):
    assert split_label(text) == (CAUTION, text)
    assert labeled(UserWarning(text)) == f"caution: {text}"


def test_scene_warnings_have_levels(device):
    model = dropped_sphere(wc.laws.Hooke(stiffness=1e4), height=-1e-3, device=device)
    with pytest.warns(wc.ContactWarning, match="divides no step") as idle:
        sim = wc.Simulation(model, dt=0.01, crossing_substeps=2)
    with pytest.warns(wc.ContactWarning, match="too long") as long:
        sim.step()
    assert [warning.message.level for warning in [*idle, *long]] == [NOTE, CAUTION]


class Solved:
    """A model of two environments whose contact problems were not solved in some steps."""

    first_env, envs = 3, 2
    parts = (SimpleNamespace(force_elements=()),)

    def __init__(self, residual):
        self.unsolved = np.zeros(2, np.int32)
        self.residual = residual

    def health(self):
        return SimpleNamespace(frozen=())

    def failures(self):
        return {}

    def unfinished_solves(self):
        return self.unsolved

    def largest_residuals(self):
        # The first environment has one without a failure.
        return np.array([0.9, self.residual])

    def reset_residuals(self):
        pass


@pytest.mark.parametrize(
    ("residual", "level", "advice"),
    [
        (1e-6, NOTE, "about 0.0001 %. This error is harmless; a larger tolerance"),
        (MAX_HARMLESS_RESIDUAL, NOTE, "about 0.1 %. This error is harmless"),
        (2 * MAX_HARMLESS_RESIDUAL, CAUTION, "about 0.2 %. Use more iterations"),
        (2 * MAX_TOLERABLE_RESIDUAL, ERROR, "about 20 %. Use more iterations"),
    ],
)
def test_missed_tolerance_is_rated_by_the_largest_residual(residual, level, advice):
    model = Solved(residual)
    remarks = RunWarnings(model)
    assert remarks.new() == []
    model.unsolved = np.array([0, 5], np.int32)
    (warning,) = remarks.new()
    assert warning.level == level
    assert "in 1 of 2 environments (most often in environment 4: 5 steps). " in str(warning)
    assert f"The largest residual is {residual:.1e}, in environment 4: " in str(warning)
    assert advice in str(warning)


def test_run_warnings_have_levels():
    messages = []
    notices = WarningLog(messages.append)
    step = RepairStep("merge", 2, 0.0, "2 vertices were joined")
    notices.add_mesh("a.obj", MeshReport("a", repairs=(step,), warnings=("the surface is open",)))
    notices.add(wc.RunWarning("1 of 2 environments turned non-finite", ERROR))
    notices.add(wc.RunWarning("1 of 2 environments turned non-finite", ERROR))
    assert messages == notices.lines
    assert messages == [
        "note: mesh file 'a.obj': 2 vertices were joined",
        "caution: mesh file 'a.obj': the surface is open",
        "error: 1 of 2 environments turned non-finite",
    ]


def test_report_labels_warning_levels_including_earlier_versions():
    summary = {"envs": 1, "warnings": ["error: <b>frozen</b>", "touch: of an earlier version", {"no": "text"}]}
    page = str(facts.notices(summary, SimpleNamespace(state="finished")))
    assert "<b>Error: </b>&lt;b&gt;frozen" in page
    assert "<b>Caution: </b>touch: of an earlier version" in page
    assert page.count("<li>") == 3
