"""Stills and films of runs and recordings, in Python and on the command line."""

import json
import re
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import warpcontact as wc
from warpcontact.cli import main
from warpcontact.experiment import plan, shards
from warpcontact.experiment.store import Ledger
from warpcontact.visualize.rendering import pictures, writers
from warpcontact.visualize.rendering.pictures import Source

pytestmark = pytest.mark.installed

SMALL = {"size": (64, 48), "samples": 1}
STUDY = {
    "name": "drop",
    "envs": 3,
    "duration": 0.2,
    "dt": 1e-3,
    "surface": [{"name": "ground", "mesh": {"shape": "grid", "size": [4.0, 4.0]}}],
    "body": [{"name": "ball", "mass": 1.0, "inertia": [4e-3] * 3, "position": [0.0, 0.0, 0.15]}],
    "point": [{"name": "centre", "body": "ball", "position": [0.0, 0.0, 0.0]}],
    "material": [{"name": "rubber", "law": {"type": "HuntCrossley", "stiffness": 1e5, "restitution": 0.7}}],
    "contact": [{"name": "touch", "points": "centre", "surface": "ground", "material": "rubber", "radius": 0.1}],
    "variation": {"ball.mass": {"values": [0.5, 1.0, 2.0]}},
    "record": {"every": 0.01, "sensors": ["touch.normal_force", "touch.normal", "touch.point"]},
    "output": {"usd_envs": 0},
}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "drop"
    return wc.Experiment.from_dict(STUDY).run(folder, device="cpu")


def command(run, *words):
    return main(["render", str(run.folder), *map(str, words), "--size", "64x48", "--samples", "1"])


@pytest.mark.smoke
def test_rendered_still_equals_returned_picture(run, tmp_path):
    picture = wc.render(run, tmp_path / "a.png", env=2, time=0.1, **SMALL)
    assert picture.shape == (48, 64, 3)
    assert picture.dtype == np.uint8
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "a.png")), picture)
    # Equal from the run and from its recording, in any file format.
    np.testing.assert_array_equal(wc.render(run.recording, env=2, time=0.1, **SMALL), picture)
    assert wc.render(run, tmp_path / "b.png", env=2, time=0.1, **SMALL) is not None
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    # Default: the last record of the first environment.
    np.testing.assert_array_equal(wc.render(run, **SMALL), wc.render(run, env=[0], time=0.2, **SMALL))
    assert (wc.render(run, time=0.0, **SMALL) != picture).any()


def test_stills_at_different_times_have_the_same_camera(run):
    style = {**SMALL, "samples": 4, "forces": False}
    early, late = (wc.render(run, time=time, **style).astype(int) for time in (0.0, 0.13))
    same = (early == late).all(axis=-1)
    # Except for the ball and its shadow.
    assert 0.3 < same.mean() < 0.999


def test_recording_without_scene_requires_scene_argument(run):
    part = run.recording.isel(time=slice(0, 3))
    with pytest.raises(ValueError, match="has no scene"):
        wc.render(part, **SMALL)
    assert wc.render(part, scene=run.scene, **SMALL).any()


def test_nearest_record_is_rendered(run):
    source = Source.of(run, None)
    np.testing.assert_array_equal(source.nearest(np.array([0.0, 0.0149, 0.0151, 0.2])), [0, 1, 2, 20])
    for wrong in (-0.01, 0.21, float("nan")):
        with pytest.raises(ValueError, match=r"time must be within the recording, 0 to 0\.2 s, got"):
            source.nearest(np.array(wrong))


@pytest.fixture(scope="module")
def part(run, tmp_path_factory):
    """The run when one of three shards is finished, one has eight records, and one has none."""
    folder = tmp_path_factory.mktemp("runs") / "part"

    def stopping(self, shard, record, staged):
        commit(self, shard, record, staged)
        if shard.number == 1 and record.steps >= 70:
            raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch:
        commit = Ledger.commit
        patch.setattr(Ledger, "commit", stopping)
        patch.setattr(plan, "BLOCK", 1)
        patch.setattr(shards, "CHECKPOINT_SHARE", 1e9)
        with pytest.raises(KeyboardInterrupt):
            wc.Experiment.from_dict(STUDY).run(folder, device="cpu", shard=1, checkpoint=0.0)
    return wc.open_run(folder)


