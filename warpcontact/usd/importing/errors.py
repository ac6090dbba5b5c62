"""Error of a stage that cannot be imported."""

from collections.abc import Iterable

from warpcontact.validation import safe_text

# Largest number of problems listed in the message, and characters of each.
_LISTED = 50
_LENGTH = 600


class UsdError(ValueError):
    """USD stage that cannot be imported as a scene.

    Attributes:
        problems: All problems, each with the path of its prim.
    """

    def __init__(self, subject: str, problems: Iterable[str]) -> None:
        self.problems = tuple(problems)
        shown = [shortened(problem, _LENGTH) for problem in self.problems[:_LISTED]]
        if len(self.problems) > _LISTED:
            shown.append(f"and {len(self.problems) - _LISTED} more, in the attribute problems of this error")
        if len(self.problems) == 1:
            super().__init__(safe_text.escape_controls(f"{subject}: {shown[0]}"))
        else:
            listed = "".join(f"\n  - {o}" for o in shown)
            super().__init__(safe_text.escape_controls(f"{subject} has {len(self.problems)} problems:{listed}"))


def shortened(text: object, most: int = 120) -> str:
    """Returns a text as one line of at most ``most`` characters; shortens the middle, because paths end in names."""
    return safe_text.truncate(safe_text.single_line(text), most, middle=True)
