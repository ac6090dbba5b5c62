"""A small experiment of several shards and blocks, subprocesses that run it, and checks of their folders."""

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

import warpcontact as wc

STUDY = """\
envs = 10
duration = 0.2
dt = 1e-3
seed = 3
[output]
usd_envs = 0
[[surface]]
name = "ground"
mesh = { shape = "grid", size = [4.0, 4.0] }
[[body]]
name = "ball"
mass = 1.0
inertia = [4e-3, 4e-3, 4e-3]
position = [0.0, 0.0, 0.15]
[[point]]
name = "centre"
body = "ball"
position = [0.0, 0.0, 0.0]
[[material]]
name = "rubber"
law = { type = "HuntCrossley", stiffness = 1e5, restitution = 0.7 }
[[contact]]
name = "touch"
points = "centre"
surface = "ground"
material = "rubber"
radius = 0.1
[variation]
"ball.mass" = { uniform = [0.5, 2.0] }
"ball.linear_velocity" = { uniform = [[-1, -1, -1], [1, 1, 1]] }
[record]
every = 1e-3
sensors = ["touch.gap", "touch.normal_force", "touch.status"]
"""

# A frame of a shard of 4 has about 200 bytes: blocks of about 20 frames.
BLOCK = 4096
# Three shards on the CPU, with a checkpoint after every chunk of steps.
OPTIONS = ("--shard", 4, "--device", "cpu", "--checkpoint", 0)

# The command, with a block size that the test sets, and without a picture.
_COMMAND = """\
import sys
sys.path.append({folder!r})
import blank_pictures
blank_pictures.replace_module()
import warpcontact.experiment.plan as plan
plan.BLOCK = int(sys.argv.pop(1))
{first}
from warpcontact.cli import main
sys.exit(main(sys.argv[1:]))
"""


def study(folder, **replaced):
    """Writes the experiment into ``folder``, with replaced texts; returns its path."""
    text = STUDY
    for key, value in replaced.items():
        line = next(line for line in text.splitlines() if line.startswith(f"{key} = "))
        text = text.replace(line, f"{key} = {value}", 1)
    path = folder / "study.toml"
    path.write_text(text, encoding="utf-8")
    return path


def overflowing_study(folder):
    """Writes an experiment whose neighbor lists overflow in environments 2 and 3; returns its path."""
    places = [[0.25 * i, 0.0, 0.0] for i in range(40)]
    path = folder / "crowded.toml"
    path.write_text(
        f"""\
envs = 6
duration = 0.02
dt = 1e-3
gravity = [0.0, 0.0, 0.0]
[output]
usd_envs = 0
[[bodies]]
name = "grains"
mass = 1.0
inertia = [0.01, 0.01, 0.01]
positions = {places}
[[shape]]
name = "grain"
body = "grains"
form = {{ type = "Sphere", radius = 0.1 }}
[[material]]
name = "soft"
law = {{ type = "Hooke", stiffness = 100.0 }}
[[particle_contact]]
name = "pile"
shapes = ["grain"]
material = "soft"
skin = 0.01
max_neighbors = 1
[variation]
"grain.radius" = {{ values = [0.1, 0.1, 0.3, 0.3, 0.1, 0.1] }}
""",
        encoding="utf-8",
    )
    return path


def start_run(*words, first="", block=BLOCK, **options):
    """Starts ``warpcontact run`` in a subprocess; the code ``first`` is executed before."""
    code = _COMMAND.format(first=first, folder=str(Path(__file__).parent))
    command = [sys.executable, "-c", code, str(block), "run", *map(str, words)]
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True} | options
    return subprocess.Popen(command, **options)


def wait_for_end(process, timeout=300):
    """Waits for a process; returns its exit code, standard output and standard error."""
    try:
        out, err = process.communicate(timeout=timeout)
    except subprocess.TimeoutExpired:
        process.kill()
        raise
    return process.returncode, out, err


def run(*words, **options):
    """Runs ``warpcontact run``; returns the result of ``wait_for_end``."""
    return wait_for_end(start_run(*words, **options))


def wait_until(holds, process, timeout=300):
    """Waits until ``holds()``, or the process has ended; returns whether it holds."""
    deadline = time.monotonic() + timeout
    while time.monotonic() < deadline:
        if holds():
            return True
        if process.poll() is not None:
            return holds()
        time.sleep(0.002)
    raise TimeoutError


