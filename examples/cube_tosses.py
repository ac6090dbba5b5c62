"""400 measured tosses of a cube, simulated in one batch and compared with the measurement frame by frame.

The data are the ContactNets cube tosses (Pfrommer, Halm, Posa, CoRL 2020; BSD-3-Clause) as one ``.npz`` file in SI
units, z up, table at z = 0::

    offset (n + 1,)              toss i is rows offset[i]:offset[i + 1]
    position (T, 3)              center of the cube, world [m]
    quaternion_xyzw (T, 4)       body → world
    linear_velocity (T, 3)       world [m/s]
    angular_velocity_body (T, 3) body axes [rad/s]
    dt, half_width               time between frames [s], half the side of the cube [m]
    mass, inertia                [kg], the same about every axis [kg·m²]

Each toss is one environment that starts from the first measured pose. ``--start raw`` uses the first measured
velocities, which are noisy; ``--start ballistic`` fits them to the frames before the cube reaches the table.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path
from zipfile import is_zipfile

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import warpcontact as wc

GRAVITY = 9.81  # m/s²

# Tuned by hand: one parameter at a time was varied over all tosses with raw starts. Friction determines the
# distance of sliding: μ ± 0.01 adds 1.4 % of position error. Restitution is good from 0.17 to 0.27. Corners
# rounded by 9 mm instead of sharp ones reduce the rotation error by 3°. The other parameters have little effect:
# with stiffness from 3e5 to 3e6 N/m^1.5 and velocity_scale from 0.01 to 0.2 m/s, errors change by 0.2 % and 0.2°.
LAW = wc.laws.HuntCrossley(stiffness=1.0e6, exponent=1.5, restitution=0.22, speed_floor=0.05)
FRICTION = wc.friction.Tanh(mu=0.18, velocity_scale=0.05)
CORNER_RADIUS = 9.0e-3  # m

# A resting cube was tracked with its center 1.2 mm lower than half its side. The table is placed so that the
# simulated cube, with a penetration of 0.1 mm, rests at the tracked height.
TABLE_HEIGHT = -1.1e-3  # m

# 0.34 ms: an impact takes 4 ms and is 2 mm deep. The step is below the stability limit of friction, 2 m v_s/(μ N)
# ≈ 0.8 ms (effective mass 0.1 kg at a corner, 70 N). Twice as many steps change the mean errors by less than 0.1 %
# and 0.1°.
STEPS_PER_FRAME = 20

# The start is ballistic until the lowest corner comes this close to the table.
CLEARANCE = 4.0e-3  # m

# Signs of the eight corners of a cube.
CORNERS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)


@dataclass(frozen=True)
class Tosses:
    """Measured tosses of different length, padded to the longest by repeating their last frame."""

    frames: NDArray[np.int64]  # (n,) number of measured frames
    position: NDArray[np.float64]  # (time, n, 3) [m]
    orientation: NDArray[np.float64]  # (time, n, 4) body → world, x, y, z, w
    linear_velocity: NDArray[np.float64]  # (n, 3) at the start, world [m/s]
    angular_velocity: NDArray[np.float64]  # (n, 3) at the start, world axes [rad/s]
    dt: float  # [s]
    half_width: float  # [m]
    mass: float  # [kg]
    inertia: float  # [kg·m²]

    @property
    def measured(self) -> NDArray[np.bool_]:
        """Whether each frame was measured, (time, n)."""
        return np.arange(len(self.position))[:, None] < self.frames


def load(path: str | Path, count: int | None = None) -> Tosses:
    """Reads the tosses of a file, or the first ``count`` of them.

    Raises:
        ValueError: If there is no such file, or an entry is missing.
    """
    needed = ("offset", "position", "quaternion_xyzw", "linear_velocity", "angular_velocity_body")
    needed += ("dt", "half_width", "mass", "inertia")
    if count is not None and count < 1:
        raise ValueError(f"the number of tosses must be at least 1, got {count}")
    if not is_zipfile(path):
        raise ValueError(f"{path} is not there, or it is no .npz file")
    with np.load(path) as file:
        missing = [name for name in needed if name not in file]
        if missing:
            raise ValueError(f"{path} lacks {', '.join(missing)}; it must have {', '.join(needed)}")
        data = {name: file[name].astype(np.float64) for name in needed}

    offset = data["offset"].astype(int)
    first, end = offset[:-1][:count], offset[1:][:count]
    frames = end - first
    rows = np.minimum(first + np.arange(frames.max())[:, None], end - 1)  # (time, n)
    orientation = data["quaternion_xyzw"][rows]
    # The model takes angular velocities in world axes.
    to_world = Rotation.from_quat(orientation[0])
    return Tosses(
        frames=frames,
        position=data["position"][rows],
        orientation=orientation,
        linear_velocity=data["linear_velocity"][first],
        angular_velocity=to_world.apply(data["angular_velocity_body"][first]),
        **{name: float(data[name]) for name in ("dt", "half_width", "mass", "inertia")},
    )


def ballistic_start(tosses: Tosses) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns linear and angular velocity at the first pose, (n, 3) each, fitted to the frames in free flight.

    In flight the position is a parabola, and a cube with equal moments of inertia has constant angular velocity:
    both fits are straight lines through the first pose.
    """
    linear, angular = tosses.linear_velocity.copy(), tosses.angular_velocity.copy()
    for i, frames in enumerate(tosses.frames):
        rotation = Rotation.from_quat(tosses.orientation[:frames, i])
        lowest = np.min([rotation.apply(tosses.half_width * corner)[:, 2] for corner in CORNERS], axis=0)
        touching = np.flatnonzero(tosses.position[:frames, i, 2] + lowest < CLEARANCE)
        flight = slice(1, touching[0] if len(touching) else frames)
        time = tosses.dt * np.arange(frames)[flight, None]
        if len(time) == 0:
            continue  # starts on the table: use the measured velocities
        moved = tosses.position[flight, i] - tosses.position[0, i] + [0.0, 0.0, 0.5 * GRAVITY] * time**2
        turned = (rotation[flight] * rotation[0].inv()).as_rotvec()
        linear[i] = (time * moved).sum(axis=0) / (time**2).sum()
        angular[i] = (time * turned).sum(axis=0) / (time**2).sum()
    return linear, angular


