"""The mannequin's skeleton: joints at rest and the bones that hold its skin.

All joints are aligned with the world's axes at rest, so a joint's rotation is its turn from there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from data_gen.mannequin_shape import ANKLE, ARM_DIRECTION, HIP, SHOULDER, WRIST
from prtnet.arrays import FloatArray, IntArray

__all__ = ["JOINT_NAMES", "PARENTS", "POSITIONS", "bones"]

ELBOW = SHOULDER + 0.275 * ARM_DIRECTION
KNEE = HIP + 0.445 * (ANKLE - HIP) / np.linalg.norm(ANKLE - HIP) + (0.0, 0.0, -0.004)
INSTEP = np.add(ANKLE, (0.0, 0.012, 0.0))
HEEL = np.add(ANKLE, (0.0, -0.01, -0.02))
COLLAR_END = np.add(SHOULDER, (-0.03, 0.02, 0.0))
THUMB_TIP = WRIST + 0.08 * ARM_DIRECTION + np.array((0.0, 0.0, 0.07))

# name: (parent, position at rest in metres); the sides' joints are those of the left.
TRUNK = {
    "hips": ("", (0.0, 0.95, -0.005)),
    "spine": ("hips", (0.0, 1.04, -0.005)),
    "chest": ("spine", (0.0, 1.18, -0.010)),
    "neck": ("chest", (0.0, 1.435, -0.020)),
    "head": ("neck", (0.0, 1.520, 0.000)),
}
SIDE = {
    "shoulder": ("chest", (0.035, 1.385, -0.015)),
    "upper_arm": ("shoulder", SHOULDER),
    "forearm": ("upper_arm", ELBOW),
    "hand": ("forearm", WRIST),
    "thigh": ("hips", (0.09, 0.915, -0.005)),
    "shin": ("thigh", KNEE),
    "foot": ("shin", INSTEP),
    "toes": ("foot", (0.128, 0.020, 0.095)),
}
MIRROR = np.array([-1.0, 1.0, 1.0])


def skeleton() -> tuple[tuple[str, ...], IntArray, FloatArray]:
    """Joint names, parents (J,) and positions (J, 3); parents come first."""
    table = {name: (parent, np.asarray(at)) for name, (parent, at) in TRUNK.items()}
    for side, mirror in (("left", 1.0), ("right", MIRROR)):
        for name, (parent, at) in SIDE.items():
            above = parent if parent in TRUNK else f"{side}_{parent}"
            table[f"{side}_{name}"] = (above, np.asarray(at) * mirror)
    names = tuple(table)
    parents = [names.index(parent) if parent else -1 for parent, _ in table.values()]
    return names, np.array(parents, dtype=np.int32), np.stack([at for _, at in table.values()])


JOINT_NAMES, PARENTS, POSITIONS = skeleton()

# Where the bones run: usually from joint to joint, but ribs and pelvis are broad, and a limb's bone
# starts a little inside it so that the trunk holds the skin around the joint.
TRUNK_BONES = {
    "hips": [((0, 0.87, -0.02), (0, 0.98, -0.01))],
    "spine": [((0, 1.05, 0.04), (0, 1.13, 0.045)), ((0, 1.05, -0.05), (0, 1.13, -0.05))],
    "chest": [((0, 1.19, 0.03), (0, 1.38, 0.0)), ((0, 1.19, -0.05), (0, 1.39, -0.05))],
    "neck": [((0, 1.435, -0.02), (0, 1.515, -0.01))],
    "head": [((0, 1.53, 0.0), (0, 1.66, 0.01)), ((0, 1.545, 0.02), (0, 1.53, 0.07))],
}
SIDE_BONES: dict[str, list[tuple[ArrayLike, ArrayLike]]] = {
    "hips": [((0, 0.985, 0.04), (0.105, 0.985, 0.01)), ((0, 0.965, -0.06), (0.105, 0.975, -0.03))],
    "spine": [((0.07, 1.06, 0.0), (0.07, 1.13, 0.0))],
    "chest": [((0.10, 1.19, 0.0), (0.105, 1.32, -0.01)), ((0.06, 1.20, 0.03), (0.07, 1.34, 0.02))],
    "shoulder": [((0.05, 1.385, -0.02), COLLAR_END)],
    "upper_arm": [(SHOULDER + 0.02 * ARM_DIRECTION, ELBOW)],
    "forearm": [(ELBOW, WRIST)],
    "hand": [
        (WRIST, WRIST + 0.16 * ARM_DIRECTION),
        (WRIST + 0.03 * ARM_DIRECTION, THUMB_TIP),
    ],
    "thigh": [((0.092, 0.88, 0.0), KNEE)],
    "shin": [(KNEE, INSTEP)],
    "foot": [(HEEL, (0.125, 0.025, 0.07))],
    "toes": [((0.128, 0.020, 0.095), (0.137, 0.018, 0.16))],
}


def bones() -> tuple[FloatArray, IntArray]:
    """Bone segments (S, 2, 3) at rest and the joint that moves each, (S,)."""
    rows = [(JOINT_NAMES.index(n), np.asarray(s)) for n, b in TRUNK_BONES.items() for s in b]
    for side, mirror in (("left", 1.0), ("right", MIRROR)):
        for name, group in SIDE_BONES.items():
            joint = JOINT_NAMES.index(name if name in TRUNK_BONES else f"{side}_{name}")
            rows += [(joint, np.asarray(segment) * mirror) for segment in group]
    return np.stack([segment for _, segment in rows]), np.array([joint for joint, _ in rows])