def test_last_record_of_an_unfinished_run_is_rendered(run, part, tmp_path, capsys):
    assert command(part, "-o", tmp_path / "a.png", "--env", 1) == 0
    expected_output = "environment 1 at 0.07 s, the last frame of a run that is not finished"
    assert capsys.readouterr().out == f"{expected_output}: {tmp_path / 'a.png'}\n"
    assert command(part, "-o", tmp_path / "b.png", "--env", 0, 1) == 0
    assert "environments 0, 1 at 0.07 s, the last frame of" in capsys.readouterr().out
    assert command(part, "-o", tmp_path / "c.gif", "--env", 1) == 0
    assert "0 to 0.04 s in 2 pictures, 0.08 s long, of a run that is not finished: " in capsys.readouterr().out
    # Finished environments are shown as in the complete run.
    assert command(part, "-o", tmp_path / "d.png") == 0
    assert capsys.readouterr().out == f"environment 0 at 0.2 s: {tmp_path / 'd.png'}\n"
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "d.png")), wc.render(run, **SMALL))
    assert command(part, "-o", tmp_path / "e.png", "--env", 1, "--time", 0.05) == 0
    assert capsys.readouterr().out == f"environment 1 at 0.05 s: {tmp_path / 'e.png'}\n"
    with pytest.raises(ValueError, match=r"time must be within the recording, 0 to 0\.07 s, got 0\.1"):
        wc.render(part, env=1, time=0.1, **SMALL)
    assert command(part, "-o", tmp_path / "f.png", "--env", 2) == 2
    resume = f"to resume: warpcontact run --resume --out {part.folder}"
    expected_error = f"environment 2 has no frame yet in this run: it has not started; {resume}"
    assert expected_error in capsys.readouterr().err
    assert command(part, "-o", tmp_path / "f.png", "--env", 3) == 2
    assert "environment 3 is not in the recording, which has 0 to 1" in capsys.readouterr().err


def test_environment_without_records_is_reported(part, monkeypatch):
    monkeypatch.setitem(part._commits, 1, replace(part._commits[1], frames=0))
    expected_error = (
        "environment 1 has no frame yet in this run that can be read: its shard is at step 70 of 200, and "
        "frames are written in blocks of 1, those after the last block are stored in checkpoints and can be read as "
        f"the run continues; to resume: warpcontact run --resume --out {part.folder}"
    )
    with pytest.raises(ValueError, match=f"^{re.escape(expected_error)}$"):
        wc.render(part, env=1, **SMALL)
    # By default, environments with records are shown.
    monkeypatch.setitem(part._commits, 0, replace(part._commits[0], frames=0))
    monkeypatch.setitem(part._commits, 1, replace(part._commits[1], frames=3))
    assert Source.of(part, None).envs == [1]


def test_unused_sensors_are_not_read_for_rendering(tmp_path):
    study = STUDY | {"record": {"every": 0.01, "sensors": [*STUDY["record"]["sensors"], "ball.kinetic_energy"]}}
    folder = tmp_path / "run"
    whole = wc.render(wc.Experiment.from_dict(study).run(folder, device="cpu"), time=0.1, **SMALL)
    for name, is_drawn in (("ball.kinetic_energy", False), ("touch.point", True)):
        for path in (folder / "data.zarr/series" / name / "c").rglob("*"):
            if path.is_file():
                path.write_bytes(path.read_bytes()[:-1] + b"x")  # the checksum is compared when it is read
        if is_drawn:
            with pytest.raises(wc.RunDataError):
                wc.render(wc.open_run(folder), time=0.1, **SMALL)
        else:
            np.testing.assert_array_equal(wc.render(wc.open_run(folder), time=0.1, **SMALL), whole)


