"""Priors: what every receiver's surroundings say of its visibility, before any cluster speaks.

Two of them. *Maps*: a linear map for each cluster from the sums over caps and their saturated form
to the deviation of visibility from its mean. *Network*: one small network of tanh layers for all
receivers, which also sees each receiver's mean visibility and a few learned numbers of its own.
Features are kept within the range of training; outside it both go on as at its border.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.skin_surroundings import SkinSurroundings
from prtnet.surroundings import Surroundings

__all__ = ["MapPrior", "NetworkPrior", "Prior", "prior_from_arrays", "saturated"]

SURROUNDINGS: dict[str, type[SkinSurroundings]] = {SkinSurroundings.kind: SkinSurroundings}


class Prior(ABC):
    """Flattened poses (P, D) to deviations (P, V, n²) from the mean visibility.

    Attributes:
        surroundings: what receivers see.
        low, high: least and greatest value of each feature in training, (F,).
    """

    kind: ClassVar[str]
    surroundings: Surroundings
    low: FloatArray
    high: FloatArray

    def __call__(self, poses: FloatArray, mean: FloatArray) -> FloatArray:
        """Deviations (P, V, n²) float32; ``mean`` is the model's mean visibility, (V, n²)."""
        everyone = np.arange(self.surroundings.receiver_count)
        out = np.empty((len(poses), *mean.shape), dtype=np.float32)
        for pose in range(len(poses)):
            features = self.surroundings(poses[pose : pose + 1])[0]
            out[pose] = self.deviation(features, everyone, mean)
        return out

    @abstractmethod
    def deviation(self, features: FloatArray, receivers: IntArray, mean: FloatArray) -> FloatArray:
        """Deviations (N, n²) of receivers (N,) that see ``features`` (N, F)."""

    def arrays(self) -> dict[str, Any]:
        """The arrays that define it, those of its surroundings under ``sees.…``."""
        seen = {f"sees.{name}": array for name, array in self.surroundings.arrays().items()}
        return {**seen, **self.own_arrays()}

    @abstractmethod
    def own_arrays(self) -> dict[str, FloatArray | IntArray]:
        """The arrays besides those of the surroundings."""


def saturated(features: FloatArray) -> FloatArray:
    """Each feature f as f / (1 + |f|/2): many caps on top of each other cover little more."""
    return features / (1.0 + 0.5 * np.abs(features))


@dataclass(frozen=True, eq=False)
class MapPrior(Prior):
    """A linear map for each cluster.

    Attributes:
        cluster: of each receiver, (V,).
        maps: from features and their saturated form to deviations, (C, 2 · F, n²).
        shift: added at each receiver, so that its deviation has no mean in training, (V, n²).
    """

    kind: ClassVar[str] = "maps"
    surroundings: Surroundings
    low: FloatArray
    high: FloatArray
    cluster: IntArray
    maps: FloatArray
    shift: FloatArray

    def deviation(self, features: FloatArray, receivers: IntArray, mean: FloatArray) -> FloatArray:
        """See :class:`Prior`."""
        kept = np.clip(features, self.low, self.high)
        both = np.concatenate([kept, saturated(kept)], axis=-1)
        out = self.shift[receivers].astype(np.float32)
        own = self.cluster[receivers]
        for cluster in np.unique(own):
            members = own == cluster
            out[members] += both[members] @ self.maps[cluster]
        return out

    def own_arrays(self) -> dict[str, FloatArray | IntArray]:
        """See :class:`Prior`."""
        names = ("low", "high", "cluster", "maps", "shift")
        return {name: getattr(self, name) for name in names}


@dataclass(frozen=True, eq=False)
class NetworkPrior(Prior):
    """One network for all receivers.

    Its inputs: the features, their saturated form, the receiver's mean visibility, its code.

    Attributes:
        code: learned numbers of each receiver, (V, G).
        weights, biases: of the layers, (inputs, neurons), …, (neurons, n²); tanh between them.
    """

    kind: ClassVar[str] = "network"
    surroundings: Surroundings
    low: FloatArray
    high: FloatArray
    code: FloatArray
    weights: tuple[FloatArray, ...]
    biases: tuple[FloatArray, ...]

    def deviation(self, features: FloatArray, receivers: IntArray, mean: FloatArray) -> FloatArray:
        """See :class:`Prior`."""
        kept = np.clip(features, self.low, self.high)
        value = np.concatenate(
            [kept, saturated(kept), mean[receivers], self.code[receivers]], axis=-1
        )
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            value = (np.tanh(value) if layer else value) @ weight + bias
        return value.astype(np.float32, copy=False)

    def own_arrays(self) -> dict[str, FloatArray | IntArray]:
        """See :class:`Prior`."""
        layers = {f"weight{i}": weight for i, weight in enumerate(self.weights)}
        layers |= {f"bias{i}": bias for i, bias in enumerate(self.biases)}
        return {"low": self.low, "high": self.high, "code": self.code, **layers}


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
    inner = {n.removeprefix("sees."): a for n, a in arrays.items() if n.startswith("sees.")}
    surroundings = SURROUNDINGS[seen].from_arrays(inner)
    low, high = arrays["low"], arrays["high"]
    if low.shape != (surroundings.feature_count,) or high.shape != low.shape:
        raise ValueError("prior.low and prior.high do not fit the features")
    if kind == MapPrior.kind:
        own = {name: arrays[name] for name in ("cluster", "maps", "shift")}
        if own["maps"].shape[1] != 2 * len(low) or own["cluster"].max() >= len(own["maps"]):
            raise ValueError("prior.maps does not fit the features and clusters")
        return MapPrior(surroundings, low, high, **own)
    if kind == NetworkPrior.kind:
        layers = range(sum(name.startswith("weight") for name in arrays))
        weights = tuple(arrays[f"weight{i}"] for i in layers)
        biases = tuple(arrays[f"bias{i}"] for i in layers)
        width = 2 * len(low) + weights[-1].shape[1] + arrays["code"].shape[1]
        for weight, bias in zip(weights, biases, strict=True):
            if weight.shape != (width, len(bias)):
                raise ValueError("the layers of the prior's network do not fit each other")
            width = len(bias)
        return NetworkPrior(surroundings, low, high, arrays["code"], weights, biases)
    raise KeyError(kind)
