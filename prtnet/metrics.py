"""Errors of visibility, and the yardsticks every fit is held against.

Relative RMS over poses and receivers, √(Σ‖ṽ − v‖² / Σ‖v‖²); the same for each receiver over its
poses gives the 99th percentile and the maximum.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prtnet.arrays import FloatArray

__all__ = ["CoherenceSum", "ErrorSum", "relative_rms"]


@dataclass
class ErrorSum:
    """Squared errors and squared values of each receiver, summed block by block."""

    error: FloatArray | None = None  # [V]
    value: FloatArray | None = None  # [V]

    def add(self, predicted: FloatArray, truth: FloatArray) -> None:
        """Add poses: both (P, V, n²)."""
        difference = predicted - truth
        error = np.einsum("pvi,pvi->v", difference, difference, dtype=np.float64)
        value = np.einsum("pvi,pvi->v", truth, truth, dtype=np.float64)
        self.error = error if self.error is None else self.error + error
        self.value = value if self.value is None else self.value + value

    def merge(self, other: ErrorSum) -> None:
        """Add all that another sum holds."""
        if other.error is None or other.value is None:
            return
        self.error = other.error if self.error is None else self.error + other.error
        self.value = other.value if self.value is None else self.value + other.value

    def relative(self) -> FloatArray:
        """Relative RMS of each receiver over its poses, (V,)."""
        if self.error is None or self.value is None:
            raise ValueError("no poses were added")
        return np.sqrt(self.error / np.maximum(self.value, 1e-30))

    def rms(self) -> float:
        """Relative RMS over everything, as a fraction."""
        if self.error is None or self.value is None:
            raise ValueError("no poses were added")
        return float(np.sqrt(self.error.sum() / max(self.value.sum(), 1e-30)))

    def summary(self) -> dict[str, float]:
        """``rms``, and ``p99`` and ``max`` over receivers, as fractions."""
        each = self.relative()
        return {
            "rms": self.rms(),
            "p99": float(np.percentile(each, 99)),
            "max": float(each.max()),
        }


@dataclass
class CoherenceSum:
    """How much the error moves from one pose of a clip to the next, beside the truth's motion.

    √(Σ‖Δ(ṽ − v)‖² / Σ‖Δv‖²) over consecutive poses. What never changes has exactly 1; an error
    that moves smoothly along with the pose has less, and what flickers has more.
    """

    error: float = 0.0
    motion: float = 0.0
    last: tuple[FloatArray, FloatArray] | None = None  # error and truth, each [1, V, n²]

    def add(self, predicted: FloatArray, truth: FloatArray) -> None:
        """Add poses that follow those added before: both (P, V, n²)."""
        if len(truth) == 0:
            return
        error = predicted - truth
        before, known = (error[:0], truth[:0]) if self.last is None else self.last
        self.error += squared_steps(np.concatenate([before, error]))
        self.motion += squared_steps(np.concatenate([known, truth]))
        self.last = error[-1:], truth[-1:]

    def merge(self, other: CoherenceSum) -> None:
        """Add all that another clip's sum holds."""
        self.error += other.error
        self.motion += other.motion

    def value(self) -> float | None:
        """The ratio; None where nothing moves, or there are fewer than two poses."""
        return (self.error / self.motion) ** 0.5 if self.motion > 0 else None


def squared_steps(values: FloatArray) -> float:
    """Σ‖Δ‖² over consecutive poses of (P, V, n²)."""
    step = np.diff(values, axis=0)
    return float(np.einsum("pvi,pvi->", step, step, dtype=np.float64))


def relative_rms(predicted: FloatArray, truth: FloatArray) -> float:
    """√(Σ‖ṽ − v‖² / Σ‖v‖²) of arrays (P, V, n²)."""
    total = ErrorSum()
    total.add(predicted, truth)
    return total.rms()