def have_ended(pids, timeout=60):
    """Returns whether the processes end in time; child processes may end after their parent."""
    deadline = time.monotonic() + timeout
    while any(Path(f"/proc/{pid}").exists() for pid in pids):
        if time.monotonic() > deadline:
            return False
        time.sleep(0.01)
    return True


def records(folder):
    """Returns the commit records by shard number."""
    found = {}
    for path in (Path(folder) / "commit").glob("shard_*.json"):
        content = json.loads(path.read_text())
        found[content["shard"]] = content
    return found


def hashes(folder):
    """Returns the SHA-256 of each file of the results."""
    root = Path(folder) / "data.zarr"
    files = (path for path in sorted(root.rglob("*")) if path.is_file())
    return {path.relative_to(root).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def leftovers(folder):
    """Returns the files that a finished run must have removed."""
    folder = Path(folder)
    temporary = [path for part in ("staging", "checkpoint", "progress") for path in (folder / part).rglob("*")]
    return [*temporary, *folder.rglob("*.partial*")]


def kill(process):
    """Kills a process abruptly and waits for its end."""
    os.kill(process.pid, signal.SIGKILL)
    process.communicate()


def check_committed_results(folder, reference):
    """Checks that an unfinished run shows the committed results, with the values of the whole run."""
    seen = wc.open_run(folder, verify=True)
    str(seen)
    whole = reference
    committed = records(folder)
    begun = [shard for shard in seen.shards if shard.number in committed]
    finished = [shard for shard in begun if committed[shard.number]["finished"]]
    assert seen.params["env"].values.tolist() == [env for s in begun for env in range(s.first, s.stop)]
    assert seen.outcome["env"].values.tolist() == [env for s in finished for env in range(s.first, s.stop)]
    assert seen.params.identical(whole.params.sel(env=seen.params["env"]))
    assert seen.outcome.identical(whole.outcome.sel(env=seen.outcome["env"]))
    for shard in begun:
        envs = range(shard.first, shard.stop)
        frames = committed[shard.number]["frames"]
        for name, values in seen.series.sel(env=envs).data_vars.items():
            expected = whole.series[name].sel(env=envs).values
            np.testing.assert_array_equal(values.values[:frames], expected[:frames], err_msg=name)
            rest = values.values[frames:]
            assert (np.isnan(rest) if rest.dtype.kind == "f" else rest == -1).all(), name
    return committed


# Commits a shard after each chunk of steps, for any duration of a commit.
COMMIT_OFTEN = "import warpcontact.experiment.shards as shards; shards.CHECKPOINT_SHARE = 1e9"


def kill_at_commit(commits, where="after"):
    """Returns code that makes a process kill itself at a commit: ``before`` its record, ``between``, or ``after``."""
    return f"""{COMMIT_OFTEN}
import os, signal
from warpcontact.experiment import store
left = [{commits}]
commit, publish, write = store.Ledger.commit, store.Ledger._publish, store.write_json
def end(where):
    if left[0] == 1 and where == {where!r}:
        os.kill(os.getpid(), signal.SIGKILL)
def writing(path, content):
    if path.name.startswith("shard_"):
        end("before")
    write(path, content)
def publishing(self, shard, names):
    names = list(names)
    if len(names) > 1 and left[0] <= 1 and {where!r} == "between":
        publish(self, shard, names[: len(names) // 2])
        os.kill(os.getpid(), signal.SIGKILL)
    publish(self, shard, names)
def committing(self, shard, record, staged):
    commit(self, shard, record, staged)
    end("after")
    left[0] -= 1
store.Ledger.commit, store.Ledger._publish, store.write_json = committing, publishing, writing
"""


def send_signal_at_step(number, steps):
    """Returns code that makes a process send itself the signal ``number`` after ``steps`` steps of a shard."""
    return f"""
import os
from warpcontact.experiment import shards
tell, asked = shards.ProgressFile.write, []
def telling(self, steps):
    if steps >= {steps} and not asked:
        asked.append(steps)
        os.kill(os.getpid(), {int(number)})
    return tell(self, steps)
shards.ProgressFile.write = telling
"""


def send_signal_at_stage(number, stage):
    """Returns code that makes a process send itself the signal ``number`` when it reports the start of ``stage``."""
    return f"""
import os
from warpcontact.cli import commands
print_stage = commands.print_stage
def saying(text):
    print_stage(text)
    if text.startswith({stage!r}):
        os.kill(os.getpid(), {int(number)})
commands.print_stage = saying
"""


def change(path, **entries):
    """Sets entries of a record."""
    content = json.loads(path.read_text())
    for key, value in entries.items():
        content[key] = value
    path.write_text(json.dumps(content))
