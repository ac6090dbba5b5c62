"""Loads tampered checkpoints one after the other and steps each one that is accepted.

    python tests/stepping/tampered_checkpoints.py CASE FIRST COUNT FOLDER

Prints one line per checkpoint, so the last line names the one that ended the process.
"""

import sys
import warnings
from pathlib import Path

import numpy as np
import warp as wp
from test_checkpoint import simulation

import warpcontact as wc

PATTERNS = (0x7F7F7F7F, 0xFFFFFFF0, 0x00FFFFFF)
INTEGERS = (-(2**31), -2, -1, 2, 7, 100_000, 2**30 + 1, 2**31 - 1)
REALS = (np.nan, np.inf, -np.inf, 1e30, -1e30, 1e308, 0.0)
WATCHED = {
    "outcomes": {"high": wc.outcomes.Max("box.position", component="z")},
    "stop": {"fallen": wc.StopCondition("box.position", component="z", below=-1.0)},
    "events": wc.ContactEvents(["feet"]),
}


def pattern(rng, arrays, name):
    """Fills an array with a bit pattern."""
    values = arrays[name]
    word = np.array([rng.choice(PATTERNS)], np.uint32)
    arrays[name] = np.resize(word, values.nbytes // 4 + 1).view(np.uint8)[: values.nbytes].view(values.dtype)
    arrays[name] = arrays[name].reshape(values.shape)


def word(rng, arrays, name):
    """Replaces an aligned word of an array by an integer or a real number that may be out of range."""
    values = arrays[name].copy()
    new = np.array([rng.choice(INTEGERS)], np.int32)
    if rng.random() < 0.5:
        new = np.array([rng.choice(REALS)]).astype(rng.choice([np.float32, np.float64]))
    content = values.reshape(-1).view(np.uint8)
    if len(content) >= new.nbytes:
        place = rng.integers(len(content) // new.nbytes) * new.nbytes
        content[place : place + new.nbytes] = new.view(np.uint8)
    arrays[name] = values


def flip(rng, arrays, name):
    """Flips a few bits of an array."""
    values = arrays[name].copy()
    content = values.reshape(-1).view(np.uint8)
    for _ in range(rng.integers(1, 8)):
        if len(content):
            content[rng.integers(len(content))] ^= 1 << rng.integers(8)
    arrays[name] = values


def other_shape(rng, arrays, name):
    """Changes the shape or size of an array."""
    values = arrays[name]
    flat = values.reshape(-1)
    shapes = (flat[:-1], np.concatenate([flat, flat[:1]]), values[None], flat[:0], np.array(0, values.dtype))
    arrays[name] = shapes[rng.integers(len(shapes))]


def other_type(rng, arrays, name):
    """Changes the type of an array."""
    values = arrays[name]
    kind = rng.choice(["int64", "float32", "bool", "<U3", "complex64", ">f8", "S2"])
    arrays[name] = values.astype(kind)


def swap(rng, arrays, name):
    """Exchanges two arrays."""
    other = rng.choice(list(arrays))
    arrays[name], arrays[other] = arrays[other], arrays[name]


def remove(rng, arrays, name):
    """Removes an array."""
    del arrays[name]


TAMPERINGS = (pattern, pattern, word, word, word, word, flip, flip, other_shape, other_type, swap, remove)


def tampered(number, arrays, path):
    """Writes the tampered checkpoint of a number; returns a description of the change."""
    rng = np.random.default_rng([7, number])
    arrays = dict(arrays)
    # There are many parameters, and all are checked alike.
    names = [name for name in arrays if ("/values/" in name) == (number % 5 == 0)]
    name = rng.choice(names)
    tampering = TAMPERINGS[number % len(TAMPERINGS)]
    tampering(rng, arrays, name)
    save = np.savez_compressed if number % 41 == 0 else np.savez
    save(path, **arrays)
    if number % 11 == 0:
        content = bytearray(path.read_bytes())
        for place in rng.integers(0, len(content), 4):
            content[place] ^= 1 << rng.integers(8)
        path.write_bytes(content[: len(content) - int(rng.integers(0, 2) * rng.integers(0, 300))])
    return f"{tampering.__name__} {name}"


def check(sim, path):
    """Loads a file and steps; returns the result. Any unexpected error ends the process."""
    try:
        sim.load(path)
    except wc.CheckpointError as error:
        return "refused" if str(error).startswith(str(path)) else f"refused without its name: {error}"
    try:
        sim.step(5)
        sim.model.sensor(sim.model.sensor_names[0])
    except RuntimeError as error:
        if "neighbors" not in str(error):  # neighbor list overflow; the list is part of the state
            raise
        return "raised"
    if sim.monitor_settings.outcomes:
        sim.outcomes()
        sim.events()
    sim.save(path)
    return "ran"


def main(case, first, count, folder):
    wp.config.log_level = wp.LOG_ERROR
    warnings.simplefilter("ignore")
    sim = simulation(case, "cpu", envs=2, **(WATCHED if case == "impulses" else {}))
    sim.step(30)
    good, path = Path(folder, "good.npz"), Path(folder, "bad.npz")
    sim.save(good)
    arrays = dict(np.load(good).items())
    for number in range(first, first + count):
        done = tampered(number, arrays, path)
        print(f"{number}: {done}", end=": ", flush=True)
        print(check(sim, path), flush=True)
    sim.load(good)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), sys.argv[4])
