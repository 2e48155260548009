"""What several plans of one scene share: results that do not depend on the QP (encoder only)."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import TypeVar, cast

Result = TypeVar("Result")


class Memo:
    """Results by key, for as long as it lives. Whoever asks names in the key all that a result depends on, beside the scene and
    those options that a search over the QP leaves as they are. An id() in a key must be of an object that the memo holds."""

    def __init__(self) -> None:
        self._results: dict[Hashable, object] = {}

    def get(self, key: Hashable, make: Callable[[], Result]) -> Result:
        """The result of this key, which is made where it is asked for the first time."""
        if key not in self._results:
            self._results[key] = make()
        return cast(Result, self._results[key])

    def of_plan(self) -> Memo:
        """What is kept for as long as one plan is made."""
        return self

    def of_qualities(self) -> Memo:
        """What is kept for other QPs, large as it is."""
        return self

    def of_parts(self) -> Memo:
        """What is kept of parts at one quality, values that were coded among them: nothing, where plans differ in QP."""
        return NoMemo()


class MemoOfParts(Memo):
    """For plans at one quality that differ in some parts: what the others became stays."""

    def of_qualities(self) -> Memo:
        """See Memo.of_qualities."""
        return NoMemo()

    def of_parts(self) -> Memo:
        """See Memo.of_parts."""
        return self


class NoMemo(Memo):
    """Keeps nothing: for an encode that plans once."""

    def of_plan(self) -> Memo:
        """See Memo.of_plan."""
        return Memo()

    def get(self, key: Hashable, make: Callable[[], Result]) -> Result:
        """What is made now."""
        return make()
