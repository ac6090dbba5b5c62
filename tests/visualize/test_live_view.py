"""The live view without a browser: pages and their inputs, connections, and shutdown."""

import contextlib
import logging
import os
import signal
import socket
import subprocess
import sys
import urllib.request

import numpy as np
import pytest
import sharded_runs
from viewer_helpers import ball_on_ground, make_run, poll_until, viewing, wait_for_thread

import warpcontact as wc
from warpcontact.cli import main
from warpcontact.visualize.viewer import opening

pytestmark = pytest.mark.installed

WEIGHT = 9.81


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Folder of a finished run of ten environments in three shards."""
    return make_run(tmp_path_factory.mktemp("view"))


def place(show):
    """Drawn position of the ball."""
    ball = next(one for one in show.stage._figures if one.name == "touch")
    return np.array(ball.nodes[0].batched_positions[0])


def listens(address, port):
    """Whether a server listens at the address."""
    with socket.socket() as one:
        one.settimeout(5.0)
        return one.connect_ex((address, port)) == 0


@pytest.mark.smoke
def test_run_is_replayed_at_the_selected_time(run):
    recorded = wc.open_run(run).recording["ball.position"]
    with viewing(run) as show:
        assert show.picker.env == 0
        # A page uses single precision, independent of the recording.
        np.testing.assert_array_equal(place(show), recorded.sel(env=0).values[0].astype(np.float32))
        show.time_input.value = 0.1203
        wait_for_thread(show)
        assert show.record == 120
        np.testing.assert_array_equal(place(show), recorded.sel(env=0).values[120].astype(np.float32))
        assert show.time_input.value == recorded["time"].values[120]
        show.post(lambda: show._step_through("Last"))
        wait_for_thread(show)
        assert show.record == recorded.sizes["time"] - 1
        show.post(lambda: show._step_through("On"))
        wait_for_thread(show)
        assert show.record == recorded.sizes["time"] - 1
        assert show.problem == ""


def test_selected_environment_is_shown_at_the_same_time(run):
    recorded = wc.open_run(run)
    with viewing(run) as show:
        show.time_input.value = 0.05
        show.picker.input.value = 7
        wait_for_thread(show)
        assert show.picker.env == 7
        np.testing.assert_array_equal(
            place(show), recorded.recording["ball.position"].sel(env=7).values[50].astype(np.float32)
        )
        mass = float(recorded.params["ball.mass"].sel(env=7))
        assert f"{mass:.6g} kg" in show._facts["Parameters"].content
        assert "ACTIVE" in show._facts["Outcomes"].content
        show.picker.input.value = 10
        wait_for_thread(show)
        assert show.problem == "there is no environment 10; there are 0 to 9"
        assert show.picker.env == 7
        show.post(lambda: show.picker._select("Next"))
        show.post(lambda: show.picker._select("Next"))
        show.post(lambda: show.picker._select("Next"))
        wait_for_thread(show)
        assert show.picker.env == 0
        assert show.problem == ""


def test_playback_stops_at_the_end_and_restarts(run):
    with viewing(run, speed=10.0) as show:
        show.post(show.toggle)
        poll_until(lambda: not show.playing and show.record > 0)
        assert show.record == 200
        assert show.problem == ""
        show.speed_input.value = "0.001"
        show.post(show.toggle)
        wait_for_thread(show)
        assert show.playing
        assert show.record < 100
        show.post(show.toggle)
        wait_for_thread(show)
        assert not show.playing
        show.speed_input.value = "1e9"
        wait_for_thread(show)
        assert show.problem == "the speed must be from 0.001 to 1000, got 1e+09"


@pytest.mark.slow
def test_view_follows_a_running_run(tmp_path):
    path = sharded_runs.study(tmp_path)
    folder = tmp_path / "run"
    words = (path, "--out", folder, "--shard", 4, "--device", "cpu", "--checkpoint", 0)
    code, _, err = sharded_runs.run(*words, first=sharded_runs.kill_at_commit(5))
    assert code == -signal.SIGKILL, err
    frames = sharded_runs.records(folder)[0]["frames"]
    assert 0 < frames < 201
    with viewing(folder) as show:
        assert show.source.envs.tolist() == [0, 1, 2, 3]
        assert len(show._drawing.times) == frames
        assert "stopped" in show._status.content
        show.post(lambda: show._step_through("Last"))
        wait_for_thread(show)
        code, _, err = sharded_runs.run("--resume", "--out", folder)
        assert code == 0, err
        poll_until(lambda: show.source.state == "finished")
        wait_for_thread(show)
        assert show.source.envs.tolist() == list(range(10))
        assert len(show._drawing.times) == 201
        # A page at the last record moves to the new last record.
        assert show.record == 200
        show.picker.input.value = 9
        wait_for_thread(show)
        assert show.picker.env == 9
        assert show.problem == ""


@pytest.mark.slow
def test_view_waits_for_the_first_commit(tmp_path):
    folder = tmp_path / "run"
    path = sharded_runs.study(tmp_path)
    code, _, err = sharded_runs.run(
        path, "--out", folder, "--shard", 4, "--device", "cpu", first=sharded_runs.kill_at_commit(1, "before")
    )
    assert code == -signal.SIGKILL, err
    with viewing(folder) as show:
        assert show.picker.env is None
        assert "no committed data" in show._status.content
        show.post(show.toggle)
        show.post(show._frame_bodies)
        show.post(lambda: show.picker._select("Next"))
        wait_for_thread(show)
        assert show.problem == "there are no environments yet"


def test_failed_environments_are_marked(tmp_path):
    path = sharded_runs.study(tmp_path)
    text = path.read_text().replace("[variation]", "[variation]\n'touch.law.stiffness' = { values = VALUES }")
    values = [1e5] * 10
    values[3] = values[8] = 1e12  # the step is far too long for this stiffness
    path.write_text(text.replace("VALUES", str(values)) + "\n[quarantine]\nmax_speed = 50\n")
    with pytest.warns(RuntimeWarning, match="2 of 10 environments became faster"):
        wc.Experiment.from_toml(path).run(tmp_path / "run", device="cpu", progress=False)
    assert wc.open_run(tmp_path / "run").health.frozen.tolist() == [3, 8]
    with viewing(tmp_path / "run") as show:
        for env in (3, 8, 3):
            show.post(lambda: show.picker._select("Next frozen"))
            wait_for_thread(show)
            assert show.picker.env == env
            assert "TOO_FAST" in show.picker._text.content
            assert "2 frozen" in show.picker._text.content


def test_recording_is_replayed():
    simulation = ball_on_ground()
    recording = simulation.run(0.05, record=["touch.gap", "touch.normal_force", "touch.normal", "touch.point"])
    with viewing(recording) as show:
        show.picker.input.value = 2
        show.gaps_input.value = True
        show.time_input.value = 0.05
        wait_for_thread(show)
        arrows, _ = show.stage._touches[0]
        assert arrows.visible
        start, end = arrows.points[0]
        # The longest arrow is 1.5 times the diameter of the ball, 0.2 m; single precision.
        force = recording["touch.normal_force"].sel(env=2).values
        np.testing.assert_allclose(end - start, [0, 0, 0.3 * force[-1] / force.max()], atol=1e-6)
        ball = next(one for one in show.stage._figures if one.name == "touch")
        red, green, blue = ball.nodes[0].batched_colors[0].tolist()
        assert red > green > blue  # slightly in the ground
        show.forces_input.value = False
        wait_for_thread(show)
        assert not arrows.visible
        assert show.problem == ""
    with pytest.raises(ValueError, match="has no scene"):
        wc.view(recording.isel(env=[0]), port=0, block=False)


def test_simulation_continues_with_a_changed_parameter():
    simulation = ball_on_ground()
    with viewing(simulation) as show:
        show.post(show.toggle)
        poll_until(lambda: simulation.time > 0.3)
        show.post(show.pause)
        wait_for_thread(show)

        def force():
            found = []
            show.post(lambda: found.append(simulation.model.sensor("touch.normal_force")))
            wait_for_thread(show)
            return found[0]

        # It has come to rest: a damped oscillation of 20 periods.
        np.testing.assert_allclose(force(), WEIGHT, rtol=1e-6)
        show.picker.input.value = 1
        wait_for_thread(show)
        show.post(lambda: show.parameters._choose(_label(show, "ball.mass")))
        wait_for_thread(show)
        assert show.parameters.field.value == "1"
        show.parameters.field.value = "3"
        show.post(show.parameters._set_one)
        show.post(show.toggle)
        poll_until(lambda: simulation.time > 0.8)
        show.post(show.pause)
        wait_for_thread(show)
        np.testing.assert_allclose(force(), [WEIGHT, 3 * WEIGHT, WEIGHT], rtol=1e-5)
        assert f"{3 * WEIGHT:.5}"[:4] in show._sensors.content
        assert "environment 1: ball.mass = 3" in show.parameters._result.content
        assert show.problem == ""


def _label(show, name):
    return next(label for label, own in show.parameters._names.items() if own == name)


def test_invalid_value_is_reported_and_the_simulation_continues():
    simulation = ball_on_ground()
    with viewing(simulation) as show:
        show.post(show.toggle)
        show.post(lambda: show.parameters._choose(_label(show, "ball.mass")))
        wait_for_thread(show)
        show.parameters.field.value = "-<b>1"
        show.post(show.parameters._set_one)
        wait_for_thread(show)
        assert show.problem == "ball.mass must be numbers, got '-<b>1'"
        assert "<b>" not in show._problem_text.content
        show.parameters.field.value = "-1"
        show.post(show.parameters._set_one)
        wait_for_thread(show)
        assert show.problem.startswith("ball.mass must be greater than 0")
        before = simulation.time
        poll_until(lambda: simulation.time > before + 0.05)
        assert show.playing
        np.testing.assert_array_equal(simulation.model["ball.mass"], 1.0)


def test_step_and_reset_buttons_affect_the_selection():
    simulation = ball_on_ground()
    with viewing(simulation) as show:
        assert simulation.steps == 0
        for _ in range(3):
            show.post(show._step)
        wait_for_thread(show)
        assert simulation.steps == 3
        assert not show.playing
        first = np.array(simulation.state.body_position.numpy())
        show.picker.input.value = 1
        show.post(lambda: show._reset("This one"))
        wait_for_thread(show)
        now = simulation.state.body_position.numpy()
        np.testing.assert_array_equal(now[[0, 2]], first[[0, 2]])
        assert (now[1] != first[1]).any()
        show.post(lambda: show._reset("All"))
        wait_for_thread(show)
        assert simulation.steps == 0
        np.testing.assert_array_equal(simulation.state.body_position.numpy(), now[[1, 1, 1]])


def test_simulated_time_follows_the_requested_speed():
    simulation = ball_on_ground(1)
    with viewing(simulation, speed=0.01) as show:
        show.post(show.toggle)
        poll_until(lambda: simulation.steps >= 5)
        # Steps of 1 ms at 0.01 of real time take 0.1 s each, and the simulation does not run ahead.
        assert simulation.time < 0.5
        assert show.problem == ""


def test_experiment_is_viewed_with_few_environments(tmp_path):
    path = sharded_runs.study(tmp_path, envs=40)
    with viewing(path) as show:
        model = show.simulation.model
        assert model.envs == opening.ENVS
        assert list(show.parameters.fields) == ["ball.mass", "ball.linear_velocity"]
        np.testing.assert_array_equal(
            model["ball.mass"], wc.Experiment.from_toml(path).model(16, "cpu")["ball.mass"]
        )
        show.parameters.fields["ball.mass"].value = "7"
        show.parameters.fields["ball.linear_velocity"].value = "0, oops, 0"
        show.post(show.parameters._set_all)
        wait_for_thread(show)
        assert show.problem == "ball.linear_velocity must be numbers, got '0, oops, 0'"
        assert model["ball.mass"][0] == 7.0
        assert "touch.gap" in show._sensors.content
    with viewing(path, envs=3) as show:
        assert show.simulation.model.envs == 3


def test_stopped_simulation_states_its_cause(tmp_path):
    path = sharded_runs.study(tmp_path, envs=2)
    path.write_text(path.read_text() + '\n[quarantine]\npolicy = "raise"\nmax_speed = 5\n')
    with viewing(path) as show:
        show.parameters.fields["ball.linear_velocity"].value = "0, 0, 40"
        show.post(show.parameters._set_all)
        show.post(show.toggle)
        poll_until(lambda: show.problem)
        wait_for_thread(show)
        assert "environment 0 failed" in show.problem
        assert "TOO_FAST" in show.problem
        assert not show.playing
        show.post(lambda: show.picker._select("Next frozen"))
        wait_for_thread(show)
        assert show.picker.env == 0


def test_long_names_are_shortened_in_the_view():
    name = "x" * 200
    scene = wc.Scene()
    ground = scene.add_surface(wc.meshes.grid((4.0, 4.0)), name="ground")
    ball = scene.add_body(1.0, (4e-3, 4e-3, 4e-3), position=(0, 0, 0.2), name=name)
    soft = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4))
    scene.add_contact(scene.add_point(ball, (0, 0, 0), name="centre"), ground, soft, radius=0.1, name="touch")
    simulation = wc.Simulation(scene.build(1, "cpu"), dt=1e-3)
    with viewing(simulation) as show:
        show.post(lambda: show.parameters._choose(_label(show, f"{name}.mass")))
        wait_for_thread(show)
        show.parameters.field.value = "bad"
        show.post(show.parameters._set_one)
        wait_for_thread(show)
        assert "must be numbers" in show.problem
        for handle in (show._problem_text, show._sensors, show._status, show.parameters._result):
            assert len(handle.content) < 5_000
        assert max(map(len, show.parameters._names)) < 100


def test_view_starts_from_the_current_state():
    simulation = wc.Simulation(two_on_ground(), dt=1e-3)
    moved = simulation.state.body_position.numpy()
    moved[:, 0, 2] = 5.0
    simulation.state.body_position.assign(moved)
    with viewing(simulation) as show:
        assert not show.playing
        np.testing.assert_array_equal(simulation.state.body_position.numpy(), moved)
        assert (simulation.steps, simulation.time) == (0, 0.0)


def two_on_ground():
    scene = wc.Scene()
    ground = scene.add_surface(wc.meshes.grid((4.0, 4.0)), name="ground")
    ball = scene.add_body(1.0, (4e-3, 4e-3, 4e-3), position=(0, 0, 0.2), name="ball")
    soft = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4))
    scene.add_contact(scene.add_point(ball, (0, 0, 0), name="centre"), ground, soft, radius=0.1, name="touch")
    return scene.build(2, "cpu")


def test_view_server_listens_on_localhost_only(run):
    with viewing(run) as show:
        port = show.server.get_port()
        assert show.server.url == f"http://127.0.0.1:{port}"
        with urllib.request.urlopen(show.server.url) as answer:
            assert answer.status == 200
        # Another address of this machine; a server on all addresses would answer there.
        assert listens("127.0.0.1", port)
        assert not listens("127.0.0.2", port)
        assert show.server.request_share_url() is None
    assert not listens("127.0.0.1", port)


def test_connections_without_request_are_not_logged(run, monkeypatch):
    # Browsers open some connections in advance; other servers of the same library still log them.
    from websockets.exceptions import InvalidMessage

    logger, records = logging.getLogger("websockets.server"), []
    handler = logging.Handler()
    handler.emit = records.append
    # Viser adds a filter there with the first page of a process.
    monkeypatch.setattr(logger, "filters", [])
    monkeypatch.setattr(logger, "handlers", [handler])
    with viewing(run) as show:
        for said in (b"", b"GET", b"no request\r\n\r\n"):
            with socket.create_connection(("127.0.0.1", show.server.get_port()), timeout=5.0) as connection:
                connection.sendall(said)
                connection.shutdown(socket.SHUT_WR)
                while connection.recv(1024):
                    pass
        assert not records
        logger.error("opening handshake failed", exc_info=InvalidMessage("of another"))
        assert len(records) == 1
    assert not logger.filters


def test_connections_from_other_origins_are_refused(run):
    import msgspec
    import viser
    from viser._messages import GuiUpdateMessage
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect

    protocol = f"viser-v{viser.__version__}"
    said = {"type": "GuiUpdateMessage", "uuid": "nobody", "updates": {"value": 1.0}}
    message = msgspec.msgpack.encode(said)
    received = []
    with viewing(run) as show:
        show.server._websock_server.register_handler(GuiUpdateMessage, lambda _, message: received.append(message))
        address, port = show.server.url.replace("http", "ws"), show.server.get_port()

        def talk():
            with connect(address, subprotocols=[protocol], origin="http://example.org", proxy=None) as other:
                # Messages before the rejection are ignored.
                for _ in range(20):
                    other.send(message)
                while True:
                    other.recv(timeout=20)

        with pytest.raises(ConnectionClosed) as caught:
            talk()
        assert not received
        assert caught.value.rcvd.code == 1008
        with connect(
            address, subprotocols=[protocol], origin=f"http://127.0.0.1:{port}", proxy=None, max_size=None
        ) as own:
            assert own.recv(timeout=20)


def test_missing_view_extra_is_reported_with_install_command(run, monkeypatch, capsys):
    monkeypatch.setattr(opening.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ImportError, match=r"pip install 'warpcontact\[view\]'"):
        wc.view(run)
    assert main(["view", str(run)]) == 2
    assert "pip install 'warpcontact[view]'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "expected_error"),
    [
        (["nowhere"], "nowhere"),
        (["--port", "70000"], "--port must be a whole number from 0 to 65535, got 70000"),
        (["--speed", "0"], "--speed must be from 0.001 to 1000, got 0"),
        (["--speed", "nan"], "--speed must be from 0.001 to 1000, got nan"),
        (["--envs", "3"], "--envs applies to experiments only, got 3"),
    ],
)
def test_invalid_view_arguments_are_reported(run, words, expected_error, capsys):
    target = [] if words[0] == "nowhere" else [str(run)]
    assert main(["view", *target, *words, "--no-open"]) == 2
    assert expected_error in capsys.readouterr().err


def test_view_of_a_run_without_series_is_refused(tmp_path, capsys):
    path = sharded_runs.study(tmp_path)
    path.write_text(path.read_text().replace("[record]\n", "[record]\nseries = false\n"))
    wc.Experiment.from_toml(path).run(tmp_path / "run", device="cpu", progress=False)
    assert main(["view", str(tmp_path / "run"), "--no-open", "--port", "0"]) == 2
    assert "the run recorded no series: [record] series = false" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("live", [False, True])
def test_view_command_exits_cleanly_on_interrupt(run, live, tmp_path):
    target = sharded_runs.study(tmp_path) if live else run
    command = [
        sys.executable,
        "-m",
        "warpcontact",
        "view",
        str(target),
        "--no-open",
        "--port",
        "0",
        "--device",
        "cpu",
    ]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ | {"PYTHONWARNINGS": ""}
    )
    try:
        line = process.stdout.readline()
        assert line.startswith("http://127.0.0.1:")
        with urllib.request.urlopen(line.split()[0]) as answer:
            assert answer.status == 200
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
    assert process.returncode == 0, err
    assert out == ""
    assert "Traceback" not in err
