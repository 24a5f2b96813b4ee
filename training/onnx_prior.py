"""Priors as nodes: what receivers see, then maps or the network, in receiver order."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from prtnet.arrays import IntArray
from prtnet.patches import PatchSurroundings
from prtnet.prior import MapPrior, NetworkPrior, Prior
from prtnet.skin_surroundings import SkinSurroundings
from prtnet.storage import Stored
from training.onnx_expression import Value
from training.onnx_graph import GraphBuilder
from training.onnx_patches import patch_nodes
from training.onnx_skin import cluster_slots, skin_nodes

__all__ = ["prior_nodes"]

WHOLE = 2**31 - 1  # the end of any axis


def prior_nodes(
    graph: GraphBuilder, prior: Prior, stored: Callable[[str], Stored], pose_size: int
) -> str:
    """(P, V, n²) the prior's part of visibility.

    Args:
        graph: with the input ``pose``.
        prior: maps or a network.
        stored: a learned array of the prior as it is stored, by its name.
        pose_size: length D of a flattened pose.
    """
    slots, features = seen_nodes(graph, prior, pose_size)  # [P, C, R, F]
    kept = clamped(Value(graph, features), prior)
    if isinstance(prior, MapPrior):
        both = graph.node("Concat", kept.name, (kept / (kept.magnitude() * 0.5 + 1.0)).name, axis=3)
        first = prior.cluster[slots[:, 0]]
        maps, size = stored("maps"), prior.maps.shape[2]
        own = Stored(maps.values[first], maps.scale, maps.offset)
        answer = graph.node("MatMul", both, graph.stored(own))
    elif isinstance(prior, NetworkPrior):
        answer, size = network_nodes(graph, prior, kept, slots, stored), len(prior.biases[-1])
    else:
        raise TypeError(f"no ONNX form of {type(prior).__name__}")
    flat = graph.reshape(answer, [-1, slots.size, size])
    place = np.empty(prior.surroundings.receiver_count, dtype=np.int32)
    place[slots.ravel()[::-1]] = np.arange(slots.size)[::-1]  # the first slot of each receiver
    return graph.node("Gather", flat, graph.index(place), axis=1)


def seen_nodes(graph: GraphBuilder, prior: Prior, pose_size: int) -> tuple[IntArray, str]:
    """Receivers in slots (C, R), and what they see (P, C, R, F)."""
    sees = prior.surroundings
    if isinstance(sees, SkinSurroundings):
        return cluster_slots(sees.cluster), skin_nodes(graph, sees)
    if not isinstance(sees, PatchSurroundings):
        raise TypeError(f"no ONNX form of {type(sees).__name__}")
    features = patch_nodes(graph, sees, pose_size)  # [P, V, F]
    if isinstance(prior, MapPrior):
        slots = cluster_slots(prior.cluster)
        return slots, graph.node("Gather", features, graph.constant(slots), axis=1)
    everyone = np.arange(sees.receiver_count)[None]
    return everyone, graph.reshape(features, [-1, *everyone.shape, sees.feature_count])


def clamped(features: Value, prior: Prior) -> Value:
    """Features kept within the range of training; Clip takes scalar bounds only."""
    low, high = prior.low, prior.high
    return features - (features - high).relu() + (low - features).relu()


def network_nodes(
    graph: GraphBuilder,
    prior: NetworkPrior,
    features: Value,
    slots: IntArray,
    stored: Callable[[str], Stored],
) -> str:
    """(P, C, R, n²). The code's part of the first layer is constant: runtimes fold it."""
    seen = len(prior.low)
    code = stored("code")
    own = Stored(code.values[slots], code.scale, code.offset)
    first = graph.stored(stored("weight0"))
    shift = graph.node("MatMul", graph.stored(own), graph.slice(first, seen, WHOLE, 0))
    shift = graph.node("Add", shift, graph.constant(prior.biases[0]))
    value = graph.node("MatMul", features.name, graph.slice(first, 0, seen, 0))
    value = graph.node("Add", value, shift)
    for layer in range(1, len(prior.weights)):
        value = graph.node(
            "MatMul", graph.node("Tanh", value), graph.stored(stored(f"weight{layer}"))
        )
        value = graph.node("Add", value, graph.constant(prior.biases[layer]))
    return value
