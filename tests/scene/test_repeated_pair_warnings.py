"""Pairs of solids that several body contacts have: a build warns of them."""

import warnings

import numpy as np
import pytest

import warpcontact as wc

SOFT = wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=1e7))
EDGE = 0.1  # m


def boxes_on_floor(count):
    """Returns a scene, its bodies 0.1 mm inside a half-space, and the half-space."""
    scene = wc.Scene(gravity=(0, 0, 0))
    floor = scene.add_shape(None, wc.shapes.Plane(), name="floor")
    bodies = []
    for i in range(count):
        body = scene.add_body(1.0, (1e-3,) * 3, position=(i, 0, EDGE / 2 - 1e-4), name=f"body_{i}")
        scene.add_shape(body, wc.shapes.RoundedBox((EDGE / 2,) * 3), name=f"box_{i}")
        bodies.append(body)
    return scene, bodies, floor


def built(scene):
    """Returns the model of a scene, and the messages of the warnings of its build."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        model = scene.build(envs=1, device="cpu", precision="float64")
    assert all(one.category is wc.ContactWarning for one in caught)
    assert all(one.filename == __file__ for one in caught)
    return model, [str(one.message) for one in caught]


def test_pair_of_two_body_contacts_is_warned_of_and_its_forces_add_up():
    scene, (box,), floor = boxes_on_floor(1)
    scene.add_body_contact(box, floor, SOFT, name="once")
    scene.add_body_contact([floor, box], SOFT, name="again")
    model, (text,) = built(scene)
    assert text.startswith(
        "body contacts 'once' and 'again' have the same pair 'box_0' and 'floor'. Each contact acts"
    )
    for remedy in ("Remove one", "exclude=", "table of materials"):
        assert remedy in text
    # k A δ, of each contact.
    np.testing.assert_allclose(model.sensor("body_0.force")[0], [0, 0, 2 * 1e7 * EDGE**2 * 1e-4], rtol=1e-9)


def test_warning_names_the_first_contacts_with_common_pairs_and_counts_the_others():
    scene, boxes, floor = boxes_on_floor(3)
    scene.add_body_contact([*boxes, floor], SOFT, name="all")
    scene.add_body_contact(boxes, floor, SOFT, name="feet")
    for i in range(3):
        scene.add_body_contact(boxes[i], floor, SOFT, name=f"foot_{i}")
    _, (text,) = built(scene)
    pairs = text.partition(". ")[0].split("; ")
    assert pairs[0].endswith("'all' and 'feet' have the same pair 'box_0' and 'floor', and 2 more")
    assert pairs[1].endswith("'all' and 'foot_0' have the same pair 'box_0' and 'floor'")
    # Three contacts of single boxes share a pair with each of the two others.
    assert pairs[3] == "and 4 more"


@pytest.mark.parametrize("remedy", ["exclude", "disabled", "other pairs", "same list"])
def test_pairs_of_one_enabled_body_contact_are_not_warned_of(remedy):
    scene, (first, second), floor = boxes_on_floor(2)
    scene.add_body_contact(first, floor, SOFT, name="once")
    if remedy == "exclude":
        scene.add_body_contact([first, second, floor], SOFT, exclude=[(first, floor)], name="rest")
    elif remedy == "disabled":
        scene.add_body_contact([first, second], floor, SOFT, enabled=False, name="rest")
    elif remedy == "other pairs":
        scene.add_body_contact([first, second], SOFT, name="among")
        scene.add_body_contact(second, floor, SOFT, name="rest")
    else:
        scene.add_body_contact([second, second], [floor, floor], SOFT, name="rest")
    model, texts = built(scene)
    assert texts == []
    np.testing.assert_allclose(model.sensor("body_0.force")[0], [0, 0, 1e7 * EDGE**2 * 1e-4], rtol=1e-9)
