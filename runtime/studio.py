"""Lights and materials of the viewer, made beside its frames, for one character after another."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from prtnet.brdf import BRDF
from prtnet.environment import Environment
from prtnet.materials import brdf_named, material
from prtnet.one_dimensional import OneDimensional
from prtnet.reflection import ReflectionOperator
from prtnet.zh import Lobes
from runtime.background import Background
from runtime.looks import lobes_of
from runtime.view import View

__all__ = ["Studio"]


class Studio:
    """What shines on characters and what they are made of.

    Args:
        environments: lights by name.

    Attributes:
        lit: the light that was drawn last, and the number of its lobes.
    """

    def __init__(self, environments: Callable[[str], Environment]) -> None:
        self.environments = environments
        self.lit: tuple[str, int | None] | None = None
        self._fits: dict[tuple[str, int, int | None], Lobes] = {}  # a few KB each
        self._fitting: Background[Lobes] = Background()
        self._making: Background[ReflectionOperator] = Background()
        # By order, the last made of each, and of what.
        self._operators: dict[int, tuple[tuple[str, int], ReflectionOperator]] = {}
        self._brdf: tuple[tuple[str, bool], BRDF] | None = None

    @property
    def tasks(self) -> Mapping[str, Background[Any]]:
        """What is made, by words for it."""
        return {"making the material": self._making, "fitting the light": self._fitting}

    def brdf(self, name: str, lobes: bool) -> BRDF:
        """The reflectance of a name, the same object as long as no other is asked for.

        Args:
            name: as in ``prtnet render``.
            lobes: whether it may be one of visibility in lobes.

        Raises:
            PrtnetError: there is none of that name.
        """
        if self._brdf is None or self._brdf[0] != (name, lobes):
            self._brdf = (name, lobes), brdf_named(name, lobes)
        return self._brdf[1]

    def prepare(self, view: View, order: int) -> None:
        """Make the light and the material of a view in so many bands, if there are none of these.

        Here, not in the background: it may be called beside the frames, which then have what they
        would wait for.
        """
        key = view.light, order, view.lobes
        if key not in self._fits:
            self._fits[key] = self._fitted(*key)
        brdf = brdf_named(view.brdf, of_lobes=True)
        if order not in self._operators and not isinstance(brdf, OneDimensional):
            made = material(brdf, view.factors, order)
            self._operators[order] = (view.brdf, view.factors), made

    def operator(
        self, name: str, brdf: BRDF, factors: int, order: int, wait: bool = False
    ) -> ReflectionOperator:
        """A material of so many factors and bands; until it is made the last one of that order."""
        last = self._operators.get(order)
        if last is None or last[0] != (name, factors):
            found = self._making.get(
                (name, factors, order), lambda: material(brdf, factors, order), wait or last is None
            )
            if found is not None:
                last = self._operators[order] = (name, factors), found
        assert last is not None
        return last[1]

    def fitted(self, name: str, order: int, count: int | None) -> bool:
        """Whether the lobes of a light are there."""
        return (name, order, count) in self._fits

    def lobes(self, name: str, order: int, count: int | None, wait: bool = False) -> Lobes | None:
        """The lobes of a light as it was given, fitted once; None until then.

        Args:
            name: of the light.
            order: its bands.
            count: its lobes, as for :func:`runtime.looks.lobes_of`.
            wait: until it is there.
        """
        key = name, order, count

        def fit() -> Lobes:
            found = self._fitted(*key)
            self._fits[key] = found  # also if another light is asked for meanwhile
            return found

        return self._fits[key] if key in self._fits else self._fitting.get(key, fit, wait)

    def _fitted(self, name: str, order: int, count: int | None) -> Lobes:
        """The lobes of a light, fitted here."""
        return lobes_of(self.environments(name).harmonics(order), count)

    def release(self) -> None:
        """Wait for what is being made."""
        for task in self.tasks.values():
            task.release()
