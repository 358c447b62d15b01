"""A chain's values at any arc length along it."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from recognition.model.model import Chain


@dataclass(frozen=True, eq=False)
class ChainInterpolator:
    """A chain to be asked for values at any arc length; a closed one goes round and round."""

    chain: Chain

    @cached_property
    def _s(self) -> NDArray[np.float64]:
        s, length = self.chain.arc_length_m, self.chain.length_m
        return np.concatenate([s - length, s, s + length, [2 * length]]) if self.chain.closed else s

    def __call__(self, s: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
        """`values` (N,) or (N, 3), given at the chain's points, at arc lengths `s` of any shape."""
        if self.chain.closed:
            values = np.concatenate([values, values, values, values[:1]])
        if values.ndim == 1:
            return np.interp(s, self._s, values)
        return np.stack([np.interp(s, self._s, values[:, k]) for k in range(values.shape[1])], axis=-1)

    def apart(self, s: NDArray[np.float64], t: NDArray[np.float64] | float) -> NDArray[np.float64]:
        """Distances along the chain, the shorter way round where it is closed."""
        way = np.abs(s - t)
        return np.minimum(way, self.chain.length_m - way) if self.chain.closed else way
