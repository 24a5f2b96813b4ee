"""Model files: which numbers are written, which were read, and whether they fit each other.

Numbers that no group or cluster uses are not written: a regressor's arrays are rectangles for the
sake of one batched product, clusters differ in neurons, and groups in latents.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from prtnet.arrays import BoolArray, IntArray
from prtnet.components import Coding, from_bytes, to_bytes
from prtnet.prior import Prior, prior_from_arrays

if TYPE_CHECKING:
    from prtnet.model import VisibilityModel

__all__ = [
    "ARRAYS",
    "check_answer",
    "check_shapes",
    "flattened",
    "read_prior",
    "restored",
    "with_components",
    "without_components",
]

ARRAYS = ("input_mean", "input_basis", "latents", "receivers", "mean", "basis", "rest_tangents")
COMPONENTS = ("basis", "scale.basis", "coding.bits", "coding.orders", "coding.profile")
INPUT_PCA = ("input_basis", "scale.input_basis")
MOST_POSE = 1 << 24  # numbers of a pose: a cache of five million vertices
MOST_NUMBERS = 1 << 26  # of an array of the regressor, those that nothing uses among them
LAYERS = ("weight", "bias", "hidden_weight", "hidden_bias")  # of the regressor


def used_numbers(
    latents: IntArray, neurons: IntArray | None, shape: tuple[int, ...], hidden: bool
) -> BoolArray:
    """Which numbers of an array of the regressor anything uses.

    Args:
        latents: of each group, (G,).
        neurons: of each cluster, (C,); None for all there are.
        shape: of the array: (G, N, L) or (G, L), or (C, K, N) or (C, N) of the hidden layer.
        hidden: whether it is of the hidden layer.
    """
    count = neurons if hidden else latents
    if count is None:
        count = np.full(shape[0], shape[-1], dtype=np.int32)
    if (count < 0).any() or math.prod(shape) > MOST_NUMBERS:
        raise ValueError("latents or neurons are below zero, or too many")
    last: BoolArray = np.asarray(np.arange(shape[-1]) < count[:, None])
    if len(shape) == 2:
        return last
    inner: BoolArray = np.ones(shape[:2], dtype=bool)
    if not hidden and neurons is not None:
        own: BoolArray = np.asarray(np.arange(shape[1]) < neurons[:, None])
        inner = np.repeat(own, shape[0] // len(neurons), axis=0)
    every: BoolArray = inner[..., None] & last[:, None]
    return every


def layer_shape(name: str, arrays: Mapping[str, Any]) -> tuple[int, ...]:
    """Of an array of the regressor, from the others of the file."""
    groups, most = len(arrays["latents"]), int(arrays["latents"].max(initial=0))
    inputs = arrays["input_basis"].shape[2]
    neurons = arrays.get("neurons")
    if neurons is None:
        pairs = arrays.get("regressor.pairs")
        inner = inputs if pairs is None else inputs + pairs.shape[1]
        clusters = groups
    else:
        clusters, inner = len(neurons), int(neurons.max(initial=0))
    return {
        "weight": (groups, inner, most),
        "bias": (groups, most),
        "hidden_weight": (clusters, inputs, inner),
        "hidden_bias": (clusters, inner),
    }[name]


def with_latents(arrays: Mapping[str, Any]) -> BoolArray:
    """Which clusters have any latents, (C,); (1,) true where all share one input PCA."""
    clusters, latents = len(arrays["input_mean"]), arrays["latents"]
    if clusters <= 1 or len(latents) % clusters:
        return np.ones(clusters, dtype=bool)
    found: BoolArray = latents.reshape(clusters, -1).any(axis=1)
    return found


def flattened(arrays: dict[str, Any]) -> dict[str, Any]:
    """Arrays as they are written: of the regressor's the numbers that are used, one by one.

    So are a column's scales. A file without hidden layers has no ``neurons``, one with them always.
    Clusters without latents have no input PCA, where it is nothing but zeros.
    """
    flat = dict(arrays)
    alive = with_latents(arrays)
    if not alive.all() and not arrays["input_basis"][~alive].any():
        flat |= {name: arrays[name][alive] for name in INPUT_PCA if name in arrays}
    for layer in LAYERS:
        name, scale = f"regressor.{layer}", f"scale.regressor.{layer}"
        if name not in arrays:
            continue
        used = used_numbers(
            arrays["latents"], arrays.get("neurons"), arrays[name].shape,
            layer.startswith("hidden"),
        )  # fmt: skip
        flat[name] = arrays[name][used]
        if scale in arrays:
            flat[scale] = arrays[scale][used.any(axis=1, keepdims=True)]
            if not used.any():
                del flat[scale]
    return flat


def restored(flat: Mapping[str, Any]) -> dict[str, Any]:
    """The inverse of :func:`flattened`; numbers that nothing uses are zero.

    Raises:
        ValueError: an array has more or fewer numbers than are used.
        KeyError: one that others need is missing.
    """
    arrays = dict(flat)
    if "neurons" in flat and (flat["neurons"].size == 0 or len(flat["latents"]) == 0):
        raise ValueError("neurons or latents are empty")
    alive = with_latents(flat)
    if len(flat["input_basis"]) < len(alive):
        for name in INPUT_PCA:
            if name in flat:
                if len(flat[name]) != alive.sum():
                    raise ValueError(f"{name} does not fit the latents")
                arrays[name] = np.zeros((len(alive), *flat[name].shape[1:]), flat[name].dtype)
                arrays[name][alive] = flat[name]
    for layer in LAYERS:
        name, scale = f"regressor.{layer}", f"scale.regressor.{layer}"
        if name not in flat:
            continue
        shape = layer_shape(layer, flat)
        used = used_numbers(flat["latents"], flat.get("neurons"), shape, layer.startswith("hidden"))
        own: dict[str, BoolArray] = {name: used}
        if scale in flat:
            own[scale] = np.any(used, axis=1, keepdims=True)
        for key, mask in own.items():
            if flat[key].shape != (int(mask.sum()),):
                raise ValueError(f"{key} does not fit the latents and neurons")
            arrays[key] = np.zeros(mask.shape, dtype=flat[key].dtype)
            arrays[key][mask] = flat[key]
    return arrays


def without_components(model: VisibilityModel, arrays: dict[str, Any]) -> dict[str, Any]:
    """Arrays with the components of a model that codes them as bytes."""
    if model.coding is None:
        return arrays
    how, coded = model.coding, model.coding.encode(model.basis)
    orders, bits = how.orders.astype(np.uint8), how.bits.astype(np.uint8)
    return arrays | dict(
        zip(COMPONENTS, (to_bytes(coded), coded.scale, bits, orders, how.profile), strict=True)
    )


def with_components(
    arrays: dict[str, Any], order: int, storage: str
) -> tuple[dict[str, Any], Coding | None]:
    """The inverse: components as float32, and how they were coded, if they were.

    Raises:
        ValueError: the arrays do not fit each other.
    """
    if (storage == "int4") != ("coding.bits" in arrays):
        raise ValueError("components are coded, or not, against what storage says")
    if storage != "int4":
        return arrays, None
    data, scale, bits, orders, profile = (arrays[name] for name in COMPONENTS)
    how = Coding(bits.astype(np.int32), orders.astype(np.int32), profile)
    if not (
        np.isin(bits, (4, 8)).all() and bits.shape == orders.shape and profile.shape == (order**2,)
        and ((orders >= 1) & (orders <= order)).all()
    ):  # fmt: skip
        raise ValueError("coding does not fit the order")
    scales = np.concatenate([scale.ravel(), profile])
    if (data.dtype, scale.dtype) != (np.uint8, np.float32):
        raise ValueError("basis are no bytes, or their scales no numbers")
    if not ((scales > 0) & np.isfinite(scales)).all():
        raise ValueError("scales of the basis are not finite, or not above zero")
    basis = from_bytes(data, scale, how, arrays["receivers"].shape[1]).array()
    rest = {name: array for name, array in arrays.items() if name not in COMPONENTS}
    return rest | {"basis": basis}, how


def read_prior(header: Mapping[str, Any], arrays: dict[str, Any]) -> Prior | None:
    """The prior of a file, None where it has none."""
    if header.get("prior") is None:
        return None
    return prior_from_arrays(header["prior"], header["surroundings"], arrays)


def check_shapes(model: VisibilityModel) -> None:
    """Raise ValueError where arrays do not fit each other."""
    groups, slots = model.receivers.shape
    if model.lobes < 0 or (model.lobes > 0) != (model.kind == "lobes"):
        raise ValueError("the number of lobes does not fit the kind")
    width = slots * model.numbers
    expected = {
        "mean": (groups, width),
        "basis": (int(model.latents.sum()), width),
        "latents": (groups,),
    }
    for name, shape in expected.items():
        if getattr(model, name).shape != shape:
            raise ValueError(f"{name} has shape {getattr(model, name).shape}, expected {shape}")
    flat = np.sort(model.receivers[model.receivers >= 0])
    if not np.array_equal(flat, np.arange(model.receiver_count)):
        raise ValueError("receivers are not each in exactly one slot")
    width = int(model.latents.max(initial=0))
    inner = model.input_basis.shape[2]
    clusters = groups // model.parts
    if clusters * model.parts != groups or len(model.input_basis) not in (1, clusters):
        raise ValueError("clusters do not all have equally many groups")
    if model.regressor.hidden_weight is not None:
        neurons = model.regressor.weight.shape[1]
        if model.regressor.hidden_weight.shape != (clusters, inner, neurons):
            raise ValueError("regressor.hidden_weight does not fit the inputs and neurons")
        inner = neurons
    pairs = model.regressor.pairs
    if pairs is not None:
        if pairs.ndim != 2 or len(pairs) != 2 or not ((pairs >= 0) & (pairs < inner)).all():
            raise ValueError("regressor.pairs are no pairs of the inputs")
        inner += pairs.shape[1]
    if model.regressor.weight.shape[:2] != (groups, inner) or (
        model.regressor.weight.shape[2] < width
    ):
        raise ValueError("regressor.weight does not fit the clusters, inputs and latents")
    span = model.training_range()
    if span and [a.shape for a in span.values()] != 2 * [model.input_basis[:, 0].shape]:
        raise ValueError("input_low and input_high do not fit the inputs, or one is missing")
    every = {name: getattr(model, name) for name in ARRAYS} | span
    if model.prior is not None:
        count, size = model.prior.surroundings.receiver_count, model.order**2
        if (count, model.prior.answer_size) != (model.receiver_count, size):
            raise ValueError("the prior does not fit the receivers and the order")
        every |= {f"prior.{name}": array for name, array in model.prior.arrays().items()}
    if model.lobes and (model.signal is None or model.coding is not None):
        raise ValueError("lobes without their signal, or coded as visibility")
    if model.signal is not None:
        if model.signal.shape != (model.receiver_count, model.order**2):
            raise ValueError("signal does not fit the receivers and the order")
        every["signal"] = model.signal
    if model.bounds is not None:
        if model.bounds.shape != (2, model.order**2) or (model.bounds[0] > model.bounds[1]).any():
            raise ValueError("bounds do not fit the order, or each other")
        every["bounds"] = model.bounds
    every |= model.regressor.arrays() | model.features.arrays()
    for name, array in every.items():
        if not np.isfinite(array).all():
            raise ValueError(f"{name} holds values that are not finite")


def check_answer(model: VisibilityModel) -> None:
    """Raise where a model cannot be evaluated: indices and sizes then do not fit each other."""
    if not 0 < model.pose_size <= MOST_POSE:
        raise ValueError(f"pose_size is {model.pose_size}")
    answer = model(np.zeros((1, model.pose_size), dtype=np.float32))
    if answer.shape != (1, model.receiver_count, model.order**2):
        raise ValueError(f"visibility has shape {answer.shape}")