@pytest.mark.smoke
def test_render_command_prints_environment_time_and_file(run, tmp_path, capsys):
    assert command(run, "-o", tmp_path / "a.png", "--env", 1, "--time", 0.1) == 0
    assert capsys.readouterr().out == f"environment 1 at 0.1 s: {tmp_path / 'a.png'}\n"
    assert command(run, "-o", tmp_path / "b.png", "--envs", 0, 2, "--time", 0.103, "--together") == 0
    expected_output = capsys.readouterr().out
    assert expected_output == f"environments 0, 2 at 0.1 s, the frame nearest to 0.103 s: {tmp_path / 'b.png'}\n"
    expected = wc.render(run, env=1, time=0.1, **SMALL)
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "a.png")), expected)


def test_color_by_shows_the_value_of_each_environment(run):
    plain = wc.render(run, env=range(3), together=True, **SMALL)
    colored = wc.render(run, env=range(3), color_by="ball.mass", labels=False, **SMALL)
    assert (plain != colored).any()
    refused = r"color_by must be one number for each environment, got "
    with pytest.raises(ValueError, match=refused + r"'mass'; did you mean 'ball\.mass'\?"):
        wc.render(run, env=range(3), color_by="mass", **SMALL)
    with pytest.raises(ValueError, match=refused + r"'humidity'; there are: .*ball\.mass"):
        wc.render(run, env=range(3), color_by="humidity", **SMALL)


def test_gif_duration_equals_simulated_time_over_speed(run, tmp_path, capsys):
    assert command(run, "-o", tmp_path / "a.gif", "--fps", 30, "--speed", 0.2) == 0
    # 0.2 s five times slower: 1 s, with 31 pictures.
    assert "0 to 0.2 s in 31 pictures, 1.03 s long" in capsys.readouterr().out
    durations = []
    with Image.open(tmp_path / "a.gif") as image:
        for frame in range(image.n_frames):
            image.seek(frame)
            durations.append(image.info["duration"])
        assert image.info["loop"] == 0
        assert image.size == (64, 48)
    # Records 10 ms apart are shown for 50 ms: equal consecutive pictures are merged into one of longer duration.
    assert sum(durations) == 1030
    assert 5 < len(durations) <= 21


def test_gif_frames_are_written_incrementally(tmp_path):
    """Changes in one corner, no change, and changes everywhere; in colors of the palette."""
    colors = np.random.default_rng(0).integers(0, 64, (100, 3), dtype=np.uint8) * 4
    numbers = np.random.default_rng(1).integers(0, 100, (40, 96, 128))
    numbers[1:4] = numbers[0]
    numbers[2:4, 90:, 120:] += 1
    expected = colors[numbers % 100]
    sizes = []

    def pictures():
        for picture in expected:
            sizes.append((tmp_path / "a.gif.partial").stat().st_size)
            yield picture

    writers.write_gif(tmp_path / "a.gif", pictures(), 40, 25.0, [expected[0]])
    # Except for the current frame and the write buffer.
    assert sizes[-1] > 0.9 * (tmp_path / "a.gif").stat().st_size
    with Image.open(tmp_path / "a.gif") as image:
        assert (image.n_frames, image.info["loop"]) == (38, 0)
        waits, shown = [], []
        for number in range(38):
            image.seek(number)
            waits.append(image.info["duration"])
            shown.append(np.asarray(image.convert("RGB")).astype(int))
    assert waits == [80, 80, *[40] * 36]
    distinct = expected[[0, 2, *range(4, 40)]]
    assert np.abs(np.array(shown) - distinct).max() <= 8  # replaced by the nearest palette color


@pytest.mark.parametrize(("count", "fps"), [(80, 0.1), (1, 1 / 800)])
def test_gif_of_long_standstill_has_correct_duration(count, fps, tmp_path):
    picture = np.full((32, 48, 3), 100, dtype=np.uint8)
    writers.write_gif(tmp_path / "a.gif", [picture] * count, count, fps, [picture])
    with Image.open(tmp_path / "a.gif") as image:
        waits = []
        for number in range(image.n_frames):
            image.seek(number)
            waits.append(image.info["duration"])
            np.testing.assert_allclose(np.asarray(image.convert("RGB")), 100, atol=4)
    assert sum(waits) == 800_000
    assert len(waits) == 2


