"""The limbs of a rig: which nodes must move together, and which can be recombined.

A branch starts where the hierarchy forks into limbs. A limb is a subtree that carries a fair share
of the skin's area: fingers stay with their arm. Some rigs hang a foot on the root instead of the
leg and animate its place (inverse kinematics, baked): such a node keeps its distance to a joint it
does not descend from. All branches between the two are then one, or recombining would tear them
apart.
"""

from __future__ import annotations

import numpy as np

from prtnet.animation import LocalPose
from prtnet.arrays import BoolArray, FloatArray, IntArray
from prtnet.scene import SkinnedScene, face_normals

__all__ = ["branches"]

LIMB = 0.02  # of the skin's area
LOOSE = 0.001  # of the body's size: a node whose place varies more is not fixed to its parent
KEPT = 0.1  # of that variation: a distance that varies less is kept


def branches(scene: SkinnedScene, moments: LocalPose) -> IntArray:
    """The branch of each node of the rig, (N,), counted from 0.

    Args:
        scene: the animated mesh.
        moments: what it was seen doing.
    """
    parents = scene.rig.parents
    areas = subtree_areas(scene)
    limb = areas > LIMB * areas.max(initial=0.0)
    limbs = np.bincount(parents[limb & (parents >= 0)], minlength=len(parents))
    starts = (parents < 0) | (limb & (limbs[parents] > 1))
    branch = np.cumsum(starts) - 1
    for node, parent in enumerate(parents):
        if not starts[node]:
            branch[node] = branch[parent]
    for node, partner in loose_ends(scene, moments, areas > 0):
        for member in path_between(parents, node, partner):
            branch[branch == branch[member]] = branch[node]
    return np.unique(branch, return_inverse=True)[1]


def subtree_areas(scene: SkinnedScene) -> FloatArray:
    """Area at rest of the skin that hangs on each node and on all below it, (N,)."""
    positions = scene.rest().positions[0].astype(np.float64)
    area = np.linalg.norm(face_normals(positions, scene.faces), axis=1) / 6
    vertex = np.bincount(scene.faces.ravel(), np.repeat(area, 3), scene.vertex_count)
    areas = np.zeros(len(scene.rig.parents))
    np.add.at(areas, scene.joint_nodes, vertex @ scene.joint_weights)
    for node in range(len(areas) - 1, 0, -1):
        if scene.rig.parents[node] >= 0:
            areas[scene.rig.parents[node]] += areas[node]
    return areas


def loose_ends(
    scene: SkinnedScene, moments: LocalPose, skinned: BoolArray
) -> list[tuple[int, int]]:
    """Nodes that move relative to their parent, each with the joint it keeps its distance to."""
    parents = scene.rig.parents
    places = scene.rig.model_matrices(moments)[..., :3, 3]  # [M, N, 3]
    size = np.ptp(scene.rest().positions[0], axis=0).max()
    spread = np.linalg.norm(np.std(moments.translation, axis=0), axis=1)
    pairs = []
    for node in np.flatnonzero((spread > LOOSE * size) & skinned & (parents >= 0)):
        family = np.isin(np.arange(len(parents)), path_between(parents, int(node), -1))
        family |= descendants(parents, int(node))
        distances = np.linalg.norm(places - places[:, node, None], axis=2)
        varies = np.std(distances, axis=0)
        varies[family | ~skinned] = np.inf
        partner = int(np.argmin(varies))
        if varies[partner] < KEPT * spread[node]:
            pairs.append((int(node), partner))
    return pairs


def descendants(parents: IntArray, node: int) -> BoolArray:
    """Which nodes are ``node`` or below it, (N,)."""
    below = np.zeros(len(parents), dtype=bool)
    below[node] = True
    for child, parent in enumerate(parents):
        below[child] |= parent >= 0 and below[parent]
    return below


def path_between(parents: IntArray, a: int, b: int) -> list[int]:
    """Nodes on the way from ``a`` to ``b``, without their common ancestor; b = −1: to the root."""
    lines = []
    for node in (a, b):
        line = []
        while node >= 0:
            line.append(node)
            node = int(parents[node])
        lines.append(line)
    common = set(lines[0]) & set(lines[1])
    return [node for line in lines for node in line if node not in common]
