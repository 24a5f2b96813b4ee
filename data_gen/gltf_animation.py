"""Nodes and animations of a glTF file [1, sections 3.5 and 3.11] as a rig and clips.

[1] glTF 2.0 specification, Khronos Group.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from data_gen.gltf_buffers import Buffers
from data_gen.gltf_document import Document, Element
from prtnet.animation import Channel, Clip, Rig, normalised
from prtnet.arrays import FloatArray, IntArray

__all__ = [
    "Hierarchy",
    "default_weights",
    "read_clips",
    "read_hierarchy",
    "read_rig",
    "unique_names",
]

LONGEST_SECONDS = 86400  # nobody samples more than a day of poses: such times are damage
KINDS = {"translation": ("VEC3", 3), "rotation": ("VEC4", 4), "scale": ("VEC3", 3)}
REST = {"translation": (0.0, 0.0, 0.0), "rotation": (0.0, 0.0, 0.0, 1.0), "scale": (1.0, 1.0, 1.0)}


@dataclass(frozen=True, eq=False)
class Hierarchy:
    """The nodes sorted so that parents come before their children.

    Attributes:
        order: the file's index of each sorted node, (N,).
        slot: the sorted index of each of the file's nodes, (N,).
        parents: sorted index of each sorted node's parent, -1 for a root, (N,).
        shown: the sorted nodes of the default scene.
    """

    order: list[int]
    slot: list[int]
    parents: IntArray
    shown: list[int]


def read_hierarchy(document: Document) -> Hierarchy:
    """Sort the nodes.

    Raises:
        PrtnetError: a node has two parents, or is among its own ancestors.
    """
    nodes = document.list("nodes")
    children = [node.integers("children", len(nodes)) for node in nodes]
    parent = [-1] * len(nodes)
    for index, below in enumerate(children):
        for child in below:
            if parent[child] >= 0:
                nodes[child].fail("has two parents")
            parent[child] = index
    order = [index for index in range(len(nodes)) if parent[index] < 0]
    for index in order:  # grows as it goes
        order.extend(children[index])
    if len(order) < len(nodes):
        looped = min(set(range(len(nodes))) - set(order))
        nodes[looped].fail("is its own ancestor, or hangs below one that is")
    slot = [0] * len(nodes)
    for place, index in enumerate(order):
        slot[index] = place
    shown: set[int] = set()
    roots = scene_roots(document, len(nodes))
    for index in order:
        if roots is None or index in roots or parent[index] in shown:
            shown.add(index)
    parents = np.array([slot[parent[i]] if parent[i] >= 0 else -1 for i in order], dtype=np.int32)
    return Hierarchy(order, slot, parents, [slot[index] for index in order if index in shown])


def scene_roots(document: Document, count: int) -> set[int] | None:
    """The default scene's nodes; None where the file has no scenes, and all of it is shown."""
    scenes = document.list("scenes")
    if not scenes:
        return None
    scene = scenes[document.root.integer("scene", 0, limit=len(scenes))]
    return set(scene.integers("nodes", count))


def read_rig(
    document: Document, hierarchy: Hierarchy, weights: FloatArray, weights_of_node: dict[int, slice]
) -> Rig:
    """The nodes at rest, with the morph weights they drive."""
    nodes = [document.list("nodes")[index] for index in hierarchy.order]
    rest = {key: np.tile(np.array(value), (len(nodes), 1)) for key, value in REST.items()}
    offset = np.tile(np.eye(4), (len(nodes), 1, 1))
    for slot, node in enumerate(nodes):
        for key, values in rest.items():
            given = node.floats(key, values.shape[1])
            if given is not None:
                values[slot] = given
        matrix = node.floats("matrix", 16)
        if matrix is not None:
            offset[slot] = matrix.reshape(4, 4).T
            if any(key in node for key in REST):
                node.fail("has both a matrix and a translation, rotation or scale")
    return Rig(
        unique_names(
            node.text("name", f"node_{hierarchy.order[i]}") for i, node in enumerate(nodes)
        ),
        hierarchy.parents,
        rest["translation"],
        normalised(rest["rotation"]),
        rest["scale"],
        offset,
        weights,
        weights_of_node,
    )


