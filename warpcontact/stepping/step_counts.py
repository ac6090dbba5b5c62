"""Durations as numbers of steps."""

from warpcontact.validation import checks


def recorded_steps(duration: float, every: float | None, dt: float) -> tuple[int, int]:
    """Returns the number of steps of a run and the number between frames; arguments as in ``Simulation.run``."""
    steps = whole_steps("duration", duration, dt, exact=False)
    return steps, 1 if every is None else whole_steps("every", every, dt, exact=True)


def frame_count(steps: int, stride: int) -> int:
    """Returns the number of frames of a run, including the one at the start."""
    return steps // stride + 1


def whole_steps(name: str, time: float, dt: float, *, exact: bool) -> int:
    """Returns the number of steps in a duration.

    Args:
        name: Name of the argument, for messages.
        time: The duration [s], positive.
        dt: Time step [s].
        exact: Whether the duration must be a multiple of the step; if not, it is rounded up.

    Raises:
        ValueError: If ``time`` is not positive, or not a multiple of the step.
    """
    value = float(checks.numbers(name, time, (), checks.limits("s", above=0.0)))
    steps = value / dt
    nearest = round(steps)
    # Decimal fractions are not exact in binary, so a millionth of a step is tolerated.
    if nearest >= 1 and abs(steps - nearest) <= 1.0e-6:
        return nearest
    if exact:
        below, above = int(steps), int(steps) + 1
        near = f"nearest: {below * dt:g} s and {above * dt:g} s" if below else "the smallest multiple is dt"
        raise ValueError(f"{name} must be a multiple of dt = {dt:g} s, got {value:g} s; {near}")
    return int(steps) + 1
