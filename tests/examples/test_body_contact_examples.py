"""The examples of body contact agree with statics."""

import pytest
from example_files import load

import warpcontact as wc

pytestmark = pytest.mark.installed


@pytest.mark.parametrize("seconds", [0.5, pytest.param(60.0, marks=pytest.mark.slow)])
def test_resting_bodies_example_agrees_with_statics(seconds, device, tmp_path, capsys):
    animation = tmp_path / "hammers.usdc"
    result = load("resting_bodies").main(["--seconds", str(seconds), "--device", device, "--usd", str(animation)])
    assert "falls" in capsys.readouterr().out
    assert wc.check_usd(animation) == []
    stack, nut, hammers = result["stack"], result["nut"], result["hammers"]
    assert stack["drift"] < 1e-6
    assert max(stack["speed"], stack["spin"]) < 1e-6
    # Depths of 10 to 100 µm and forces in float32.
    assert stack["height"] < 1e-9
    assert stack["reaction"] < 1e-6
    assert max(abs(error) for error in nut.values()) < 1e-6
    assert hammers["right"] == 1.0
    # The longest slide ends 2.4 mm before the edge, on a fraction of the area that sinks by 0.1 mm.
    assert hammers["slide"] < 2e-4


@pytest.mark.parametrize("shaking", [1.0, pytest.param(10.0, marks=pytest.mark.slow)])
def test_gripper_example_holds_the_part_above_the_required_friction_only(shaking, device, tmp_path):
    animation = tmp_path / "gripper.usdc"
    example = load("gripper")
    result = example.main(["--shaking", str(shaking), "--device", device, "--usd", str(animation)])
    assert wc.check_usd(animation) == []
    assert abs(result["grip_force"]).max() < 1e-6
    # The deflection of the tangential springs of two pads under the acceleration on the circle, both ways.
    radius, rate = example.RADIUS, 2 * 3.14159265 * example.FREQUENCY
    deflection = example.MASS * radius * rate**2 / (2 * example.STICK_STIFFNESS)
    assert (result["slip"][1:] < 2.1 * deflection).all()
    assert result["slip"][0] > 20 * deflection
    assert (result["place"][1:] < 1e-4).all()
    assert abs(result["weight"][1:]).max() < 1e-5


def test_brick_wall_example_carries_its_weight_and_loses_energy(device):
    result = load("brick_wall").main(["--columns", "2", "--rows", "3", "--duration", "0.7", "--device", device])
    # After 0.5 s the vibration from the start has decayed to a ten thousandth of the weight.
    assert result["supports"] < 1e-3
    assert result["lost"] > 0
    # Elastic energy is not included, some ½ N² / (k A) = 0.1 J of the impact of the ball.
    assert result["gain"] < 0.5


@pytest.mark.parametrize("parts", [4, pytest.param(27, marks=pytest.mark.slow)])
def test_hopper_of_parts_example_discharges_all_parts(parts, device):
    example = load("hopper_of_parts")
    result = example.main(["--parts", str(parts), "--device", device])
    assert result["left"] == result["through_mouth"] == 1.0
    # A speed of 1 cm/s is that of a fall by 5 µm.
    assert result["speed"] < 0.01
    # The mean force is the weight, and the largest change of momentum in the time of the mean.
    change = 2 * result["speed"] / (example.GRAVITY * example.WINDOW * example.FRAME)
    assert abs(result["closed"] - 1.0) < change
    assert abs(result["open"] - 1.0) < change
