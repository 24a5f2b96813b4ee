"""What a model may cost, and how wrong it may be: limits of `prtnet train`."""

from __future__ import annotations

import math
from dataclasses import dataclass

from prtnet.errors import PrtnetError

__all__ = ["Budget"]


@dataclass(frozen=True)
class Budget:
    """Limits that the cheapest model is sought within; None for no limit.

    Attributes:
        max_error: expected relative RMS on clips that training has not seen, a fraction.
        max_ms: milliseconds a pose in onnxruntime on this machine.
        max_mb: megabytes (10⁶ bytes) of the exported model.onnx.
    """

    max_error: float | None = None
    max_ms: float | None = None
    max_mb: float | None = None

    def __post_init__(self) -> None:
        """Refuse limits that nothing can meet."""
        for name in ("max_error", "max_ms", "max_mb"):
            value = getattr(self, name)
            if value is not None and not 0 < value < math.inf:
                raise PrtnetError(f"--{name.replace('_', '-')}", "must be a number above 0")
        if self.max_error is not None and self.max_error >= 1:
            example = f"{self.max_error:g}% or {self.max_error / 100:g}"
            raise PrtnetError("--max-error", f"must be below 1, or in per cent; write {example}")

    def __bool__(self) -> bool:
        """Whether there is any limit."""
        return (self.max_error, self.max_ms, self.max_mb) != (None, None, None)

    def text(self) -> str:
        """The limits in words."""
        parts = []
        if self.max_error is not None:
            parts.append(f"an error of {100 * self.max_error:.3g} %")
        if self.max_ms is not None:
            parts.append(f"{self.max_ms:.3g} ms")
        if self.max_mb is not None:
            parts.append(f"{self.max_mb:.3g} MB")
        return " and ".join(parts)
