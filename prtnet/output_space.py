"""What space a model's output is in: local or global frame, with or without the cosine.

"Arbitrary BRDFs" section 5.4 compares them. Shading wants plain visibility in local frames; models
in any other space are there to be compared with, and are evaluated on datasets alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.dataset import Dataset
from prtnet.errors import PrtnetError
from prtnet.frames import orthonormal_frames
from prtnet.operators import cosine_matrix
from prtnet.sh_rotation import rotate

__all__ = ["OutputSpace"]

BLOCK = 8  # poses at a time


@dataclass(frozen=True)
class OutputSpace:
    """The space of fitted coefficients.

    Attributes:
        frame: "local", or "global" for coefficients rotated into the scene's frame.
        target: "visibility", or "cosine" for :func:`prtnet.operators.cosine_matrix` times it; the
            product is truncated to the order of the visibility.
    """

    frame: str = "local"
    target: str = "visibility"

    @classmethod
    def of(cls, metadata: dict[str, Any]) -> OutputSpace:
        """That of the model with this metadata."""
        config = metadata.get("config", {})
        return cls(config.get("frame", "local"), config.get("target", "visibility"))

    @property
    def plain(self) -> bool:
        """Whether it is visibility in local frames."""
        return self == OutputSpace()

    def require_plain(self, doing: str) -> None:
        """Raise PrtnetError unless the output is visibility in local frames."""
        if not self.plain:
            raise PrtnetError(
                "model", f"gives {self.target} in {self.frame} frames, which only prtnet evaluate "
                f"on its dataset understands; to {doing}, train with --frame local "
                "--target visibility"
            )  # fmt: skip

    def read(self, dataset: Dataset, rows: IntArray) -> FloatArray:
        """The dataset's truth of some poses in this space, (P, V, n²) float32."""
        visibility: FloatArray = dataset.read("visibility", rows)
        if self.plain:
            return visibility
        for start in range(0, len(rows), BLOCK):
            block = slice(start, start + BLOCK)
            value: FloatArray = visibility[block].astype(np.float64)
            if self.target == "cosine":
                value = value @ cosine_matrix(dataset.order)
            if self.frame == "global":
                tangents, normals = (dataset.read(n, rows[block]) for n in ("tangents", "normals"))
                value = rotate(value, orthonormal_frames(tangents, normals))
            visibility[block] = value
        return visibility
