"""Parts of pages of the live view: colors, escaped text, parameter values as text."""

import numpy as np
import pytest
from viewer_helpers import ball_on_ground

import warpcontact as wc
from warpcontact.drawing.colors import GAPS, gap_colors
from warpcontact.drawing.drawing import Shape
from warpcontact.visualize.viewer.page import MAX_NAME_LENGTH, gap_legend, is_own, message, shortened, table
from warpcontact.visualize.viewer.stage import by_color, is_same
from warpcontact.visualize.viewer.values import ParameterText, value_text

HOSTILE = ("<script>alert(1)</script>", '"><img src=x onerror=alert(1)>', "[a](javascript:alert(1))", "🦀\u202e\0")


def test_gap_colors_are_red_in_overlap_pale_in_contact_blue_apart_and_gray_if_unknown():
    inside, touching, away, unknown = gap_colors(np.array([-1.0, 0.0, 10.0, np.nan]), 0.02, 0.5)
    assert inside[0] > 0.65 > 0.2 > inside[1:].max()
    assert touching.min() > 0.95
    assert away[2] > 0.65 > 0.15 > away[0]
    assert len(set(unknown.tolist())) == 1
    # Colors are continuous: a step of 1/1000 of the range is invisible.
    along = gap_colors(np.linspace(-0.1, 1.0, 20_000), 0.02, 0.5)
    assert np.abs(np.diff(along, axis=0)).max() <= 2 / 255


def test_gap_legend_has_its_colors_and_ends():
    legend = gap_legend(0.004, 0.2)
    assert all(f"rgb{color}" in legend for _, color in GAPS)
    assert "−0.004 m" in legend
    assert "0.2 m" in legend


def test_multicolored_shape_is_drawn_with_all_faces():
    mesh = wc.meshes.grid((1.0, 1.0), (3, 2))
    red, blue = np.array([1.0, 0, 0]), np.array([0, 0, 1.0])
    colors = np.where(np.arange(len(mesh.faces))[:, None] < 5, red, blue)
    parts = list(by_color(Shape(mesh.vertices, mesh.faces, colors), np.zeros(3)))
    assert sorted(color.tolist() for _, _, color in parts) == [blue.tolist(), red.tolist()]
    drawn = {tuple(map(tuple, vertices[face])) for vertices, faces, _ in parts for face in faces}
    assert drawn == {tuple(map(tuple, mesh.vertices[face])) for face in mesh.faces}
    assert {len(faces) for _, faces, _ in parts} == {5, len(mesh.faces) - 5}


def test_shapes_are_compared_by_their_geometry_and_colors():
    mesh = wc.meshes.icosphere(1.0, 1)
    shape = Shape(mesh.vertices, mesh.faces)
    assert is_same(shape, Shape(mesh.vertices.copy(), mesh.faces.copy()))
    assert not is_same(shape, Shape(1.001 * mesh.vertices, mesh.faces))
    assert not is_same(shape, Shape(mesh.vertices, mesh.faces, normals=mesh.vertices))
    assert not is_same(shape, Shape(mesh.vertices, mesh.faces, np.zeros((len(mesh.faces), 3))))


@pytest.mark.parametrize("text", HOSTILE)
def test_page_text_is_escaped(text):
    for written in (table([(text, text)]), message(text), message(text, is_error=True)):
        assert "<script" not in written
        assert "<img" not in written
        assert written.count("<") == written.count(">")


def test_long_text_is_truncated():
    long = "<b>" * 4000
    assert len(shortened(long)) == MAX_NAME_LENGTH
    assert len(table([(long, long)])) < 1500
    assert shortened("a\n b\tc") == "a b c"


def test_only_connections_of_the_page_itself_are_accepted():
    assert is_own("127.0.0.1:8080", "http://127.0.0.1:8080")
    assert is_own("localhost:9000", "http://localhost:9000")  # through a tunnel of the user
    assert is_own("127.0.0.1:8080", None)  # not a browser
    assert not is_own("127.0.0.1:8080", "http://example.org")
    assert not is_own("127.0.0.1:8080", "https://127.0.0.1:8080.example.org")
    assert not is_own("127.0.0.1:8080", "http://127.0.0.1:9090")
    assert not is_own("127.0.0.1:8080", "null")
    # A foreign domain name that resolves to this machine.
    assert not is_own("example.org:8080", "http://example.org:8080")
    assert not is_own(None, None)


