"""Category of warnings about scenes. Warning filters import it first, so it imports nothing else."""


class ContactWarning(UserWarning):
    """A scene that will run but hardly mean what its author wants."""
