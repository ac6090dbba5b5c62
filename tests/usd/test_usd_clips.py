"""Value clips: frames equal those of a single file, memory is limited to a block, and exports can be resumed."""

import json
import shutil

import numpy as np
import pytest
from pxr import Usd
from recorded_usd_scene import simulate

import warpcontact as wc

OPTIONS = {"envs": [0, 2], "color_by": "scene.kinetic_energy"}
FRAMES = 7


@pytest.fixture(scope="module")
def recording(device):
    return simulate(device)


@pytest.fixture(scope="module")
def folder(recording, tmp_path_factory):
    """A single file, and the same recording as clips."""
    path = tmp_path_factory.mktemp("clips")
    wc.export_usd(recording, path / "one.usdc", **OPTIONS)
    wc.export_usd(recording, path / "run.usdc", clip_frames=FRAMES, **OPTIONS)
    return path


def content(folder):
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_clip_attributes_equal_the_single_file_at_every_time(folder):
    one, clips = (Usd.Stage.Open(str(folder / name)) for name in ("one.usdc", "run.usdc"))
    everything = Usd.PrimAllPrimsPredicate
    paths = [[prim.GetPath() for prim in Usd.PrimRange.Stage(stage, everything)] for stage in (one, clips)]
    assert sorted(paths[0]) == sorted(paths[1])
    # At records, between them, and across the boundaries of clips, of which one is between 6 and 7.
    codes = [Usd.TimeCode.Default(), *np.arange(31.0), 2.5, 6.25, 6.75, 13.5, 27.9]
    compared = 0
    for path in paths[0]:
        for attribute in one.GetPrimAtPath(path).GetAttributes():
            other = clips.GetAttributeAtPath(attribute.GetPath())
            for code in codes:
                a, b = attribute.Get(code), other.Get(code)
                assert a == b or np.array_equal(np.array(a), np.array(b), equal_nan=True), (attribute, code)
                compared += attribute.GetNumTimeSamples() > 0
    assert compared > 1000
    for stage in (one, clips):
        layer = stage.GetRootLayer()
        assert (layer.startTimeCode, layer.endTimeCode, layer.timeCodesPerSecond) == (0, 30, 100)
    assert one.GetRootLayer().customLayerData == clips.GetRootLayer().customLayerData


def test_clip_stage_is_valid_and_split_into_blocks(folder):
    assert wc.check_usd(folder / "run.usdc") == []
    names = sorted(path.name for path in (folder / "run.usdc.clips").iterdir())
    clips = [f"clip_{number:06d}.usdc" for number in range(5)]
    assert names == [*clips, "clips.json", "manifest.usdc", "topology.usdc"]
    index = json.loads((folder / "run.usdc.clips" / "clips.json").read_text())
    assert [entry["records"] for entry in index["clips"]] == [[0, 7], [7, 14], [14, 21], [21, 28], [28, 31]]


def export_again(folder, recording, monkeypatch, **options):
    """Returns the names of the clips that are written."""
    from warpcontact.usd import clips

    written = []
    save = clips.save_layer

    def note(layer, path):
        written.append(path.name)
        save(layer, path)

    monkeypatch.setattr(clips, "save_layer", note)
    wc.export_usd(recording, folder / "run.usdc", clip_frames=FRAMES, **OPTIONS | options)
    return [name for name in written if name.startswith("clip_")]


def test_interrupted_clip_export_resumes_with_bitwise_identical_files(recording, folder, tmp_path, monkeypatch):
    from warpcontact.usd import clips

    save = clips.save_layer

    def stop(layer, path):
        if path.name == "clip_000003.usdc":
            raise KeyboardInterrupt
        save(layer, path)

    with monkeypatch.context() as context:
        context.setattr(clips, "save_layer", stop)
        with pytest.raises(KeyboardInterrupt):
            wc.export_usd(recording, tmp_path / "run.usdc", clip_frames=FRAMES, **OPTIONS)
    assert not (tmp_path / "run.usdc").exists()
    assert export_again(tmp_path, recording, monkeypatch) == ["clip_000003.usdc", "clip_000004.usdc"]
    expected = content(folder)
    assert content(tmp_path) == {name: data for name, data in expected.items() if name != "one.usdc"}


def test_outdated_clips_are_written_again(recording, folder, tmp_path, monkeypatch):
    shutil.copytree(folder / "run.usdc.clips", tmp_path / "run.usdc.clips")
    with monkeypatch.context() as context:
        assert export_again(tmp_path, recording, context) == []
    damaged = tmp_path / "run.usdc.clips" / "clip_000001.usdc"
    damaged.write_bytes(damaged.read_bytes()[:-1] + b"x")
    (tmp_path / "run.usdc.clips" / "clip_000004.usdc").unlink()
    with monkeypatch.context() as context:
        assert export_again(tmp_path, recording, context) == ["clip_000001.usdc", "clip_000004.usdc"]
    other = recording.copy(deep=True)
    other["cube.position"].values[17] += 1e-3
    with monkeypatch.context() as context:
        assert export_again(tmp_path, other, context, scene=recording.scene) == ["clip_000002.usdc"]
    with monkeypatch.context() as context:
        assert len(export_again(tmp_path, recording, context, force_scale=0.5)) == 5
    (tmp_path / "run.usdc.clips" / "clips.json").write_text("{")
    with monkeypatch.context() as context:
        assert len(export_again(tmp_path, recording, context)) == 5
    assert content(tmp_path)["run.usdc"] == content(folder)["run.usdc"]


