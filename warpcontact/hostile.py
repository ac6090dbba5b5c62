"""Texts of any length and content, such as names and paths in files of others, as people are shown them."""


def shortened(text: str, most: int, *, middle: bool = False) -> str:
    """Returns a text of at most ``most`` characters; … stands for what is left out.

    Args:
        text: The text.
        most: Most characters, at least 1.
        middle: Whether its middle is left out, as of paths, whose ends tell them apart; otherwise its end.
    """
    if len(text) <= most:
        return text
    after = (most - 1) // 2 if middle else 0
    return f"{text[: most - 1 - after]}…{text[len(text) - after :]}"


def in_one_line(text: object) -> str:
    """Returns a text with a space for whatever white space it has."""
    return " ".join(str(text).split())
