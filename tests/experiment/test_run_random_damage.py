"""Run folders with random damage: each is rejected with a message, or shows the unchanged results."""

import json
import random
import shutil

import pytest
import sharded_runs

import warpcontact as wc
from warpcontact.cli import main


def flip(rng, path, folder):
    """Flips a bit."""
    content = bytearray(path.read_bytes())
    if content:
        content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    path.write_bytes(content)


def truncate(rng, path, folder):
    """Truncates a file."""
    content = path.read_bytes()
    path.write_bytes(content[: rng.randrange(max(1, len(content)))])


def delete(rng, path, folder):
    """Deletes a file."""
    path.unlink()


def delete_folder(rng, path, folder):
    """Deletes a folder with its content."""
    if path.parent != folder:
        shutil.rmtree(path.parent)


def duplicate(rng, path, folder):
    """Copies a file to another name in its folder."""
    stem = path.stem.replace("000000", "000002") if rng.random() < 0.5 else f"{path.stem}0"
    shutil.copy(path, path.with_name(stem + path.suffix))


def replace(rng, path, folder):
    """Replaces a file by a copy of another file."""
    shutil.copy(rng.choice(files(folder)), path)


def edit(rng, path, folder):
    """Changes, removes or adds an entry of a JSON file, or fills a file with random bytes."""
    try:
        content = json.loads(path.read_bytes())
        table = rng.choice([content, *(one for one in content.values() if isinstance(one, dict) and one)])
        key = rng.choice(list(table))
    except (ValueError, AttributeError):
        path.write_bytes(rng.randbytes(rng.randrange(200)))
        return
    value = rng.choice([None, -1, 0, 1, 2**40, 1e300, "", "\x1b[2J", [], {}, True, [0, "0" * 64]])
    damage = rng.randrange(4)
    if damage == 0:
        del table[key]
    else:
        table[key if damage < 3 else f"{key}0"] = table[key] if damage == 3 else value
    path.write_text(json.dumps(content))


def lose(rng, path, folder):
    """Removes a chunk and its entry in the records."""
    chunk = rng.choice([one for one in files(folder / "data.zarr") if "c" in one.parts])
    chunk.unlink()
    for record in (folder / "commit").glob("*.json"):
        content = json.loads(record.read_bytes())
        content["files"].pop(chunk.relative_to(folder / "data.zarr").as_posix(), None)
        record.write_text(json.dumps(content))


DAMAGES = (flip, flip, truncate, delete, delete_folder, duplicate, replace, edit, edit, lose)


def files(folder):
    return sorted(path for path in folder.rglob("*") if path.is_file() and path.name != "lock")


def one_of(rng, folder):
    """Returns a random file; all kinds of files are equally likely."""
    kinds = {}
    for path in files(folder):
        kinds.setdefault((path.parent.relative_to(folder).parts[:2], path.suffix), []).append(path)
    return rng.choice(kinds[rng.choice(sorted(kinds))])


def run_command(capsys, *words):
    """Runs a command; returns its exit code. Asserts that it ends with a message, without control characters."""
    code = main([str(word) for word in words])
    output = capsys.readouterr()
    assert code in (0, 1, 2, 3)
    assert "Traceback" not in output.err
    assert "\x1b" not in output.out + output.err
    return code


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", ["whole", "part"])
def test_random_damage_neither_crashes_nor_changes_verified_results(kind, request, times, tmp_path, capsys):
    whole, original = request.getfixturevalue("whole_run"), request.getfixturevalue(f"{kind}_run")
    digest = wc.open_run(original).digest()
    verified = refused = 0
    count = 12 if times == 1 else 30 * times
    for number in range(count):
        rng = random.Random(f"{kind} {number}")
        folder = shutil.copytree(original, tmp_path / str(number))
        for _ in range(1 + number % 2):
            damage = rng.choice(DAMAGES)
            try:
                damage(rng, one_of(rng, folder), folder)
            except (OSError, IndexError):
                continue  # the file is already missing, or the same
        if run_command(capsys, "status", folder, "--verify") == 0:
            verified += 1
            run = wc.open_run(folder)
            assert run.digest() == digest, number
            assert str(run)
        else:
            refused += 1
            with pytest.raises((wc.ExperimentError, wc.RunDataError)):
                wc.open_run(folder, verify=True)
        if number % 10 == 4:
            run_command(capsys, "report", folder, "-o", tmp_path / "report.html")
        if number % 10 == 9:
            done = run_command(capsys, "run", "--resume", "--out", folder, "--device", "cpu")
            if done == 0 and run_command(capsys, "status", folder, "--verify") == 0:
                # Copied chunks remain and are not read.
                assert sharded_runs.hashes(whole).items() <= sharded_runs.hashes(folder).items(), number
        shutil.rmtree(folder)
    # Some files, such as pictures, are not results.
    assert verified or count < 30  # with few cases, all damage may be detected
    assert refused > count // 2
