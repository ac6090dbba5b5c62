"""Exception raised by readers."""


class Unreadable(ValueError):
    """Content of a file that cannot be read; the message is one sentence without the name of the file."""
