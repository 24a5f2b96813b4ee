"""Priors: what every receiver's surroundings say of its visibility, before any cluster speaks.

Two of them. *Maps*: a linear map for each cluster from what receivers see, and from its saturated
form, to a part of their visibility. *Network*: one small network of tanh layers for all receivers,
which also sees a few learned numbers of each receiver's own. Features are kept within the range of
training; outside it both go on as at its border.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.patches import PatchSurroundings
from prtnet.skin_surroundings import SkinSurroundings
from prtnet.storage import Packing, Storage
from prtnet.surroundings import Surroundings

__all__ = [
    "MapPrior",
    "NetworkPrior",
    "Prior",
    "prior_from_arrays",
    "prior_packings",
    "saturated",
]

FEW = 256  # numbers: a smaller table is not worth rounding

SURROUNDINGS: dict[str, Any] = {
    SkinSurroundings.kind: SkinSurroundings,
    PatchSurroundings.kind: PatchSurroundings,
}


class Prior(ABC):
    """Flattened poses (P, D) to a part of visibility (P, V, n²).

    Attributes:
        surroundings: what receivers see.
        low, high: least and greatest value of each feature in training, (F,).
    """

    kind: ClassVar[str]
    surroundings: Surroundings
    low: FloatArray
    high: FloatArray

    def __call__(self, poses: FloatArray) -> FloatArray:
        """Visibility (P, V, n²) float32, to be added to what clusters predict."""
        everyone = np.arange(self.surroundings.receiver_count)
        parts = [self.of_features(self.surroundings(pose[None])[0], everyone) for pose in poses]
        return np.stack(parts)

    def of_features(self, features: FloatArray, receivers: IntArray) -> FloatArray:
        """Visibility (N, n²) float32 of receivers (N,) that see ``features`` (N, F)."""
        return self._answer(np.clip(features, self.low, self.high), receivers)

    @property
    @abstractmethod
    def answer_size(self) -> int:
        """Number of coefficients n² it gives a receiver."""

    @abstractmethod
    def _answer(self, features: FloatArray, receivers: IntArray) -> FloatArray:
        """The same of features within their range."""

    def arrays(self) -> dict[str, Any]:
        """The arrays that define it, those of its surroundings under ``sees_…``."""
        seen = {f"sees_{name}": array for name, array in self.surroundings.arrays().items()}
        return {**seen, "low": self.low, "high": self.high, **self.matrices()}

    @abstractmethod
    def matrices(self) -> dict[str, Any]:
        """The learned arrays, by name."""

    @abstractmethod
    def with_matrices(self, matrices: dict[str, Any]) -> Prior:
        """The same with other learned arrays."""


def saturated(features: FloatArray) -> FloatArray:
    """Each feature f as f / (1 + |f|/2): many caps on top of each other cover little more."""
    return features / (1.0 + 0.5 * np.abs(features))


@dataclass(frozen=True, eq=False)
class MapPrior(Prior):
    """A linear map for each cluster.

    Attributes:
        cluster: of each receiver, (V,).
        maps: from features and their saturated form, (C, 2 · F, n²).
    """

    kind: ClassVar[str] = "maps"
    surroundings: Surroundings
    low: FloatArray
    high: FloatArray
    cluster: IntArray
    maps: FloatArray

    @property
    def answer_size(self) -> int:
        """See :class:`Prior`."""
        return self.maps.shape[2]

    def _answer(self, features: FloatArray, receivers: IntArray) -> FloatArray:
        both = np.concatenate([features, saturated(features)], axis=-1)
        out = np.empty((len(receivers), self.maps.shape[2]), dtype=np.float32)
        own = self.cluster[receivers]
        for cluster in np.unique(own):
            members = own == cluster
            out[members] = both[members] @ self.maps[cluster]
        return out

    def matrices(self) -> dict[str, Any]:
        """See :class:`Prior`."""
        return {"cluster": self.cluster, "maps": self.maps}

    def with_matrices(self, matrices: dict[str, Any]) -> MapPrior:
        """See :class:`Prior`."""
        if matrices["maps"].shape[1] != 2 * len(self.low):
            raise ValueError("prior.maps does not fit the features")
        if matrices["cluster"].max() >= len(matrices["maps"]):
            raise ValueError("prior.maps does not fit the clusters")
        return MapPrior(self.surroundings, self.low, self.high, **matrices)


@dataclass(frozen=True, eq=False)
class NetworkPrior(Prior):
    """One network for all receivers, of the features and the receiver's code.

    Attributes:
        code: learned numbers of each receiver, (V, G).
        weights, biases: of the layers, (F + G, neurons), …, (neurons, n²); tanh between them.
    """

    kind: ClassVar[str] = "network"
    surroundings: Surroundings
    low: FloatArray
    high: FloatArray
    code: FloatArray
    weights: tuple[FloatArray, ...]
    biases: tuple[FloatArray, ...]

    @property
    def answer_size(self) -> int:
        """See :class:`Prior`."""
        return len(self.biases[-1])

    def _answer(self, features: FloatArray, receivers: IntArray) -> FloatArray:
        value = np.concatenate([features, self.code[receivers]], axis=-1)
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            value = (np.tanh(value) if layer else value) @ weight + bias
        return value.astype(np.float32, copy=False)

    def matrices(self) -> dict[str, Any]:
        """See :class:`Prior`."""
        layers = {f"weight{i}": weight for i, weight in enumerate(self.weights)}
        layers |= {f"bias{i}": bias for i, bias in enumerate(self.biases)}
        return {"code": self.code, **layers}

    def with_matrices(self, matrices: dict[str, Any]) -> NetworkPrior:
        """See :class:`Prior`."""
        layers = range(sum(name.startswith("weight") for name in matrices))
        weights = tuple(matrices[f"weight{i}"] for i in layers)
        biases = tuple(matrices[f"bias{i}"] for i in layers)
        width = len(self.low) + matrices["code"].shape[1]
        for weight, bias in zip(weights, biases, strict=True):
            if weight.shape != (width, len(bias)):
                raise ValueError("the layers of the prior's network do not fit each other")
            width = len(bias)
        return NetworkPrior(
            self.surroundings, self.low, self.high, matrices["code"], weights, biases
        )


def prior_packings(prior: Prior, kind: Storage) -> dict[str, Packing]:
    """How each of the prior's arrays is stored, by its name.

    Learned matrices are stored as asked for, with a scale a column; what receivers see from is
    geometry, and never less than half precision.
    """
    packings = {}
    for name, array in prior.arrays().items():
        if not np.issubdtype(array.dtype, np.floating) or array.size < FEW or array.ndim < 2:
            continue
        if name.startswith("sees_"):
            packings[name] = Packing("float16", axis=tuple(range(-array.ndim, 0)))
        else:
            packings[name] = Packing(kind, axis=(-2, -1), period=array.shape[-1])
    return packings


def prior_from_arrays(kind: str, seen: str, arrays: dict[str, Any]) -> Prior:
    """The inverse of :meth:`Prior.arrays`.

    Args:
        kind: of the prior.
        seen: the kind of its surroundings.
        arrays: by name.

    Raises:
        KeyError: an array is missing, or a kind is unknown.
        ValueError: arrays do not fit each other.
    """
    inner = {n.removeprefix("sees_"): a for n, a in arrays.items() if n.startswith("sees_")}
    surroundings: Surroundings = SURROUNDINGS[seen].from_arrays(inner)
    low, high = arrays["low"], arrays["high"]
    if low.shape != (surroundings.feature_count,) or high.shape != low.shape:
        raise ValueError("prior.low and prior.high do not fit the features")
    learned = {
        name: array
        for name, array in arrays.items()
        if name not in ("low", "high") and not name.startswith("sees_")
    }
    empty = np.zeros((0, 0), dtype=np.float32)
    frames: dict[str, Prior] = {
        MapPrior.kind: MapPrior(surroundings, low, high, np.zeros(0, dtype=np.int32), empty),
        NetworkPrior.kind: NetworkPrior(surroundings, low, high, empty, (), ()),
    }
    return frames[kind].with_matrices(learned)
