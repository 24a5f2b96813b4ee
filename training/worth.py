"""Which neurons, components, bands and bits of a model are worth their bytes.

A fold's model is taken apart on poses that it has not seen: what is left of each group's squared
error after its first components, band by band, with so many neurons. That is exact whatever is
left out, so the best model of every size has a closed form: for a price λ of a byte every cluster
takes what lowers *error + λ · bytes* most, on its own ("marginal error per byte"). A component that
only repeats the training clips brings less than nothing, and is not taken at any price.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from prtnet.arrays import BoolArray, FloatArray, IntArray
from prtnet.components import coding
from prtnet.model import Regressor, VisibilityModel

__all__ = [
    "Allocation",
    "Prices",
    "Unseen",
    "allocated",
    "allocations",
    "bought",
    "by_bands",
    "chosen_regressor",
    "expected",
    "unseen",
]

STEPS = 160  # prices tried
RANGE = 1e-6  # the least of them over the highest
SCALE = 8  # bytes of a component beside its integers: its scale, where it stands
COLUMN = 8  # of a latent in the last layer beside its weights: bias, scale, where it stands


@dataclass(frozen=True, eq=False)
class Unseen:
    """What a model's parts leave of the error on M sets of poses that it has not seen.

    Attributes:
        energy: Σ‖v‖² of each set's visibility, (M,).
        left: squared error after a group's first components in each band, for A numbers of
            neurons, (M, A, G, L + 1, n).
        latent: Σ of each predicted latent squared, (M, A, G, L).
    """

    energy: FloatArray
    left: FloatArray
    latent: FloatArray

    @staticmethod
    def joined(parts: Sequence[Unseen], width: int) -> Unseen:
        """The sets of all, L ``width``; a component that a set lacks brings nothing."""
        lefts, latents = [], []
        for part in parts:
            more = max(0, width - part.latent.shape[3])
            left = np.pad(part.left, (*3 * [(0, 0)], (0, more), (0, 0)), mode="edge")
            latent = np.pad(part.latent, (*3 * [(0, 0)], (0, more)))
            lefts.append(left[:, :, :, : width + 1])
            latents.append(latent[..., :width])
        energy = np.concatenate([part.energy for part in parts])
        return Unseen(energy, np.concatenate(lefts), np.concatenate(latents))


def unseen(
    models: Sequence[VisibilityModel], blocks: Iterable[tuple[FloatArray, FloatArray]]
) -> Unseen:
    """Take models apart on one set of poses.

    Args:
        models: in float32, that differ in their regressor alone.
        blocks: poses (B, D) that no fit of theirs saw, and their visibility (B, V, n²).
    """
    body = models[0]
    order, slots, groups = body.order, body.receivers.shape[1], len(body.latents)
    most = int(body.latents.max(initial=0))
    starts = body.first_component
    left = np.zeros((len(models), groups, most + 1, order))
    latent = np.zeros((len(models), groups, most))
    energy = 0.0
    for poses, truth in blocks:
        energy += float(np.sum(np.square(truth), dtype=np.float64))
        rest = truth - body.prior_part(poses)
        inputs = body.reduced(poses)  # they see the same
        values = np.stack([model.latent_of(inputs)[..., :most] for model in models])  # [A, B, G, L]
        latent += np.square(values).sum(axis=1)
        for group, count in enumerate(body.latents):
            own = body.receivers[group]
            away = np.where((own < 0)[:, None], 0.0, rest[:, np.maximum(own, 0)])
            away = away - body.mean[group].reshape(slots, order**2)
            basis = body.basis[starts[group] : starts[group] + count].reshape(
                count, slots, order**2
            )
            predicted = values[:, :, group, :count].astype(np.float64)
            for band in range(order):
                part = slice(band**2, (band + 1) ** 2)
                short = away[..., part].reshape(len(poses), -1)
                rows = basis[..., part].reshape(count, slots * (2 * band + 1))
                brought = band_changes(short @ rows.T, rows @ rows.T, predicted)
                left[:, group, 0, band] += np.square(short, dtype=np.float64).sum()
                left[:, group, 1 : count + 1, band] += brought
    left = np.cumsum(left, axis=2)[None].astype(np.float32)
    return Unseen(np.array([energy]), left, latent[None].astype(np.float32))


def band_changes(seen: FloatArray, gram: FloatArray, predicted: FloatArray) -> FloatArray:
    """How each component changes the squared error of one band, (A, L), after those before it.

    ‖r − Σ_{j≤l} p_j b_j‖² − ‖r − Σ_{j<l} p_j b_j‖² = p_l² ‖b_l‖² − 2 p_l ⟨r, b_l⟩
    + 2 p_l Σ_{j<l} p_j ⟨b_j, b_l⟩: in one band components are not orthogonal.

    Args:
        seen: ⟨r, b_l⟩ of what there is to explain, (B, L).
        gram: ⟨b_j, b_l⟩, (L, L).
        predicted: p, (A, B, L).
    """
    before = predicted @ np.triu(gram, 1)
    each = predicted * (predicted * np.diagonal(gram) - 2.0 * seen + 2.0 * before)
    total: FloatArray = each.sum(axis=1)
    return total


@dataclass(frozen=True, eq=False)
class Prices:
    """Bytes of a model's parts, and what rounding them costs.

    Attributes:
        slots: R of a group.
        parts: groups of a cluster.
        widths: how many numbers the last layer sees, (A,): neurons, ascending, or the inputs
            where there is no tanh layer, and nothing to choose.
        inputs: bytes of a cluster that gives any latents.
        inner: bytes of each of those numbers before the last layer.
        rounding: of a component of unit energy in 4 and in 8 bits, (2, G, L).
    """

    slots: int
    parts: int
    widths: IntArray
    inputs: int
    inner: int
    rounding: FloatArray


@dataclass(frozen=True, eq=False)
class Allocation:
    """What one price buys.

    Attributes:
        neurons: which of the numbers of neurons each cluster has, (C,); −1 for none at all.
        counts: components of each group, (G,).
        orders: their bands, (G,).
        bits: of every component that there could be, (G, L): 4 or 8.
    """

    neurons: IntArray
    counts: IntArray
    orders: IntArray
    bits: IntArray

    def same(self, other: Allocation) -> bool:
        """Whether both are the same model."""
        kept = np.arange(self.bits.shape[1]) < self.counts[:, None]
        pairs = (
            (self.neurons, other.neurons), (self.counts, other.counts),
            (self.orders, other.orders), (self.bits[kept], other.bits[kept]),
        )  # fmt: skip
        return all(np.array_equal(*pair) for pair in pairs[:3]) and np.array_equal(*pairs[3])


def allocations(known: Unseen, prices: Prices, latents: IntArray, step: int) -> list[Allocation]:
    """The best models of all sizes, the smallest first, that of nothing but means among them.

    Args:
        known: of the models.
        prices: of their parts.
        latents: components that each group has at most, (G,).
        step: a group has a multiple of so many, or all it can have.
    """
    votes = np.mean(known.left / np.maximum(known.energy, 1e-30)[:, None, None, None, None], axis=0)
    energy = np.mean(known.latent / np.maximum(known.energy, 1e-30)[:, None, None, None], axis=0)
    error = by_bands(votes)
    width = np.arange(votes.shape[2])
    allowed = ((width % step == 0) | (width == latents[:, None])) & (width <= latents[:, None])
    highest = (error[:, :, :1] - error).max() / (prices.slots / 2)
    found = [bought(np.inf, error, energy, prices, allowed)]
    for price in highest * np.geomspace(1.0, RANGE, STEPS) if highest > 0 else ():
        new = bought(price, error, energy, prices, allowed)
        if not new.same(found[-1]):
            found.append(new)
    return found


def by_bands(left: FloatArray) -> FloatArray:
    """(…, L + 1, n) errors in each band, to errors of components that end after each band."""
    here = np.cumsum(left, axis=-1)
    mean = left[..., :1, :]
    beyond = mean.sum(axis=-1, keepdims=True) - np.cumsum(mean, axis=-1)
    total: FloatArray = here + beyond
    return total


def bought(
    price: float, error: FloatArray, energy: FloatArray, prices: Prices, allowed: BoolArray
) -> Allocation:
    """What is worth buying at a price of a byte.

    Args:
        price: λ.
        error: (A, G, L + 1, n), of so many components with so many bands.
        energy: of each latent, (A, G, L).
        prices: of parts.
        allowed: numbers of components that a group may have, (G, L + 1).
    """
    numbers, groups, _, order = error.shape
    clusters = groups // prices.parts
    if not np.isfinite(price):
        nothing = np.zeros(groups, dtype=np.int64)
        none = np.full(clusters, -1)
        return Allocation(none, nothing, nothing + order, np.full(energy.shape[1:], 4))
    size = prices.slots * np.arange(1, order + 1) ** 2  # bytes in 8 bits, by bands
    four, eight = (
        (energy * rounding)[..., None] + price * size * part
        for rounding, part in zip(prices.rounding, (0.5, 1.0), strict=True)
    )
    column = price * (SCALE + COLUMN + prices.widths)[:, None, None, None]
    each = np.cumsum(np.minimum(four, eight) + column, axis=2)
    cost = error.astype(np.float64)
    cost[:, :, 1:] += each
    cost = np.where(allowed[None, :, :, None], cost, np.inf)
    flat = cost.reshape(numbers, groups, -1)
    choice = flat.argmin(axis=2)
    least = np.take_along_axis(flat, choice[..., None], axis=2)[..., 0]
    least = least.reshape(numbers, clusters, prices.parts).sum(axis=2)
    least += price * (prices.inputs + prices.inner * prices.widths)[:, None]
    number = least.argmin(axis=0)
    still = cost[0, :, 0, 0].reshape(clusters, prices.parts).sum(axis=1)
    dead = still <= least.min(axis=0)
    of_group = np.repeat(number, prices.parts)
    index = np.arange(groups)
    counts, bands = np.divmod(choice[of_group, index], order)
    counts = np.where(np.repeat(dead, prices.parts), 0, counts)
    dead |= counts.reshape(clusters, prices.parts).sum(axis=1) == 0
    cheaper = (four <= eight)[of_group, index, :, bands]
    return Allocation(
        np.where(dead, -1, number),
        counts,
        np.where(counts > 0, bands + 1, order),
        np.where(cheaper, 4, 8),
    )


def expected(known: Unseen, prices: Prices, found: Allocation) -> FloatArray:
    """Relative RMS of an allocation on each set, (M,)."""
    index = np.arange(len(found.counts))
    number = np.repeat(np.maximum(found.neurons, 0), prices.parts)
    left = by_bands(known.left[:, number, index].astype(np.float64))
    error = left[:, index, found.counts, found.orders - 1].sum(axis=1)
    kept = np.arange(found.bits.shape[1]) < found.counts[:, None]
    rounding = np.where(found.bits == 4, prices.rounding[0], prices.rounding[1])
    error += (known.latent[:, number, index] * rounding * kept).sum(axis=(1, 2))
    return np.sqrt(np.maximum(error, 0.0) / np.maximum(known.energy, 1e-30))


def allocated(models: Sequence[VisibilityModel], found: Allocation) -> VisibilityModel:
    """The model of an allocation, its components coded so.

    Args:
        models: of each number of neurons, that differ in their regressor alone.
        found: what to keep of them.
    """
    body, parts = models[0], len(found.counts) // len(found.neurons)
    starts = body.first_component
    rows = [start + np.arange(count) for start, count in zip(starts, found.counts, strict=True)]
    basis = body.basis[np.concatenate(rows).astype(np.int64)]
    kept = np.arange(found.bits.shape[1]) < found.counts[:, None]
    orders = np.repeat(found.orders, found.counts)
    regressor, neurons = chosen_regressor(models, found, parts)
    input_basis = body.input_basis
    if len(input_basis) == len(found.neurons):
        input_basis = np.where((found.neurons < 0)[:, None, None], 0.0, input_basis)
    return dataclasses.replace(
        body,
        input_basis=input_basis.astype(np.float32),
        regressor=regressor,
        latents=found.counts.astype(np.int32),
        basis=basis,
        neurons=neurons,
        metadata=chosen_facts(models, found),
    ).stored_as("int4", coding(basis, body.order**2, found.bits[kept], orders))


def chosen_facts(models: Sequence[VisibilityModel], found: Allocation) -> dict[str, Any]:
    """The header, with how the fits of the neurons went that clusters have; all fits' seconds."""
    used = [model for k, model in enumerate(models) if (found.neurons == k).any()] or models[:1]
    status: dict[str, int] = {}
    for model in used:
        for text, count in model.metadata["fit_status"].items():
            status[text] = status.get(text, 0) + count
    seconds = sum(model.metadata["seconds"]["fit"] for model in models)
    return {
        **models[0].metadata,
        "fit_status": status,
        "fits": [one for model in used for one in model.metadata["fits"]],
        "seconds": {**models[0].metadata["seconds"], "fit": seconds},
    }


