"""The end of every graph: from a cluster's last layer to latents, and from those to visibility.

Latents of all groups of receivers come out of one batched product, in one flat vector. Groups with
equally many latents are then rebuilt by one batched product each; a last latent that is always one
carries their mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.model import VisibilityModel
from prtnet.storage import Stored
from training.onnx_components import component_nodes
from training.onnx_graph import GraphBuilder
from training.onnx_lobes import lobe_nodes

__all__ = ["LatentLayer", "Places", "latent_layer", "mean_nodes", "visibility_nodes"]


@dataclass(frozen=True, eq=False)
class Places:
    """Where in flat latents to find them.

    Attributes:
        first: where each group's latents begin, (G,); anything for a group that has none.
        one: where there is a one.
    """

    first: IntArray
    one: int


@dataclass(frozen=True, eq=False)
class LatentLayer(Places):
    """The layer that gives every cluster's latents, and where in the flattened (C · M) they are.

    Attributes:
        weight, bias: (C, N or K, M) as stored and (C, 1, M): the latents of a cluster's groups
            side by side, then zeros.
        ones: (C, 1, M), a one in the last column: what is added to the latents, after they fade.
    """

    weight: Stored
    bias: FloatArray
    ones: FloatArray


def latent_layer(model: VisibilityModel) -> LatentLayer:
    """The last layer of the model's regressor."""
    stored = model.stored("regressor.weight")
    groups, inner, most = stored.values.shape
    clusters = groups // model.parts
    cluster = np.arange(groups) // model.parts
    counts = model.latents.reshape(clusters, model.parts)
    before = (np.cumsum(counts, axis=1) - counts).ravel()
    width = int(counts.sum(axis=1).max()) + 1
    values = np.zeros((clusters, inner, width), dtype=stored.values.dtype)
    scale = np.ones((clusters, 1, width), dtype=np.float32)
    bias, ones = np.zeros((clusters, 1, width)), np.zeros((clusters, 1, width))
    ones[..., -1] = 1.0
    every = np.broadcast_to(stored.scale, (groups, 1, most))
    for group, count in enumerate(model.latents):
        own = slice(before[group], before[group] + count)
        values[cluster[group], :, own] = stored.values[group, :, :count]
        scale[cluster[group], 0, own] = every[group, 0, :count]
        bias[cluster[group], 0, own] = model.regressor.bias[group, :count]
    first = cluster * width + before
    return LatentLayer(first, width - 1, Stored(values, scale), bias, ones)


def visibility_nodes(
    graph: GraphBuilder, model: VisibilityModel, latents: str, places: Places,
    prior: str | None = None,
) -> None:  # fmt: skip
    """``visibility`` (P, V, n²) of flat latents (P, C · M), and of a prior's part (P, V, n²)."""
    order = np.argsort(model.latents, kind="stable")
    coded = None
    if model.coding is not None:
        coded = component_nodes(graph, model.coding.encode(model.basis))
    parts = []
    for count in np.unique(model.latents):
        groups = order[model.latents[order] == count]
        index = np.full((len(groups), 1, count + 1), places.one)
        index[:, 0, :count] = places.first[groups, None] + np.arange(count)
        own = graph.node("Gather", latents, graph.index(index), axis=1)
        slots = graph.node("MatMul", own, row_nodes(graph, model, groups, int(count), coded))
        size = len(groups) * model.receivers.shape[1]
        parts.append(graph.reshape(slots, [-1, size, model.numbers]))
    every = parts[0] if len(parts) == 1 else graph.node("Concat", *parts, axis=1)
    position = np.empty_like(order)
    position[order] = np.arange(len(order))
    group, slot = np.divmod(model.slot_of_receiver, model.receivers.shape[1])
    place = position[group] * model.receivers.shape[1] + slot
    receivers = graph.index(place)
    if model.lobe_numbers is None and prior is None:
        graph.node("Gather", every, receivers, axis=1, output="visibility")
        return
    own = graph.node("Gather", every, receivers, axis=1)
    if model.lobe_numbers is not None:
        lobe_nodes(graph, model.lobe_numbers, own, model.receiver_count, "visibility")
    elif prior is not None:
        bounded_nodes(graph, model, graph.node("Add", own, prior))


def mean_nodes(graph: GraphBuilder, model: VisibilityModel, prior: str | None) -> None:
    """``visibility`` (P, V, n²) of a model without latents: its mean, and a prior's part."""
    means = graph.reshape(graph.stored(model.stored("mean")), [-1, model.numbers])
    place = graph.index(model.slot_of_receiver)
    mean = graph.node("Gather", means, place, axis=0)
    if model.lobe_numbers is not None:
        mean = graph.reshape(mean, [1, -1, model.numbers])
        mean = lobe_nodes(graph, model.lobe_numbers, mean, model.receiver_count)
    if prior is not None:
        bounded_nodes(graph, model, graph.node("Add", prior, mean))
        return
    # Something that has as many rows as there are poses, and is zero.
    first = graph.clip(graph.slice("pose", 0, 1, 1), 0.0, 0.0)
    graph.node("Add", graph.reshape(first, [-1, 1, 1]), mean, output="visibility")


def bounded_nodes(graph: GraphBuilder, model: VisibilityModel, value: str) -> None:
    """``visibility`` of (P, V, n²), within the model's bounds; Clip takes scalar ones only."""
    if model.bounds is None:
        graph.reshape(value, [-1, model.receiver_count, model.order**2], output="visibility")
        return
    low, high = (graph.constant(bound) for bound in model.bounds)
    over = graph.node("Relu", graph.node("Sub", value, high))
    under = graph.node("Relu", graph.node("Sub", low, value))
    graph.node("Add", graph.node("Sub", value, over), under, output="visibility")


def row_nodes(
    graph: GraphBuilder, model: VisibilityModel, groups: IntArray, count: int,
    coded: tuple[str, IntArray] | None,
) -> str:  # fmt: skip
    """(G', count + 1, R · n²) the groups' components, then their means, as they are stored.

    Args:
        graph: to add to.
        model: of the groups.
        groups: of so many components each, (G',).
        count: their number.
        coded: all components as a value, and their rows in it, where they are coded.
    """
    rows = model.first_component[groups, None] + np.arange(count)  # [G', count]
    mean = model.stored("mean")
    means = Stored(mean.values[groups][:, None], mean.scale[None], mean.offset)
    if count == 0:
        return graph.stored(means)
    if coded is not None:
        value, position = coded
        own = graph.node("Gather", value, graph.index(position[rows]), axis=0)
        return graph.node("Concat", own, graph.stored(means), axis=1)
    basis = model.stored("basis")
    every = Stored(basis.values[rows], np.broadcast_to(basis.scale, (len(basis.values), 1))[rows])
    if model.storage == "float32":
        return graph.constant(np.concatenate([every.values, means.values], axis=1))
    return graph.node("Concat", graph.stored(every), graph.stored(means), axis=1)
