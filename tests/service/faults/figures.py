"""Measured times of the fault tests and their limits, and the number of rounds in CI and with `-m soak`."""

import math
import statistics
from collections.abc import Sequence

import pytest


class Figures:
    """Compares measured times with their limits and prints them. `pytest -m soak -rP` shows all."""

    def __init__(self, test: str, whole: bool) -> None:
        """Set `whole` if the test runs in full on an otherwise idle machine. Only then are times asserted."""
        self._test = test
        self.whole = whole

    def at_most(self, what: str, seconds: Sequence[float], promised_s: float, share: float = 1.0) -> None:
        """Assert that a `share` of the times does not exceed the limit, and print them."""
        ordered = sorted(seconds)
        reached_s = ordered[max(0, math.ceil(share * len(ordered)) - 1)]
        print(
            f"{self._test}: {what}: {len(ordered)} times, median {1e3 * statistics.median(ordered):.1f} ms, "
            f"longest {1e3 * ordered[-1]:.1f} ms, {100 * share:g} % within {1e3 * reached_s:.1f} ms "
            f"(promised: {1e3 * promised_s:g} ms)"
        )
        if self.whole:
            assert reached_s <= promised_s, f"{what}: {ordered}"


def rounds(reduced: int, whole: int, timeout_s: int = 7200) -> pytest.MarkDecorator:
    """Parametrize the test's argument `count`: `reduced` in CI, `whole` with `-m soak`."""
    in_full = pytest.param(whole, marks=[pytest.mark.soak, pytest.mark.timeout(timeout_s)])
    return pytest.mark.parametrize("count", [reduced, in_full])
