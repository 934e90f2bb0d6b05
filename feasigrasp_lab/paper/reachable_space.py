"""Reachable space of an arm as a thresholded density over poses: the paper's filter.

A Riemannian mixture is fitted to the poses of uniformly drawn admissible configurations (the
paper's section IV-B). A pose counts as reachable if its log density exceeds the value that 99 % of
reachable poses exceed. That is a soft score, not a proof: `feasigrasp.models.reach.reachability`
has the exact answer.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.errors import FeasigraspError, ReachabilityError
from feasigrasp.inputs import read_arrays
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Array, Frozen, Mask
from feasigrasp.models.choices import parse_word
from feasigrasp.models.quantities import UNKNOWN_POSES
from feasigrasp.outputs import replacing
from feasigrasp_lab import WEIGHTS
from feasigrasp_lab.mixtures.mixture import RiemannianMixture

#: The file of flange poses of the iiwa 7 with its hand.
DEFAULT_FILE = WEIGHTS / "reachable_space.npz"
#: With as many components as the paper's, 64, fitted to poses of uniform joint samples as there.
PAPER_FILE = WEIGHTS / "reachable_space_paper.npz"
_ARRAYS = ("weights", "means", "covariances")


class SpaceName(StrEnum):
    """The reachable spaces that come with the package."""

    DEFAULT = "default"
    PAPER = "paper"


@dataclass(frozen=True, eq=False)
class ReachableSpace(Frozen):
    """A mixture over the poses that an arm reaches, and the density from which on it does.

    Attributes:
        mixture: Density over poses of the fitted frame (the flange F unless the file says
            otherwise) in the frame of the arm's base.
        threshold: Log density that 99 % of held-out reachable poses exceed.
        metadata: How it was made: command, seed, counts, frame.

    Raises:
        ReachabilityError: If the threshold is not finite.
    """

    mixture: RiemannianMixture
    threshold: float
    metadata: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Checks the fields."""
        check_fields(self, ReachabilityError)

    @checked(ReachabilityError)
    def log_density(self, X_WF: Annotated[ArrayLike, UNKNOWN_POSES]) -> Array:
        """Log density of poses, shape (n,).

        Args:
            X_WF: Poses of the fitted frame in the base frame, shape (n, 4, 4) [m].

        Raises:
            ReachabilityError: ``X_WF`` does not have shape (n, 4, 4), or holds no rotation.
        """
        return self.mixture.log_density(X_WF)

    @checked(ReachabilityError)
    def contains(self, X_WF: Annotated[ArrayLike, UNKNOWN_POSES]) -> Mask:
        """Which poses (n, 4, 4) are dense enough to count as reachable, shape (n,)."""
        return np.asarray(self.log_density(X_WF) >= self.threshold)

    @checked(ReachabilityError)
    def save(self, path: str | Path) -> None:
        """Writes the space as ``.npz``, whole or not at all."""
        arrays = {name: getattr(self.mixture, name) for name in _ARRAYS}
        metadata = np.array(json.dumps(dict(self.metadata)))
        with replacing(path) as file:
            np.savez_compressed(file, **arrays, threshold=self.threshold, metadata=metadata)

    @classmethod
    @checked(ReachabilityError)
    def load(cls, path: str | Path) -> ReachableSpace:
        """Reads what `save` wrote.

        Raises:
            ReachabilityError: The file is missing, or is no reachable space.
        """
        mend = "make one with: feasigrasp fit reachability"
        if not Path(path).is_file():
            raise ReachabilityError(f"{path}: no such file; {mend} --out DIR")
        try:
            stored = read_arrays(path)
            mixture = RiemannianMixture(*(stored[name] for name in _ARRAYS))
            metadata = json.loads(str(stored["metadata"]))
            return cls(mixture, float(stored["threshold"]), metadata)
        except KeyError as error:
            raise ReachabilityError(
                f"{path} is no reachable space, it lacks {error}; {mend}"
            ) from None
        except (ValueError, TypeError, FeasigraspError) as error:
            raise ReachabilityError(f"{path} is no reachable space ({error}); {mend}") from error

    @classmethod
    @checked(ReachabilityError)
    def load_named(cls, name: str = SpaceName.DEFAULT) -> ReachableSpace:
        """A packaged reachable space of the iiwa 7's flange, by its `SpaceName`.

        Raises:
            ReachabilityError: There is no such space, or its file is missing or malformed.
        """
        name = parse_word(SpaceName, name, "reachable space", ReachabilityError)
        return cls.load(PAPER_FILE if name == SpaceName.PAPER else DEFAULT_FILE)
