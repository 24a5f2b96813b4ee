"""Who watches a fit, and is told how it goes."""

from __future__ import annotations

from typing import Protocol

from prtnet.arrays import FloatArray

__all__ = ["Monitor", "Silent"]


class Monitor(Protocol):
    """Who watches a fit."""

    def stage(self, text: str) -> None:
        """A new stage begins."""

    def progress(self, done: int, total: int, loss: float) -> None:
        """Iterations done of the present fit, and the mean objective over clusters."""

    def scalar(self, name: str, value: float, step: int) -> None:
        """A figure to plot."""

    def histogram(self, name: str, values: FloatArray, step: int) -> None:
        """A distribution to plot."""


class Silent:
    """A monitor that says nothing."""

    def stage(self, text: str) -> None:
        """Nothing."""

    def progress(self, done: int, total: int, loss: float) -> None:
        """Nothing."""

    def scalar(self, name: str, value: float, step: int) -> None:
        """Nothing."""

    def histogram(self, name: str, values: FloatArray, step: int) -> None:
        """Nothing."""
