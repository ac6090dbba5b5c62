"""Body contacts in experiment files: keys, errors, recording."""

import numpy as np
import pytest

import warpcontact as wc

STUDY = {
    "envs": 2,
    "duration": 0.02,
    "dt": 1e-3,
    "gravity": [0.0, 0.0, 0.0],
    "body": [{"name": "crate", "mass": 1.0, "inertia": [0.01] * 3, "position": [0.0, 0.0, 0.099]}],
    "shape": [
        {"name": "box", "body": "crate", "form": {"type": "RoundedBox", "half_extents": [0.1, 0.1, 0.1]}},
        {"name": "floor", "form": {"type": "Plane"}},
    ],
    "material": [{"name": "soft", "law": {"type": "ElasticFoundation", "stiffness": 1e4}}],
    "body_contact": [{"name": "press", "first": "crate", "second": ["floor"], "material": "soft"}],
    "variation": {"press.law.stiffness": {"values": [1e4, 2e4]}},
    "record": {"every": 0.01, "sensors": ["press.force", "press.area", "press.center"]},
}


def test_body_contact_of_an_experiment_is_varied_recorded_and_stored(tmp_path, device):
    run = wc.Experiment.from_dict(STUDY).run(tmp_path / "out", device=device)
    force = run.recording["press.force"].values[0]
    # k A δ, with 1 mm on a square of 0.2 m.
    np.testing.assert_allclose(force, [[0, 0, 0.4], [0, 0, 0.8]], rtol=1e-4, atol=1e-5)


def test_body_contact_without_second_is_that_of_each_solid_with_each_other_one():
    entry = {key: value for key, value in STUDY["body_contact"][0].items() if key != "second"}
    experiment = wc.Experiment.from_dict(STUDY | {"body_contact": [entry | {"first": ["floor", "crate"]}]})
    (contact,) = experiment.scene().body_contacts
    assert [(one.name, other.name) for one, other in contact.pairs] == [("box", "floor")]


def table_study(**changes):
    """Returns a study with a table of materials, and boxes of two physics materials."""
    shapes = [
        STUDY["shape"][0] | {"physics_material": "steel"},
        STUDY["shape"][1] | {"physics_material": "rubber"},
    ]
    materials = [*STUDY["material"], {"name": "stiff", "law": {"type": "ElasticFoundation", "stiffness": 1e6}}]
    entry = STUDY["body_contact"][0] | {
        "material": [{"pair": ["rubber", "steel"], "material": "stiff"}, {"material": "soft"}]
    }
    return STUDY | {"shape": shapes, "material": materials, "body_contact": [entry | changes]}


def test_body_contact_of_an_experiment_has_a_table_of_materials():
    (contact,) = wc.Experiment.from_dict(table_study()).scene().body_contacts
    assert contact.materials[0].law.stiffness == 1e6
    entry = table_study()["body_contact"][0] | {"first": ["floor", "crate"], "exclude": [[["crate"], ["box"]]]}
    del entry["second"]
    (contact,) = wc.Experiment.from_dict(table_study() | {"body_contact": [entry]}).scene().body_contacts
    assert contact.count == 1


@pytest.mark.parametrize(
    ("material", "message"),
    [
        (
            [{"pair": ["rubber", "steel"], "material": "stif"}],
            r"body_contact\[0\].*material\[0\]\.material.*'stif'",
        ),
        ([{"pair": ["rubber"], "material": "stiff"}], "pair must be two names of physics materials"),
        ([{"pair": ["rubber", "rubber"], "material": "stiff"}], r"no entry for the pair \('rubber', 'steel'\)"),
        (
            [{"material": "soft"}, {"material": "stiff"}],
            r"material\[1\]: there is an entry of all other pairs before",
        ),
        ([], "must have an entry that is a wc.ContactMaterial"),
    ],
)
def test_invalid_table_of_materials_of_an_experiment_is_refused(material, message):
    with pytest.raises(wc.ExperimentError, match=message):
        wc.Experiment.from_dict(table_study(material=material))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"first": "crat"}, r"body_contact\[0\].*first.*'crate'"),
        ({"second": ["floor", "flor"]}, r"body_contact\[0\].*second.1..*'floor'"),
        ({"reference": "third"}, "reference"),
        ({"exclude": [["box", "flor"]]}, r"body_contact\[0\].*exclude.0..1..*'floor'"),
        ({"exclude": [["box", "floor"]]}, "exclude, groups and masks leave no pair"),
        ({"first": "floor", "second": "crate"}, "half-space, which must be second"),
    ],
)
def test_invalid_body_contact_of_an_experiment_is_refused(changes, message):
    study = STUDY | {"body_contact": [STUDY["body_contact"][0] | changes]}
    with pytest.raises(wc.ExperimentError, match=message):
        wc.Experiment.from_dict(study)