def simulate(tosses: Tosses, start: str = "raw", device: str = "auto") -> wc.Recording:
    """Simulates all tosses as environments of one model and records the measured frames."""
    scene = wc.Scene(gravity=(0.0, 0.0, -GRAVITY))
    table = scene.add_surface(wc.meshes.grid((4.0, 4.0)), position=(0.0, 0.0, TABLE_HEIGHT), name="table")
    cube = scene.add_body(mass=tosses.mass, inertia=[tosses.inertia] * 3, name="cube")
    # A box with rounded edges touches a plane only with the spheres at its corners.
    corners = scene.add_points(cube, (tosses.half_width - CORNER_RADIUS) * CORNERS, name="corners")
    scene.add_contact(
        corners, table, wc.ContactMaterial(law=LAW, friction=FRICTION), radius=CORNER_RADIUS, name="touch"
    )

    model = scene.build(envs=len(tosses.frames), device=device)
    linear, angular = tosses.linear_velocity, tosses.angular_velocity
    if start == "ballistic":
        linear, angular = ballistic_start(tosses)
    model["cube.position"] = tosses.position[0]
    model["cube.orientation"] = tosses.orientation[0]
    model["cube.linear_velocity"] = linear
    model["cube.angular_velocity"] = angular

    sim = wc.Simulation(model, dt=tosses.dt / STEPS_PER_FRAME)
    # Poses are always recorded. Short tosses run to the end of the longest and are cut afterwards.
    return sim.run(duration=(len(tosses.position) - 1) * tosses.dt, record=["touch.penetration"], every=tosses.dt)