def test_gif_frames_show_the_records(run, tmp_path):
    film = wc.film(run, tmp_path / "a.gif", fps=25.0, speed=0.25, env=1, progress=False, labels=False, **SMALL)
    np.testing.assert_allclose(film.times, np.arange(21) * 0.01)
    assert film.duration == pytest.approx(0.84)
    with Image.open(tmp_path / "a.gif") as image:
        image.seek(image.n_frames - 1)
        last = np.asarray(image.convert("RGB")).astype(int)
    expected = wc.render(run, env=1, time=0.2, labels=False, **SMALL).astype(int)
    # 255 colors for the whole film.
    assert np.abs(last - expected).mean() < 4.0
    again = tmp_path / "b.gif"
    wc.film(run, again, fps=25.0, speed=0.25, env=1, progress=False, labels=False, **SMALL)
    assert again.read_bytes() == (tmp_path / "a.gif").read_bytes()


@pytest.mark.skipif(not (shutil.which("ffmpeg") and shutil.which("ffprobe")), reason="needs ffmpeg and ffprobe")
def test_mp4_uses_a_codec_that_browsers_play(run, tmp_path, capsys):
    assert command(run, "-o", tmp_path / "a.mp4", "--time", 0.05, 0.15, "--fps", 20, "--speed", 0.1) == 0
    assert "0.05 to 0.15 s in 21 pictures, 1.05 s long" in capsys.readouterr().out
    expected_output = subprocess.run(
        ["ffprobe", "-v", "error", "-count_frames", "-show_streams", "-of", "json", str(tmp_path / "a.mp4")],
        capture_output=True,
        check=True,
    ).stdout
    (stream,) = json.loads(expected_output)["streams"]
    assert (stream["codec_name"], stream["pix_fmt"]) == ("h264", "yuv420p")
    assert (stream["width"], stream["height"]) == (64, 48)
    assert int(stream["nb_read_frames"]) == 21
    assert float(stream["duration"]) == pytest.approx(1.05)
    raw = subprocess.run(
        ["ffmpeg", "-v", "error", "-i", str(tmp_path / "a.mp4"), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"],
        capture_output=True,
        check=True,
    ).stdout
    first = np.frombuffer(raw, dtype=np.uint8)[: 48 * 64 * 3].reshape(48, 64, 3).astype(int)
    expected = wc.render(run, time=0.05, labels=False, **SMALL).astype(int)
    # Colors survive H.264, except for its losses; the label covers little.
    assert np.median(np.abs(first - expected)) <= 4


def test_missing_ffmpeg_error_names_alternatives(run, tmp_path, monkeypatch):
    monkeypatch.setattr(writers.shutil, "which", lambda name: None)
    with pytest.raises(
        ValueError, match=r"a\.mp4: an \.mp4 file needs ffmpeg, which is not on the PATH; use a \.gif file"
    ):
        wc.film(run, tmp_path / "a.mp4", progress=False, **SMALL)
    assert not list(tmp_path.iterdir())


def test_ffmpeg_failure_is_reported_and_leaves_no_file(run, tmp_path, monkeypatch):
    program = tmp_path / "bin" / "ffmpeg"
    program.parent.mkdir()
    program.write_text("#!/bin/sh\necho 'Unknown encoder libx264' >&2\nexit 1\n")
    program.chmod(0o755)
    monkeypatch.setattr(writers.shutil, "which", lambda name: str(program))
    with pytest.raises(
        ValueError, match=r"a\.mp4: ffmpeg failed: Unknown encoder libx264; use a \.gif file instead"
    ):
        wc.film(run, tmp_path / "a.mp4", progress=False, **SMALL)
    assert [entry.name for entry in tmp_path.iterdir()] == ["bin"]


def test_interrupted_film_keeps_the_existing_file(run, tmp_path, monkeypatch):
    file = tmp_path / "a.gif"
    wc.film(run, file, progress=False, **SMALL)
    before = file.read_bytes()
    monkeypatch.setattr(
        pictures.FrameRenderer, "picture", lambda *_, **__: (_ for _ in ()).throw(KeyboardInterrupt)
    )
    with pytest.raises(KeyboardInterrupt):
        wc.film(run, file, progress=False, **SMALL)
    assert file.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.gif"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["-o", "{}/a.jpg"], r"--out .*a\.jpg: must end in \.png, \.gif or \.mp4, got \.jpg"),
        (["-o", "{}/none/a.png"], "none does not exist"),
        (["-o", "{}/a.png", "--env", "7"], "environment 7 is not in the recording, which has 0 to 2"),
        (["-o", "{}/a.png", "--time", "1"], r"--time must be within the recording, 0 to 0\.2 s, got 1"),
        (["-o", "{}/a.png", "--time", "0", "0.1"], "--time must be one time for a picture, got 2"),
        (["-o", "{}/a.gif", "--time", "0"], "--time must be the first and the last time for a film, got 1"),
        (["-o", "{}/a.gif", "--time", "0.1", "0.1"], "--time must be two ascending times"),
        (["-o", "{}/a.gif", "--fps", "60"], "--fps must be greater than 0 and at most 50"),
        (["-o", "{}/a.gif", "--fps", "0"], "--fps must be greater than 0"),
        (["-o", "{}/a.gif", "--speed", "-1"], "--speed must be greater than 0"),
        (["-o", "{}/a.png", "--fps", "20"], "--fps requires a film"),
        (["-o", "{}/a.png", "--from", "0", "100"], r"--from\[1\] must be at least -90"),
        (["-o", "{}/a.png", "--device", "cuda:9"], "--device must be 'auto' or one of"),
        (["-o", "{}/a.png", "--color-by", "x"], "--color-by must be one number for each environment, got 'x'"),
        (["-o", "{}/a.png", "--background", "blue"], "--background must be one of 'light'"),
    ],
)
def test_invalid_render_arguments_are_reported(run, tmp_path, capsys, words, message):
    assert command(run, *(word.format(tmp_path) for word in words)) == 2
    error = capsys.readouterr().err
    assert error.startswith("warpcontact: ")
    assert re.search(message, error), error
    assert not list(tmp_path.iterdir())


