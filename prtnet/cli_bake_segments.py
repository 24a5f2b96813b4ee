"""Segments of all-frequency transfer that other processes make, cluster and fit.

Beside ``prtnet.cli_bake_all_frequency``, which it serves, it may import the other packages.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from prtnet.all_frequency import SEGMENTS, Segment
from prtnet.all_frequency_factors import RowFactors
from prtnet.all_frequency_file import OWN, SPARSE, segment_from
from prtnet.exchange import Exchange, Given, Result
from prtnet.executor import Serial
from prtnet.kept import keeps_last
from prtnet.transfer import Surface

if TYPE_CHECKING:
    from data_gen.all_frequency import SegmentMaker
    from data_gen.cube_visibility import CubeVisibility
    from prtnet.arrays import FloatArray
    from training.all_frequency import Clustered, CompressConfig, Stages

__all__ = ["stages_elsewhere"]

SURFACE = ("positions", "normals", "tangents", "faces")


@dataclass(frozen=True)
class Raw:
    """What the raw transfer of a segment is made of, but for arrays.

    Attributes:
        size: directions a side of a face that visibility has.
        matte: whether there are no light factors.
    """

    size: int
    matte: bool

    def __call__(self, number: int, given: Given) -> FloatArray:
        """Raw transfer of a segment, (P, m, (n/2)²) float32, by one thread."""
        import torch

        torch.set_num_threads(1)
        return maker(self, given)(number, Serial())


@keeps_last
def maker(raw: Raw, given: Given) -> SegmentMaker:
    """What the segments of one surface share."""
    from data_gen.all_frequency import SegmentMaker
    from data_gen.cube_visibility import CubeVisibility

    light = None if raw.matte else given["light"]
    surface = Surface(*(given[name] for name in SURFACE))
    visibility = CubeVisibility(given["bits"], raw.size)
    return SegmentMaker(surface, visibility, RowFactors(light, given["view"]))


@dataclass(frozen=True)
class ClusterSegment:
    """The clusters of a segment: work that can be handed over."""

    raw: Raw
    config: CompressConfig

    def __call__(self, number: int, given: Given) -> Result:
        """See ``prtnet.exchange.Work``."""
        from training.all_frequency import clustered

        found = vars(clustered(self.raw(number, given), self.config)).items()
        arrays = {name: value for name, value in found if isinstance(value, np.ndarray)}
        return {name: value for name, value in found if name not in arrays}, arrays


@dataclass(frozen=True)
class FitSegment:
    """A segment of its clusters and of representatives that are kept: likewise.

    Attributes:
        raw: see there.
        scene: the name of the file that raw transfer is made of.
    """

    raw: Raw
    scene: str

    def __call__(self, number: int, given: Given) -> Result:
        """See ``prtnet.exchange.Work``."""
        from training.all_frequency import Clustered, fitted

        raw = self.raw(number, Given(given.path.with_name(self.scene)))
        vertices, starts, kept = (
            given[f"{name}.{number}"] for name in ("vertices", "starts", "kept")
        )
        segment, lost = fitted(raw, Clustered(vertices, starts, kept, 0.0, 0.0), kept)
        arrays = {name: getattr(segment, name) for name in OWN}
        arrays |= {name: getattr(segment.representatives, name) for name in SPARSE}
        columns = segment.representatives.shape[1]
        return {"lost": lost, "step": segment.step, "columns": columns}, arrays


def stages_elsewhere(
    place: Exchange,
    surface: Surface,
    visibility: CubeVisibility,
    rows: RowFactors,
    config: CompressConfig,
) -> Stages:
    """Both stages of ``training.all_frequency.compressed``, each segment a piece of work."""
    from training.all_frequency import Clustered

    given: dict[str, Any] = {name: getattr(surface, name) for name in SURFACE}
    given |= {"bits": visibility.bits, "view": rows.view}
    if rows.light is not None:
        given["light"] = rows.light
    raw = Raw(visibility.size, rows.light is None)
    scene = place.put(given)

    def clusters() -> Iterator[Clustered]:
        for header, arrays in place.ordered(ClusterSegment(raw, config), given, SEGMENTS):
            yield Clustered(**header, **arrays)

    def weights(
        found: Sequence[Clustered], kept: Sequence[FloatArray]
    ) -> Iterator[tuple[Segment, float]]:
        arrays: dict[str, Any] = {}
        for number, (one, own) in enumerate(zip(found, kept, strict=True)):
            each = {"vertices": one.vertices, "starts": one.starts, "kept": own}
            arrays |= {f"{name}.{number}": array for name, array in each.items()}
        for header, parts in place.ordered(FitSegment(raw, scene.path.name), arrays, SEGMENTS):
            yield segment_from(parts, header["columns"], header["step"]), header["lost"]

    return clusters, weights
