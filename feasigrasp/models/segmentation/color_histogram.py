"""Color of an object against that of its surroundings, as two histograms.

Swain and Ballard, "Color indexing", 1991, with the histogram of the background in the ratio.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from feasigrasp.models.arrays import Array, Frozen, Mask


@dataclass(frozen=True, eq=False)
class ColorHistogram(Frozen):
    """How probable it is that a color is the object's, where both kinds are as frequent.

    Attributes:
        probability: By bin, shape (8 ** 3,).
    """

    probability: Array

    @classmethod
    def learnt(cls, color: NDArray[np.uint8], of_object: Mask, beside: Mask) -> Self:
        """The histograms of an image (h, w, 3), of pixels of the object and of something else."""
        # Pixels that every bin has beforehand, of either kind: unseen colors say nothing.
        prior = 5.0
        bins, number = _bins(color), 8**3
        on, off = (np.bincount(bins[mask], minlength=number) for mask in (of_object, beside))
        scale = max(float(on.sum()), 1.0) / max(float(off.sum()), 1.0)
        return cls((on + prior) / (on + scale * off + 2.0 * prior))

    def of(self, color: NDArray[np.uint8]) -> Array:
        """The probability of each pixel of an image (h, w, 3), shape (h, w)."""
        return np.asarray(self.probability[_bins(color)])


def _bins(color: NDArray[np.uint8]) -> NDArray[np.int64]:
    """The bin of each pixel: the three highest bits of every channel."""
    high = (color >> 5).astype(np.int64)
    return (high[..., 0] << 6) | (high[..., 1] << 3) | high[..., 2]