def test_odd_mp4_sizes_are_refused(run, tmp_path, capsys):
    code = main(["render", str(run.folder), "-o", str(tmp_path / "a.mp4"), "--size", "63x48"])
    assert code == 2
    assert "--size must be even for an .mp4 file, got 63 × 48 pixels" in capsys.readouterr().err


def test_film_with_too_many_pictures_is_refused(run, tmp_path, capsys):
    assert command(run, "-o", tmp_path / "a.gif", "--speed", 1e-9) == 2
    assert re.search(r"at most 100000 frames, got \d+ of 0 to 0.2 s; decrease fps", capsys.readouterr().err)


def test_render_size_must_be_two_numbers(run, capsys):
    with pytest.raises(SystemExit):
        main(["render", str(run.folder), "-o", "a.png", "--size", "wide"])
    assert "must be WIDTHxHEIGHT, such as 1280x720, got 'wide'" in capsys.readouterr().err


def test_missing_force_sensors_are_reported(tmp_path, capsys):
    bare = {**STUDY, "envs": 1, "variation": {}, "record": {"every": 0.1, "sensors": ["touch.gap"]}}
    run = wc.Experiment.from_dict(bare).run(tmp_path / "bare", device="cpu")
    assert command(run, "-o", tmp_path / "a.png", "--forces") == 0
    assert "no forces are shown" in capsys.readouterr().err
    assert command(run, "-o", tmp_path / "a.png") == 0
    assert "no forces are shown" not in capsys.readouterr().err


def test_render_command_refuses_folder_without_a_run(tmp_path, capsys):
    assert main(["render", str(tmp_path), "-o", str(tmp_path / "a.png")]) == 2
    assert "holds no run" in capsys.readouterr().err


def test_render_refuses_an_invalid_recording():
    with pytest.raises(
        TypeError, match=r"recording must be the result of Simulation\.run or wc\.open_run, got str"
    ):
        wc.render("results", **SMALL)