def errors(tosses: Tosses, recording: wc.Recording) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns position error relative to the side [-] and rotation error [rad] of each frame, (time, n).

    Frames that were not measured are NaN.
    """
    position = np.linalg.norm(recording["cube.position"].values - tosses.position, axis=2)
    simulated = Rotation.from_quat(recording["cube.orientation"].values.reshape(-1, 4))
    measured = Rotation.from_quat(tosses.orientation.reshape(-1, 4))
    rotation = (measured.inv() * simulated).magnitude().reshape(position.shape)
    seen = tosses.measured
    return np.where(seen, position / (2.0 * tosses.half_width), np.nan), np.where(seen, rotation, np.nan)


def landed_right(tosses: Tosses, recording: wc.Recording) -> NDArray[np.bool_]:
    """Returns whether the same face of the cube is up at the end, (n,)."""
    last = tosses.frames - 1, np.arange(len(tosses.frames))
    up = [
        Rotation.from_quat(orientation[last]).inv().apply([0.0, 0.0, 1.0]).round()
        for orientation in (tosses.orientation, recording["cube.orientation"].values)
    ]
    return np.all(up[0] == up[1], axis=1)


def plot(tosses: Tosses, recording: wc.Recording, path: str | Path, title: str) -> None:
    """Plots the distributions of the errors, and a good, an average and a bad toss, to a file."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14.0, 9.0), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title)
    axes = figure.subplots(3, 4, width_ratios=[1.25, 1.0, 1.0, 1.0])
    for ax in axes.flat:
        ax.grid(alpha=0.3)
    position, rotation = errors(tosses, recording)
    position, rotation = 100.0 * position, np.degrees(rotation)  # %, °
    time = recording["time"].values

    right = landed_right(tosses, recording)
    for ax, error, name in (
        (axes[0, 0], position, "position error [% of the side]"),
        (axes[1, 0], rotation, "rotation error [°]"),
    ):
        mean = np.nanmean(error, axis=0)
        labels = [f"{right.sum()} on the right face", f"{(~right).sum()} on another"]
        ax.hist([mean[right], mean[~right]], bins=40, stacked=True, color=["0.7", "C1"], label=labels)
        ax.axvline(mean.mean(), color="C3", label=f"mean {mean.mean():.1f}")
        ax.axvline(np.median(mean), color="C3", linestyle="--", label=f"median {np.median(mean):.1f}")
        ax.set(xlabel=f"mean {name}", ylabel="tosses", xlim=(0.0, None))
        ax.legend()

    # Growth of errors, while at least half of the tosses have measured frames.
    seen = tosses.measured.mean(axis=1) >= 0.5
    left_axis, right_axis = axes[2, 0], axes[2, 0].twinx()
    for ax, error, unit, color in (
        (left_axis, position, "% of the side", "C0"),
        (right_axis, rotation, "°", "C2"),
    ):
        ax.plot(time[seen], np.nanmean(error[seen], axis=1), color=color)
        ax.set(ylim=(0.0, None))
        ax.set_ylabel(f"mean error [{unit}]", color=color)
    left_axis.set(xlabel="time [s]", xlim=(0.0, None))

    motions = {
        "measured": (tosses.position, tosses.orientation, {"color": "0.5", "linewidth": 3.0}),
        "simulated": (
            recording["cube.position"].values,
            recording["cube.orientation"].values,
            {"color": "C3", "linewidth": 1.2},
        ),
    }
    mean = np.nanmean(position, axis=0)
    ranked = np.argsort(mean)
    for (height, angle, top), share in zip(axes[:, 1:].T, (0.2, 0.5, 0.9), strict=True):
        i = ranked[round(share * (len(ranked) - 1))]
        seen = slice(0, tosses.frames[i])
        for label, (place, orientation, style) in motions.items():
            x, y, z = 1.0e3 * place[seen, i].T
            turned = Rotation.from_quat(orientation[seen, i])
            turned = np.degrees((turned * turned[0].inv()).magnitude())
            height.plot(time[seen], z, label=label, **style)
            angle.plot(time[seen], turned, **style)
            top.plot(x, y, **style)
            top.plot(x[-1], y[-1], "o", color=style["color"])
        height.set_title(
            f"toss {i}: {mean[i]:.0f} %, {np.nanmean(rotation[:, i]):.0f}°\n"
            f"worse than {100.0 * share:.0f} % of the tosses",
            fontsize="medium",
        )
        height.set(xlabel="time [s]", ylabel="height of the centre [mm]")
        height.legend()
        angle.set(xlabel="time [s]", ylabel="turned since the start [°]", ylim=(0.0, None))
        top.set(xlabel="x [mm]  (top view, dot: end)", ylabel="y [mm]")
        top.axis("equal")
    figure.savefig(path, dpi=120)


def compare(
    data: str | Path,
    start: str = "raw",
    device: str = "auto",
    count: int | None = None,
    figure: str | Path | None = None,
) -> dict[str, float]:
    """Simulates the tosses of a file, prints the errors and returns them, in % of the side and in degrees."""
    tosses = load(data, count)
    recording = simulate(tosses, start, device)
    position, rotation = (np.nanmean(error, axis=0) for error in errors(tosses, recording))
    result = {
        "mean position error": 100.0 * float(position.mean()),
        "median position error": 100.0 * float(np.median(position)),
        "mean rotation error": float(np.degrees(rotation.mean())),
        "median rotation error": float(np.degrees(np.median(rotation))),
        "landed right": 100.0 * float(landed_right(tosses, recording).mean()),
    }
    depth = 1.0e3 * float(recording["touch.penetration"].max())
    print(f"{len(tosses.frames)} tosses from {start} starts; deepest penetration in a frame {depth:.1f} mm")
    for kind, unit in (("position", " % of the side"), ("rotation", "°")):
        mean, median = result[f"mean {kind} error"], result[f"median {kind} error"]
        print(f"{kind} error: mean {mean:.1f}{unit}, median {median:.1f}{unit}")
    print(f"landed on the measured face: {result['landed right']:.0f} % of the tosses")
    if figure is not None:
        title = (
            f"{len(tosses.frames)} cube tosses from {start} starts: mean errors "
            f"{result['mean position error']:.1f} % of the side and {result['mean rotation error']:.1f}°"
        )
        plot(tosses, recording, figure, title)
        print(f"plot: {figure}")
    return result


def main(argv: list[str] | None = None) -> dict[str, float]:
    parser = argparse.ArgumentParser(description="Measured cube tosses, simulated and compared.")
    parser.add_argument(
        "--data", required=True, metavar="FILE", help=".npz file of tosses; see the head of this file"
    )
    parser.add_argument("--start", choices=("raw", "ballistic"), default="raw", help="velocities at the start")
    parser.add_argument("--tosses", type=int, metavar="N", help="simulate only the first N")
    parser.add_argument("--plot", metavar="FILE", help="write a figure, such as tosses.png")
    parser.add_argument("--device", default="auto", help="cpu, cuda:0 or auto (default)")
    options = parser.parse_args(argv)
    try:
        return compare(options.data, options.start, options.device, options.tosses, options.plot)
    except ValueError as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
