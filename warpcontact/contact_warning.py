"""Category of warnings about scenes. Warning filters import it first, so it imports nothing else."""


class ContactWarning(UserWarning):
    """Warns of a scene that can be simulated, but whose results are probably not those that its author expects."""