def chosen_regressor(
    models: Sequence[VisibilityModel], found: Allocation, parts: int
) -> tuple[Regressor, IntArray | None]:
    """Each cluster's regressor out of those of the models, and its neurons (C,) if it has any."""
    most = int(found.counts.max(initial=0))
    own = models[0].regressor
    if own.hidden_weight is None or own.hidden_bias is None:
        return dataclasses.replace(
            own, weight=own.weight[..., :most], bias=own.bias[:, :most]
        ), None
    used = [m.regressor for k, m in enumerate(models) if (found.neurons == k).any()]
    widest = max((r.weight.shape[1] for r in used), default=0)
    clusters, inputs, _ = own.hidden_weight.shape
    weight = np.zeros((clusters * parts, widest, most), dtype=np.float32)
    bias = np.zeros((clusters * parts, most), dtype=np.float32)
    hidden_weight = np.zeros((clusters, inputs, widest), dtype=np.float32)
    hidden_bias = np.zeros((clusters, widest), dtype=np.float32)
    neurons = np.zeros(clusters, dtype=np.int32)
    for number, model in enumerate(models):
        one, mine = model.regressor, found.neurons == number
        width = one.weight.shape[1]
        if not mine.any() or one.hidden_weight is None or one.hidden_bias is None:
            continue
        groups = np.repeat(mine, parts)
        weight[groups, :width] = one.weight[groups, :, :most]
        bias[groups] = one.bias[groups, :most]
        hidden_weight[mine, :, :width] = one.hidden_weight[mine]
        hidden_bias[mine, :width] = one.hidden_bias[mine]
        neurons[mine] = width
    return Regressor(weight, bias, hidden_weight, hidden_bias), neurons