def unique_names(names: Iterable[str]) -> tuple[str, ...]:
    """The names, those that are taken followed by ``_2``, ``_3``, …"""
    given = list(names)
    taken: set[str] = set()
    tried: dict[str, int] = {}
    result = []
    for name in given:
        unique = name
        while unique in taken:
            tried[name] = tried.get(name, 1) + 1
            unique = f"{name}_{tried[name]}"
        taken.add(unique)
        result.append(unique)
    return tuple(result)


def read_clips(
    document: Document, buffers: Buffers, hierarchy: Hierarchy, weights_of_node: dict[int, slice]
) -> tuple[Clip, ...]:
    """All animations that move something; each runs from its first key to its last."""
    animations = document.list("animations")
    names = unique_names(a.text("name", f"animation_{i}") for i, a in enumerate(animations))
    clips = []
    for name, animation in zip(names, animations, strict=True):
        channels = read_channels(document, animation, buffers, hierarchy, weights_of_node)
        if channels:
            start = min(float(channel.times[0]) for channel in channels)
            end = max(float(channel.times[-1]) for channel in channels)
            clips.append(Clip(name, start, end, channels))
    return tuple(clips)


def read_channels(
    document: Document,
    animation: Element,
    buffers: Buffers,
    hierarchy: Hierarchy,
    weights_of_node: dict[int, slice],
) -> tuple[Channel, ...]:
    """The channels of an animation, without those that move no node or nothing of it."""
    nodes = document.list("nodes")
    samplers = animation.children("samplers")
    channels = []
    for element in animation.children("channels"):
        target = element.required("target")
        path = target.text("path")
        if "node" not in target or path not in (*KINDS, "weights"):
            continue  # extensions may animate other things
        index = target.integer("node", limit=len(nodes))
        node = hierarchy.slot[index]
        if path == "weights" and node not in weights_of_node:
            continue
        if path != "weights" and "matrix" in nodes[index]:
            nodes[index].fail(
                "is animated but given as a matrix", "export its translation, rotation and scale"
            )
        sampler = samplers[element.integer("sampler", limit=len(samplers))]
        morphs = weights_of_node.get(node, slice(0, 0))
        channels.append(read_channel(sampler, buffers, node, path, morphs.stop - morphs.start))
    return tuple(channels)


def read_channel(sampler: Element, buffers: Buffers, node: int, path: str, morphs: int) -> Channel:
    """One channel; keys at equal times are kept, and the last of them counts from there on."""
    mode = sampler.text("interpolation", "LINEAR")
    if mode not in ("LINEAR", "STEP", "CUBICSPLINE"):
        sampler.fail(f"unknown interpolation '{mode}'")
    times = buffers.floats(sampler, "input", "SCALAR")[:, 0]
    if (np.diff(times) < 0).any():
        sampler.fail("its key times run backwards")
    if np.abs(times).max() > LONGEST_SECONDS:
        sampler.fail(f"its keys lie beyond {LONGEST_SECONDS} seconds")
    kind, size = KINDS.get(path, ("SCALAR", morphs))
    values = buffers.floats(sampler, "output", kind, integers_normalised=True)
    shape = (len(times), 3, size) if mode == "CUBICSPLINE" else (len(times), size)
    if values.size != np.prod(shape):
        sampler.fail(f"has {values.size} numbers for {len(times)} keys of '{path}'")
    return Channel(node, path, times, values.reshape(shape), mode)  # type: ignore[arg-type]


def default_weights(node: Element, mesh: Element, morphs: int) -> FloatArray:
    """The rest weights (M,) of a node's mesh: the node's, else the mesh's, else zero."""
    for element in (node, mesh):
        weights = element.floats("weights", morphs)
        if weights is not None:
            return weights
    return np.zeros(morphs)
