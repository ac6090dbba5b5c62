"""Temporary: replaced at merge."""

from collections.abc import Mapping
from dataclasses import dataclass

from warpcontact.checks import Array


@dataclass(frozen=True, eq=False)
class Design:
    envs: int
    given: Mapping[str, Array]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.given)

    @property
    def row_bytes(self) -> int:
        return sum(v[:1].nbytes for v in self.given.values())

    def rows(self, first: int, stop: int) -> dict[str, Array]:
        return {name: v[first:stop] for name, v in self.given.items()}
