"""What readers raise."""


class Unreadable(ValueError):
    """What is wrong with the content of a file, as one sentence without the name of the file."""