def test_clips_of_a_longer_export_are_removed(recording, tmp_path):
    wc.export_usd(recording, tmp_path / "run.usdc", clip_frames=5, **OPTIONS)
    wc.export_usd(recording, tmp_path / "run.usdc", clip_frames=20, **OPTIONS)
    assert len(list((tmp_path / "run.usdc.clips").glob("clip_*"))) == 2
    assert wc.check_usd(tmp_path / "run.usdc") == []


def test_stages_of_equal_name_and_different_format_have_separate_clips(recording, tmp_path):
    wc.export_usd(recording, tmp_path / "run.usda", clip_frames=5, envs=0)
    before = content(tmp_path)
    wc.export_usd(recording, tmp_path / "run.usdc", clip_frames=20, envs=2)
    assert before.items() < content(tmp_path).items()
    for name in ("run.usda", "run.usdc"):
        assert wc.check_usd(tmp_path / name) == []


def test_clips_of_another_stage_are_refused_and_kept(recording, tmp_path):
    wc.export_usd(recording, tmp_path / "run.usdc", clip_frames=5, envs=0)
    (tmp_path / "run.usdc.clips").rename(tmp_path / "other.usdc.clips")
    before = content(tmp_path)
    with pytest.raises(
        OSError, match=r"cannot write .*other\.usdc: .*other\.usdc\.clips holds the clips of 'run\.usdc'"
    ):
        wc.export_usd(recording, tmp_path / "other.usdc", clip_frames=5, envs=0)
    assert content(tmp_path) == before


def test_stage_is_absent_while_its_clips_are_replaced(recording, tmp_path, monkeypatch):
    from warpcontact.usd import clips

    path, save, seen = tmp_path / "run.usdc", clips.save_layer, []
    wc.export_usd(recording, path, clip_frames=FRAMES, envs=0)

    def stop(layer, file):
        seen.append(path.exists())
        if file.name == "clip_000002.usdc":
            raise KeyboardInterrupt
        save(layer, file)

    other = recording.copy(deep=True)
    other["ball.position"].values[:] += 1.0
    with monkeypatch.context() as context:
        context.setattr(clips, "save_layer", stop)
        with pytest.raises(KeyboardInterrupt):
            wc.export_usd(other, path, clip_frames=FRAMES, envs=0, scene=recording.scene)
    assert len(seen) > 2
    assert not any(seen)
    assert not path.exists()
    wc.export_usd(other, path, clip_frames=FRAMES, envs=0, scene=recording.scene)
    wc.export_usd(other, tmp_path / "one.usdc", envs=0, scene=recording.scene)
    found = [Usd.Stage.Open(str(tmp_path / name)) for name in ("one.usdc", "run.usdc")]
    for code in range(31):
        one, clip = (stage.GetAttributeAtPath("/World/env_0/ball.xformOp:translate").Get(code) for stage in found)
        assert one == clip


def test_failed_clip_export_keeps_the_existing_stage(recording, tmp_path):
    wc.export_usd(recording, tmp_path / "run.usdc", clip_frames=FRAMES, envs=0)
    before = content(tmp_path)
    bad = recording.copy(deep=True)
    bad["ball.position"].values[17, 0] = np.nan
    with pytest.raises(ValueError, match=r"ball\.position"):
        wc.export_usd(bad, tmp_path / "run.usdc", clip_frames=FRAMES, envs=0, scene=recording.scene)
    assert content(tmp_path) == before


def test_springs_are_continuous_between_clips(device, tmp_path):
    scene = wc.Scene()
    ball = scene.add_body(1.0, (0.1, 0.2, 0.15), (0.5, 0, -1), name="ball", linear_velocity=(1, 0, -2))
    ends = scene.add_point(None, (0, 0, 0)), scene.add_point(ball, (0, 0.1, 0.2))
    scene.add_spring_damper(*ends, stiffness=50.0, name="spring")
    recording = wc.Simulation(scene.build(2, device, "float64"), 1e-3).run(0.5, every=0.05)
    wc.export_usd(recording, tmp_path / "one.usdc", envs=0)
    wc.export_usd(recording, tmp_path / "run.usda", envs=0, clip_frames=3)
    found = [Usd.Stage.Open(str(tmp_path / name)) for name in ("one.usdc", "run.usda")]
    for code in np.arange(0, 10.5, 0.5):
        a, b = (
            stage.GetAttributeAtPath("/World/env_0/couplings/spring/shape.points").Get(code) for stage in found
        )
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("frames", [0, -1, 1.5, True, "7"])
def test_invalid_number_of_clip_frames_is_refused(recording, tmp_path, frames):
    with pytest.raises(ValueError, match="clip_frames must be a whole number of records"):
        wc.export_usd(recording, tmp_path / "a.usdc", clip_frames=frames)


def test_clips_are_refused_for_a_package(recording, tmp_path):
    with pytest.raises(ValueError, match=r"clip_frames is not for \.usdz"):
        wc.export_usd(recording, tmp_path / "a.usdz", clip_frames=3)
