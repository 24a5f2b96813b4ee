"""Clustered models of visibility: their file, and the plain NumPy evaluation all others must match.

For each cluster of receivers ("Arbitrary BRDFs" section 5): features of the pose, reduced by an
input PCA; a regressor from those to a few latents; an output PCA from the latents to the cluster's
visibility. Every cluster has the same number of receiver slots, so that all clusters are evaluated
as one batch; latents are counted cluster by cluster.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from prtnet import sh
from prtnet.array_file import MODEL, read_arrays, write_arrays
from prtnet.arrays import FloatArray, IntArray
from prtnet.components import Coding, coding, leading_bits
from prtnet.errors import MISFITS, PrtnetError
from prtnet.features import Features, features_from_arrays
from prtnet.limits import check_order
from prtnet.lobe_numbers import LobeNumbers
from prtnet.model_file import (
    ARRAYS,
    check_answer,
    check_shapes,
    flattened,
    read_prior,
    restored,
    with_components,
    without_components,
)
from prtnet.novelty import fade, novelty
from prtnet.prior import Prior, prior_from_arrays, prior_packings
from prtnet.storage import (
    STORAGES,
    Packing,
    Storage,
    Stored,
    pack,
    quantise,
    unpack,
)  # fmt: skip
from prtnet.time_range import is_seen
from prtnet.zh import Lobes

__all__ = ["FORMAT_VERSION", "INT4_OF_LOBES", "KINDS", "Regressor", "VisibilityModel"]

FORMAT_VERSION = 2
KINDS = ("constant", "linear", "quadratic", "neural", "hybrid", "shared", "lobes")
INT4_OF_LOBES = "int4 is made for the bands of visibility, not for lobes; use int8"


@dataclass(frozen=True, eq=False)
class Regressor:
    """Reduced inputs to latents, per cluster: linear, quadratic, or a layer of tanh (eq. 12).

    Attributes:
        weight: (C, N, L) from the hidden layer, or (C, K, L) from the inputs where there is none,
            or (C, K + Q, L) from the inputs and their products.
        bias: (C, L).
        hidden_weight, hidden_bias: (C, K, N) and (C, N); only of a layer of tanh.
        pairs: which inputs are multiplied, (2, Q); only of a quadratic regressor.
    """

    weight: FloatArray
    bias: FloatArray
    hidden_weight: FloatArray | None = None
    hidden_bias: FloatArray | None = None
    pairs: IntArray | None = None

    def __call__(self, inputs: FloatArray) -> FloatArray:
        """Latents (P, C, L) of reduced inputs (P, C, K)."""
        value = np.swapaxes(inputs, 0, 1)
        if self.pairs is not None:
            products = value[..., self.pairs[0]] * value[..., self.pairs[1]]
            value = np.concatenate([value, products], axis=-1)
        if self.hidden_weight is not None and self.hidden_bias is not None:
            value = np.tanh(value @ self.hidden_weight + self.hidden_bias[:, None])
        value = np.repeat(value, len(self.weight) // len(value), axis=0)
        return np.swapaxes(value @ self.weight + self.bias[:, None], 0, 1)

    def arrays(self) -> dict[str, FloatArray | IntArray]:
        """The arrays that are not None, by name."""
        named = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return {name: array for name, array in named.items() if array is not None}


@dataclass(frozen=True, eq=False)
class VisibilityModel:
    """A fitted model: pose in, every receiver's visibility in its local frame out.

    Attributes:
        kind: one of ``KINDS``.
        order: n of the spherical harmonics.
        features: what is computed of a pose.
        input_mean, input_basis: (1 or C, F) and (1 or C, F, K): x → (x − mean) · basis.
        regressor: from reduced inputs to latents.
        latents: how many of the L latents each cluster uses, (C,).
        receivers: the receiver in every slot of every cluster, (C, R); −1 for an empty slot.
        mean: each cluster's mean visibility, (C, R · n²); of kind ``lobes`` n² is the numbers that
            stand for a receiver's lobes, here and in ``basis``.
        basis: the clusters' principal components one after the other, (Σ latents, R · n²).
        rest_tangents: receivers' tangents at rest, (V, 3): they fix the local frames.
        metadata: format version, configuration, training and held-out errors, fingerprints; under
            ``storage`` how the arrays are stored. They hold the very values that are read back.
        input_low, input_high: range of the training poses' reduced inputs, (1 or C, K); None for a
            model that neither clamps its inputs nor fades far from training.
        prior: what receivers' surroundings say of their visibility, for kinds ``hybrid`` and
            ``shared``: mean and components are then those of what it leaves. None elsewhere.
        signal: visibility's mean over the training poses, (V, n²), beside a prior and of lobes;
            None elsewhere, where ``mean`` is just that.
        neurons: of each cluster's tanh layer, (C,): weights of the others are zero. None where all
            clusters use all.
        coding: how the components are stored; only under ``int4``.
        bounds: least and greatest value of each coefficient in training, (2, n²): beside a prior,
            which knows no mean to fade to, visibility is kept between them. None elsewhere.
        lobes: how many zonal lobes stand for visibility; 0 but for kind ``lobes``.
    """

    kind: str
    order: int
    features: Features
    input_mean: FloatArray
    input_basis: FloatArray
    regressor: Regressor
    latents: IntArray
    receivers: IntArray
    mean: FloatArray
    basis: FloatArray
    rest_tangents: FloatArray
    metadata: dict[str, Any] = field(default_factory=dict)
    input_low: FloatArray | None = None
    input_high: FloatArray | None = None
    prior: Prior | None = None
    signal: FloatArray | None = None
    neurons: IntArray | None = None
    coding: Coding | None = None
    bounds: FloatArray | None = None
    lobes: int = 0

    @property
    def receiver_count(self) -> int:
        """Number of receivers V."""
        return len(self.rest_tangents)

    @property
    def pose_size(self) -> int:
        """Length D of a flattened pose."""
        return int(self.metadata["pose_size"])

    @property
    def training_clips(self) -> frozenset[str]:
        """Names of the clips that training saw."""
        return frozenset(self.metadata.get("clips", ())) - frozenset(
            self.metadata.get("held_out", ())
        )

    def saw(self, clip: str) -> bool:
        """Whether training saw any of a clip, or of a part of one (``clip@start:end``)."""
        return is_seen(clip, self.training_clips, self.metadata.get("held_out", ()))

    @property
    def first_component(self) -> IntArray:
        """Where each group's components begin in ``basis``, (G,)."""
        return np.cumsum(self.latents) - self.latents

    @property
    def lobe_numbers(self) -> LobeNumbers | None:
        """How numbers stand for lobes; None where they are coefficients of visibility."""
        return LobeNumbers(self.lobes, self.order) if self.lobes else None

    @property
    def numbers(self) -> int:
        """How many numbers of a receiver are predicted: n², or those that stand for its lobes."""
        return self.lobe_numbers.size if self.lobe_numbers else self.order**2

    @property
    def slot_of_receiver(self) -> IntArray:
        """Where each receiver sits in the flattened (C · R) slots, (V,)."""
        flat = self.receivers.ravel()
        slots = np.empty(self.receiver_count, dtype=np.int32)
        slots[flat[flat >= 0]] = np.flatnonzero(flat >= 0)
        return slots

    @property
    def parts(self) -> int:
        """Groups of receivers in each cluster."""
        hidden = self.regressor.hidden_weight
        clusters = len(self.input_basis) if hidden is None else len(hidden)
        # A linear model of inputs that all clusters share has no cluster larger than a group.
        shared = hidden is None and clusters == 1
        return 1 if shared else max(1, len(self.receivers) // clusters)

    @property
    def storage(self) -> Storage:
        """How the file and the export hold the large arrays."""
        name: Storage = self.metadata.get("storage", "float32")
        return name

    def stored_as(self, storage: Storage, how: Coding | None = None) -> VisibilityModel:
        """The model whose arrays are rounded to what ``storage`` can hold.

        Args:
            storage: of the file and the export.
            how: components are coded under ``int4``; as they are already, or else the leading ones
                in 8 bits and the others in 4, when not given.

        Raises:
            PrtnetError: lobes in ``int4``, which knows bands of coefficients.
        """
        model = dataclasses.replace(self, metadata={**self.metadata, "storage": storage})
        if storage == "int4":
            if self.lobes:
                raise PrtnetError("--storage", INT4_OF_LOBES)
            how = how or self.coding or self.usual_coding()
            model = dataclasses.replace(model, coding=how, basis=how.encode(self.basis).array())
        else:
            model = dataclasses.replace(model, coding=None)
        owned: dict[str, dict[str, Any]] = {"": {}, "regressor": {}, "prior": {}}
        for name in model.packings:
            owner, _, attribute = name.rpartition(".")
            owned[owner][attribute] = model.stored(name).array()
        regressor = dataclasses.replace(self.regressor, **owned["regressor"])
        prior = self.prior
        if prior is not None:
            arrays = prior.arrays() | owned["prior"]
            prior = prior_from_arrays(prior.kind, prior.surroundings.kind, arrays)
        return dataclasses.replace(model, regressor=regressor, prior=prior, **owned[""])

    def usual_coding(self) -> Coding:
        """Of components whose energy their weights tell: what they see is of about unit size."""
        energy = np.square(self.regressor.weight, dtype=np.float64).sum(axis=1)
        used = np.arange(energy.shape[1]) < self.latents[:, None]
        return coding(self.basis, self.order**2, leading_bits(energy[used]))

    def stored(self, name: str) -> Stored:
        """An array as it is stored, by its name in the file."""
        owner, _, attribute = name.rpartition(".")
        if owner == "prior" and self.prior is not None:
            array = self.prior.arrays()[attribute]
        else:
            array = getattr(self.regressor if owner else self, attribute)
        return quantise(array, self.packings.get(name, Packing("float32")))

    @property
    def packings(self) -> dict[str, Packing]:
        """How each stored array is packed, by its name in the file; all else is float32.

        In 8 bits components have a scale each, means one a coefficient, as deviations from half a
        hemisphere open, what a prior leaves from zero, and matrices one a column. Those of a
        quadratic model stay in half precision: weights on products are small, products are large,
        and magnify the error of their inputs.
        """
        kind = self.storage
        if kind == "float32":
            return {}
        components: dict[str, Packing] = {} if kind == "int4" else {"basis": Packing(kind)}
        if kind == "int4":  # is of components alone
            kind = "int8"
        closed = sh.lower_hemisphere(self.order)
        half_open = closed / 2.0
        half_open[0] += math.sqrt(math.pi)
        inner: Storage = kind if self.regressor.pairs is None else "float16"
        matrices = {"input_basis": self.input_basis, "regressor.weight": self.regressor.weight}
        if self.regressor.hidden_weight is not None:
            matrices["regressor.hidden_weight"] = self.regressor.hidden_weight
        left = Packing(kind, axis=(-2, -1), period=self.numbers)
        visible = Packing(kind, axis=(-2, -1), period=self.order**2)
        signal = dataclasses.replace(visible, offset=half_open.astype(np.float32))
        beside = {} if self.signal is None else {"signal": signal}
        if self.prior is not None:
            own = prior_packings(self.prior, kind)
            beside |= {f"prior.{name}": packing for name, packing in own.items()}
        return {
            "mean": left if self.prior is not None or self.lobes else signal,
            **beside,
            **components,
            "rest_tangents": Packing("float16", axis=(-2, -1)),
            **{
                name: Packing(inner, axis=(-2, -1), period=matrix.shape[-1])
                for name, matrix in matrices.items()
                if matrix.size > 0
            },
        }

    def check_pose(self, poses: FloatArray) -> None:
        """Raise PrtnetError where poses are not (P, D) of this model, or not finite."""
        if poses.ndim != 2 or poses.shape[1] != self.pose_size:
            raise PrtnetError(
                "pose",
                f"has shape {poses.shape}, the model wants (poses, {self.pose_size}); "
                "it may belong to another scene",
            )
        if not np.isfinite(poses).all():
            raise PrtnetError("pose", "holds values that are not finite; check the animation")

    def reduced(self, poses: FloatArray) -> FloatArray:
        """Reduced inputs (P, C, K) of flattened poses (P, D)."""
        features = np.swapaxes(self.features(poses), 0, 1)  # [1 or C, P, F]
        inputs = (features - self.input_mean[:, None]) @ self.input_basis
        shape = (len(self.latents) // self.parts, *inputs.shape[1:])
        return np.swapaxes(np.broadcast_to(inputs, shape), 0, 1)

    def latent(self, poses: FloatArray) -> FloatArray:
        """Latents (P, C, L) of flattened poses (P, D); those a cluster does not use are zero."""
        return self.latent_of(self.reduced(poses))

    def latent_of(self, inputs: FloatArray) -> FloatArray:
        """The same of reduced inputs (P, C, K)."""
        used = np.arange(self.regressor.weight.shape[-1]) < self.latents[:, None]
        if self.input_low is None or self.input_high is None:
            return np.where(used, self.regressor(inputs), 0.0)
        known = np.clip(inputs, self.input_low, self.input_high)
        strength = fade(novelty(inputs, self.input_low, self.input_high)).astype(np.float32)
        strength = np.repeat(strength, self.parts, axis=1)  # [P, groups]
        return np.where(used, self.regressor(known) * strength[..., None], 0.0)

    def novelty(self, poses: FloatArray) -> FloatArray | None:
        """How far each cluster is from its training poses, (P, C), of flattened poses (P, D).

        See :func:`prtnet.novelty.novelty`; None where the model does not know its training range.
        """
        if self.input_low is None or self.input_high is None:
            return None
        return novelty(self.reduced(poses), self.input_low, self.input_high)

    def decode(self, latent: FloatArray) -> FloatArray:
        """Visibility (P, V, n²) float32 of latents (P, C, L)."""
        numbers = self.decoded(latent)
        return self.lobe_numbers.harmonics(numbers) if self.lobe_numbers else numbers

    def decoded(self, latent: FloatArray) -> FloatArray:
        """The numbers (P, V, N) float32 of latents (P, C, L): visibility, or lobes of it."""
        clusters, width = self.mean.shape
        slots = np.empty((len(latent), clusters, width), dtype=np.float32)
        for cluster, (start, count) in enumerate(
            zip(self.first_component, self.latents, strict=True)
        ):
            basis = self.basis[start : start + count]
            slots[:, cluster] = self.mean[cluster] + latent[:, cluster, :count] @ basis
        return slots.reshape(len(latent), -1, self.numbers)[:, self.slot_of_receiver]

    def encode(self, visibility: FloatArray) -> FloatArray:
        """The latents (P, C, L) that come closest to visibility (P, V, n²), or to numbers of it."""
        clusters = len(self.receivers)
        empty = (self.receivers < 0)[..., None]
        latent = np.zeros((len(visibility), clusters, int(self.latents.max(initial=0))))
        for cluster, (start, count) in enumerate(
            zip(self.first_component, self.latents, strict=True)
        ):
            own = visibility[:, np.maximum(self.receivers[cluster], 0)]
            own = np.where(empty[cluster], 0.0, own).reshape(len(visibility), -1)
            basis = self.basis[start : start + count]
            latent[:, cluster, :count] = (own - self.mean[cluster]) @ basis.T
        return latent

    def __call__(self, poses: FloatArray) -> FloatArray:
        """Visibility (P, V, n²) float32, local frames, of flattened poses (P, D)."""
        self.check_pose(poses)
        return self.bounded(self.decode(self.latent(poses)) + self.prior_part(poses))

    def lobes_of(self, poses: FloatArray) -> Lobes:
        """Visibility as lobes (P, V, c), local frames, of flattened poses (P, D).

        Raises:
            PrtnetError: the model is of another kind.
        """
        self.check_pose(poses)
        if self.lobe_numbers is None:
            raise PrtnetError("model", "predicts no lobes; train one with --kind lobes")
        return self.lobe_numbers.lobes(self.decoded(self.latent(poses)))

    def bounded(self, visibility: FloatArray) -> FloatArray:
        """Visibility (P, V, n²) within the bounds there are."""
        if self.bounds is None:
            return visibility
        return np.clip(visibility, self.bounds[0], self.bounds[1])

    def prior_part(self, poses: FloatArray) -> FloatArray:
        """What the prior gives (P, V, n²), or zeros that broadcast."""
        return np.zeros((1, 1, 1), dtype=np.float32) if self.prior is None else self.prior(poses)

    @property
    def training_mean(self) -> FloatArray:
        """Visibility's mean over the training poses, (V, n²)."""
        if self.signal is not None:
            return self.signal
        nothing = np.zeros((1, len(self.latents), int(self.latents.max(initial=0))))
        return self.decoded(nothing)[0]

    @cached_property
    def mean_lobes(self) -> Lobes:
        """Of kind ``lobes``: what fits of visibility start from, (V, c)."""
        return LobeNumbers(self.lobes, self.order).start(self.training_mean)

    def closest(self, poses: FloatArray, visibility: FloatArray) -> FloatArray:
        """The best that the components could do for visibility (P, V, n²) of poses (P, D)."""
        if self.lobe_numbers is not None:
            fitted = self.lobe_numbers.fitted(visibility, self.mean_lobes)
            return self.decode(self.encode(fitted))
        known = self.prior_part(poses)
        return self.bounded(self.decode(self.encode(visibility - known)) + known)

    def training_range(self) -> dict[str, FloatArray]:
        """The arrays ``input_low`` and ``input_high`` by name; none where they are not known."""
        named = {name: getattr(self, name) for name in RANGE_ARRAYS}
        return {name: array for name, array in named.items() if array is not None}

    def save(self, path: str | Path) -> None:
        """Write one ``.safetensors`` file: arrays, and a JSON header in its metadata."""
        header = {
            **self.metadata,
            "format_version": FORMAT_VERSION,
            "kind": self.kind,
            "order": self.order,
            "features": self.features.kind,
            "storage": self.storage,
            **({"lobes": self.lobes} if self.lobes else {}),
        }
        arrays = {name: getattr(self, name) for name in ARRAYS} | self.training_range()
        if self.prior is not None:
            header |= {"prior": self.prior.kind, "surroundings": self.prior.surroundings.kind}
            arrays |= {f"prior.{name}": a for name, a in self.prior.arrays().items()}
        arrays |= {n: getattr(self, n) for n in AROUND_ARRAYS if getattr(self, n) is not None}
        arrays |= {f"regressor.{name}": a for name, a in self.regressor.arrays().items()}
        arrays |= {f"features.{name}": a for name, a in self.features.arrays().items()}
        if self.regressor.hidden_bias is not None:
            whole = np.full(len(self.regressor.hidden_bias), self.regressor.hidden_bias.shape[1])
            arrays["neurons"] = whole if self.neurons is None else self.neurons
        arrays = without_components(self, pack(arrays, self.packings))
        write_arrays(path, header, flattened(arrays), MODEL)

    @classmethod
    @np.errstate(all="ignore")  # what overflows is not finite, which is refused
    def load(cls, path: str | Path) -> VisibilityModel:
        """Read a model file.

        Raises:
            PrtnetError: it is missing, not a model, damaged, or of another format version.
        """
        header, arrays = read_arrays(path, MODEL)
        version = header.get("format_version")
        if version != FORMAT_VERSION:
            raise PrtnetError(
                path,
                f"has format version {version}, this prtnet reads {FORMAT_VERSION}; train it anew",
            )
        try:
            parts: dict[str, dict[str, Any]] = {"features": {}, "regressor": {}, "prior": {}}
            storage = header.get("storage", "float32")
            if storage not in STORAGES:
                raise ValueError(f"no storage is called {storage}")
            order = int(header["order"])
            check_order(order)
            arrays, how = with_components(restored(arrays), order, storage)
            arrays = unpack(arrays)
            neurons = arrays.pop("neurons", None)
            if neurons is not None and (neurons == neurons.max()).all():
                neurons = None
            for name, array in arrays.items():
                room, _, rest = name.partition(".")
                if rest:
                    parts[room][rest] = array
            model = cls(
                kind=str(header["kind"]),
                order=order,
                features=features_from_arrays(header["features"], parts["features"]),
                regressor=Regressor(**parts["regressor"]),
                **{name: arrays[name] for name in ARRAYS},
                metadata=header,
                input_low=arrays.get("input_low"),
                input_high=arrays.get("input_high"),
                prior=read_prior(header, parts["prior"]),
                signal=arrays.get("signal"),
                bounds=arrays.get("bounds"),
                lobes=int(header.get("lobes", 0)),
                neurons=neurons,
                coding=how,
            )
            check_shapes(model)
            check_answer(model)
        except (*MISFITS, MemoryError) as error:
            raise PrtnetError(
                path, f"is not a whole prtnet model ({error}); train it anew"
            ) from error
        return model


RANGE_ARRAYS = ("input_low", "input_high")
AROUND_ARRAYS = ("signal", "bounds")  # of models with a prior, or of lobes