def test_values_are_formatted_as_text():
    assert value_text(0.1) == "0.1"
    assert value_text(np.array([1.0, 2.5, -3e-7])) == "1, 2.5, -3e-07"
    assert value_text(np.arange(100.0)) == "100 numbers, 0 to 99"
    assert value_text(np.array([np.nan] * 20)) == "20 numbers"
    assert value_text(np.int32(1), {"flag_values": [0, 1], "flag_meanings": "OPEN CONTACT"}) == "CONTACT"


def test_parameter_text_sets_one_environment_only():
    model = ball_on_ground().model
    mass = ParameterText(model, "ball.mass")
    before = model["ball.mass"].copy()
    assert mass.read(1) == "1"
    mass.write(1, " 2.5e0 ")
    assert mass.read(1) == "2.5"
    np.testing.assert_array_equal(model["ball.mass"], [before[0], 2.5, before[2]])
    place = ParameterText(model, "ball.position")
    place.write(2, "0.1, -0.2; 0.3")
    assert place.read(2) == "0.1, -0.2, 0.3"
    np.testing.assert_array_equal(model["ball.position"][:2], [[0, 0, 0.0999]] * 2)
    assert place.is_initial
    assert not mass.is_initial


def test_inertia_text_is_a_diagonal_or_a_full_tensor():
    # three environments: the shape of one tensor equals that of a diagonal per environment
    model = ball_on_ground().model
    inertia = ParameterText(model, "ball.inertia")
    inertia.write(0, "1e-3 2e-3 2.5e-3")
    np.testing.assert_array_equal(model["ball.inertia"][0], np.diag([1e-3, 2e-3, 2.5e-3]))
    assert inertia.read(0) == "0.001, 0.002, 0.0025"
    inertia.write(1, "2e-3 1e-4 0  1e-4 2e-3 0  0 0 2e-3")
    assert model["ball.inertia"][1, 0, 1] == 1e-4
    assert inertia.read(1).count(",") == 8


def test_parameter_text_round_trips():
    model = ball_on_ground().model
    value = 1.0 / 3.0 + 2.0**-50
    model["ball.mass"] = value
    mass = ParameterText(model, "ball.mass")
    mass.write(0, mass.read(0))
    assert model["ball.mass"][0] == value


@pytest.mark.parametrize(
    ("text", "expected_error"),
    [
        ("heavy", "ball.mass must be numbers, got 'heavy'"),
        ("", "ball.mass must be 1 number, got 0"),
        ("1 2", "ball.mass must be 1 number, got 2"),
        ("-1", "ball.mass must be greater than 0"),
        ("nan", "ball.mass"),
        ("<b>" * 4000, "ball.mass must be numbers"),
    ],
)
def test_invalid_parameter_text_is_refused_without_changes(text, expected_error):
    model = ball_on_ground().model
    with pytest.raises(ValueError, match=expected_error.replace("(", r"\(")) as caught:
        ParameterText(model, "ball.mass").write(1, text)
    assert len(str(caught.value)) < 300
    np.testing.assert_array_equal(model["ball.mass"], [1.0, 1.0, 1.0])


def test_items_of_a_set_are_edited_individually_or_together():
    scene = wc.Scene()
    body = scene.add_body(1.0, (1.0, 1.0, 1.0), name="body")
    scene.add_points(body, np.eye(3), name="feet")
    model = scene.build(3, "cpu", "float64")
    feet = ParameterText(model, "feet.position")
    assert feet.is_set
    assert feet.read(0) == ""
    assert feet.read(0, 1) == "0, 1, 0"
    feet.write(0, "0 2 0", 1)
    np.testing.assert_array_equal(model["feet.position"][0], [[1, 0, 0], [0, 2, 0], [0, 0, 1]])
    np.testing.assert_array_equal(model["feet.position"][1:], [np.eye(3)] * 2)
    feet.write(0, "1 1 1")
    assert feet.read(0) == "1, 1, 1"
    with pytest.raises(ValueError, match=r"feet\.position has items 0 to 2, got 3"):
        feet.write(0, "1 1 1", 3)
