"""The mannequin's clips: key poses in anatomical angles, baked to joint rotations.

A *control* is an anatomical angle in degrees (how far an arm is raised, how far a knee is bent)
that turns one joint or is shared by several. Key poses name the controls they set, a leading
``left.`` or ``right.`` sets one side, and what they leave out is neutral: standing, arms hanging.
Between keys the controls follow monotone cubics, which ease in and out and never overshoot. The
hips then move so that the feet stand on the floor.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

from data_gen.mannequin_rig import JOINT_NAMES, MIRROR, PARENTS, POSITIONS
from data_gen.mannequin_shape import ARM_DIRECTION
from prtnet.animation import Channel, Clip
from prtnet.arrays import FloatArray

__all__ = ["RANGES", "clips", "control_curves"]

Pose = Mapping[str, float]
Keys = Sequence[tuple[float, Pose]]
FPS = 30.0

X, Y, Z = np.eye(3)
ELBOW_AXIS = np.cross(ARM_DIRECTION, Z)  # bends the left forearm forwards


class Turn(NamedTuple):
    """A rotation by gain · control + offset degrees about an axis; the last turn acts first."""

    control: str
    axis: FloatArray
    gain: float = 1.0
    offset: float = 0.0


# control: (least, neutral, greatest) in degrees
TRUNK_RANGES = {
    "hips.bend": (-15, 0, 45), "hips.lean": (-14, 0, 14), "hips.twist": (-25, 0, 25),
    "trunk.bend": (-25, 0, 60), "trunk.lean": (-32, 0, 32), "trunk.twist": (-40, 0, 40),
    "head.bend": (-35, 0, 40), "head.lean": (-28, 0, 28), "head.turn": (-65, 0, 65),
}  # fmt: skip
SIDE_RANGES = {
    "arm.raise": (8, 16, 170), "arm.plane": (-60, 10, 120), "arm.twist": (-60, 0, 60),
    "elbow.bend": (0, 14, 125), "forearm.twist": (-60, 0, 60),
    "wrist.bend": (-50, 0, 60), "wrist.tilt": (-20, 0, 20),
    "leg.flex": (-25, 0, 100), "leg.open": (-10, 0, 45), "leg.turn": (-15, 0, 35),
    "knee.bend": (0, 2, 120), "ankle.lift": (-35, 2, 28), "toes.lift": (-5, 0, 40),
}  # fmt: skip
RANGES = TRUNK_RANGES | {
    f"{side}.{name}": limits for side in ("left", "right") for name, limits in SIDE_RANGES.items()
}

TRUNK_TURNS = {
    "hips": [Turn("hips.twist", Y), Turn("hips.lean", -Z), Turn("hips.bend", X)],
    "spine": [Turn(f"trunk.{n}", a, 0.5) for n, a in (("twist", Y), ("lean", -Z), ("bend", X))],
    "chest": [Turn(f"trunk.{n}", a, 0.5) for n, a in (("twist", Y), ("lean", -Z), ("bend", X))],
    "neck": [Turn(f"head.{n}", a, 0.5) for n, a in (("turn", Y), ("lean", -Z), ("bend", X))],
    "head": [Turn(f"head.{n}", a, 0.5) for n, a in (("turn", Y), ("lean", -Z), ("bend", X))],
}
# The collar bone takes a fifth of the arm's raise. At rest the arm is raised by 45 degrees: it is
# first let down, then raised in its plane, 0 sideways and 90 forwards.
SIDE_TURNS = {
    "shoulder": [Turn("arm.raise", Z, 0.2, -9.0)],
    "upper_arm": [
        Turn("arm.plane", -Y), Turn("arm.raise", Z, 0.8, 9.0), Turn("arm.plane", Y),
        Turn("arm.raise", Z, 0.0, -45.0), Turn("arm.twist", ARM_DIRECTION),
    ],
    "forearm": [Turn("elbow.bend", ELBOW_AXIS), Turn("forearm.twist", ARM_DIRECTION, 0.5)],
    "hand": [
        Turn("forearm.twist", ARM_DIRECTION, 0.5), Turn("wrist.bend", -Z),
        Turn("wrist.tilt", ELBOW_AXIS),
    ],
    "thigh": [Turn("leg.flex", -X), Turn("leg.open", Z), Turn("leg.turn", Y)],
    "shin": [Turn("knee.bend", X)],
    "foot": [Turn("ankle.lift", -X)],
    "toes": [Turn("toes.lift", -X)],
}  # fmt: skip

# Points of the left sole that may touch the floor, and their joints.
SOLE = (("foot", (0.112, 0.0, -0.06)), ("toes", (0.128, 0.0, 0.10)), ("toes", (0.136, 0.0, 0.16)))
CONTACT = 0.01  # metres: how far above the lowest a sole still counts as standing


def both(pose: Pose) -> dict[str, float]:
    """The pose with every two-sided control spelled out for each side."""
    result: dict[str, float] = {}
    for name, value in pose.items():
        sides = ("left.", "right.") if name in SIDE_RANGES else ("",)
        result.update({side + name: value for side in sides})
    return result


def control_curves(keys: Keys, times: FloatArray) -> dict[str, FloatArray]:
    """Every control in degrees at ``times`` (P,)."""
    poses = [both(pose) for _, pose in keys]
    at = [time for time, _ in keys]
    return {
        name: PchipInterpolator(at, [pose.get(name, neutral) for pose in poses])(times)
        for name, (_, neutral, _) in RANGES.items()
    }


def joint_rotations(curves: Mapping[str, FloatArray]) -> FloatArray:
    """Local rotations (P, J, 4) of all joints."""
    count = len(next(iter(curves.values())))
    result = np.zeros((count, len(JOINT_NAMES), 4))
    for joint, name in enumerate(JOINT_NAMES):
        side, _, part = name.partition("_")
        turns = TRUNK_TURNS[name] if name in TRUNK_TURNS else SIDE_TURNS[part]
        rotation = Rotation.identity(count)
        for turn in turns:
            sided = turn.control in SIDE_RANGES
            angle = curves[f"{side}.{turn.control}" if sided else turn.control]
            # A mirror image turns about the mirrored axis, the other way round.
            axis = -turn.axis * MIRROR if sided and side == "right" else turn.axis
            vector = np.radians(turn.gain * angle + turn.offset)[:, None] * axis
            rotation = rotation * Rotation.from_rotvec(vector)
        result[:, joint] = rotation.as_quat()
    return result


def sole_points(rotations: FloatArray) -> FloatArray:
    """The soles' points (P, 2, 3, 3) by side and point, the hips at their rest position."""
    turns: list[Rotation] = []
    origins: list[FloatArray] = []
    for joint, parent in enumerate(PARENTS):
        local = Rotation.from_quat(rotations[:, joint])
        if parent < 0:
            turns.append(local)
            origins.append(np.broadcast_to(POSITIONS[joint], (len(rotations), 3)))
        else:
            turns.append(turns[parent] * local)
            offset = POSITIONS[joint] - POSITIONS[parent]
            origins.append(origins[parent] + turns[parent].apply(offset))
    points = []
    for side, mirror in (("left", 1.0), ("right", MIRROR)):
        for name, at in SOLE:
            joint = JOINT_NAMES.index(f"{side}_{name}")
            points.append(
                origins[joint] + turns[joint].apply(np.multiply(at, mirror) - POSITIONS[joint])
            )
    return np.stack(points, axis=1).reshape(-1, 2, len(SOLE), 3)


def standing(rotations: FloatArray, planted: bool) -> FloatArray:
    """Hip positions (P, 3) that put the lowest sole on the floor.

    Args:
        rotations: local rotations (P, J, 4).
        planted: also keep the feet that stand where they stand at rest; otherwise walk on the spot.
    """
    points = sole_points(rotations)
    height = points[..., 1].min(axis=2)  # [P, 2]
    shift = np.zeros((len(points), 3))
    if planted:
        rest = np.stack([np.array([at for _, at in SOLE]) * m for m in (1.0, MIRROR)])
        weight = np.exp(-(height - height.min(axis=1, keepdims=True)) / CONTACT)
        weight /= weight.sum(axis=1, keepdims=True)
        shift = np.einsum("ps,psk->pk", weight, (rest - points).mean(axis=2))
    shift[:, 1] = -height.min(axis=1)
    return POSITIONS[0] + shift


def bake(name: str, curves: Mapping[str, FloatArray], times: FloatArray, planted: bool) -> Clip:
    """A clip with a key at each of ``times``."""
    rotations = joint_rotations(curves)
    channels = [Channel(0, "translation", times, standing(rotations, planted))]
    for joint in range(len(JOINT_NAMES)):
        values = rotations[:, joint]
        if np.abs(values - (0, 0, 0, 1)).max() > 1e-9:
            channels.append(Channel(joint, "rotation", times, values))
    return Clip(name, float(times[0]), float(times[-1]), tuple(channels))


def side(name: str, pose: Pose) -> dict[str, float]:
    """The pose for one side only."""
    return {f"{name}.{control}": value for control, value in pose.items()}


SQUAT = {"leg.flex": 95, "knee.bend": 115, "ankle.lift": 26, "hips.bend": 18, "trunk.bend": 22,
         "leg.open": 12, "leg.turn": 12, "head.bend": -20}  # fmt: skip
RANGE_OF_MOTION: Keys = [
    (0.0, {}),
    (0.7, {"arm.raise": 90, "arm.plane": 0, "elbow.bend": 4, "head.turn": 50}),
    (1.4, {"arm.raise": 168, "arm.plane": 20, "elbow.bend": 6, "head.bend": -25,
           "trunk.bend": -15, "wrist.bend": -30, "ankle.lift": -22, "toes.lift": 24}),
    (2.0, {"arm.raise": 95, "arm.plane": 60, "elbow.bend": 118, "head.turn": -50,
           "wrist.bend": 40}),
    (2.6, {"left.arm.raise": 82, "left.arm.plane": 112, "left.elbow.bend": 55,
           "right.arm.raise": 58, "right.arm.plane": 100, "right.elbow.bend": 60,
           "trunk.twist": 12}),
    (3.2, {"trunk.twist": 38, "arm.raise": 85, "arm.plane": 10, "elbow.bend": 20,
           "forearm.twist": 55, "hips.twist": 10}),
    (3.8, {"trunk.twist": -38, "arm.raise": 60, "arm.plane": 40, "elbow.bend": 90,
           "forearm.twist": -55, "hips.twist": -10}),
    (4.3, {"trunk.lean": 30, "right.arm.raise": 150, "right.arm.plane": 5, "left.arm.raise": 20,
           "head.lean": 22}),
    (4.8, {"trunk.lean": -30, "left.arm.raise": 150, "left.arm.plane": 5, "right.arm.raise": 20,
           "head.lean": -22}),
    (5.5, {**SQUAT, "arm.raise": 85, "arm.plane": 80, "elbow.bend": 10}),
    (6.1, {"left.leg.flex": 98, "left.knee.bend": 105, "left.leg.open": 25,
           "left.leg.turn": 25, "left.ankle.lift": -20, "arm.raise": 60,
           "arm.plane": 0, "right.arm.twist": 50, "left.arm.twist": -50, "elbow.bend": 70}),
    (6.7, {"right.leg.flex": 80, "right.knee.bend": 15, "arm.raise": 40, "arm.plane": -40,
           "right.ankle.lift": 20, "trunk.bend": 8}),
    (7.2, {"right.leg.open": 42, "right.leg.turn": 20, "hips.lean": 8, "arm.raise": 70,
           "arm.plane": 0, "wrist.bend": 50, "trunk.lean": 8}),
    (7.6, {"left.leg.flex": -22, "left.knee.bend": 80, "left.ankle.lift": -30, "trunk.bend": 20,
           "hips.bend": 15, "right.leg.flex": 15,
           "arm.raise": 70, "arm.plane": 60, "wrist.tilt": 18}),
    (8.2, {}),
]  # fmt: skip
REACH: Keys = [
    (0.0, {}),
    (0.7, {"right.arm.raise": 165, "right.arm.plane": 60, "right.elbow.bend": 8,
           "right.wrist.bend": -20, "head.bend": -30, "head.turn": -15, "trunk.lean": 12,
           "trunk.bend": -8, "ankle.lift": -20, "toes.lift": 22}),
    (1.3, {"right.arm.raise": 80, "right.arm.plane": 115, "right.elbow.bend": 25,
           "trunk.twist": 34, "head.turn": 30, "hips.twist": 12, "left.arm.plane": -30,
           "left.arm.raise": 25}),
    (2.0, {"left.arm.raise": 95, "left.arm.plane": 85, "left.elbow.bend": 10, "hips.bend": 8,
           "trunk.bend": 15, "trunk.twist": -25, "left.leg.flex": 35, "left.knee.bend": 35,
           "right.leg.flex": -8, "right.knee.bend": 10, "left.ankle.lift": 8}),
    (2.8, {"hips.bend": 40, "trunk.bend": 55, "head.bend": -20, "leg.flex": 82, "knee.bend": 62,
           "ankle.lift": 18, "right.arm.raise": 88, "right.arm.plane": 75,
           "right.elbow.bend": 8, "left.arm.raise": 60, "left.arm.plane": 40,
           "left.elbow.bend": 45}),
    (3.4, {"arm.raise": 130, "arm.plane": 75, "elbow.bend": 35, "head.bend": -15,
           "trunk.bend": -8}),
    (4.0, {}),
]  # fmt: skip
DANCE: Keys = [
    (0.0, {}),
    (0.5, {"hips.lean": 10, "trunk.lean": -16, "left.arm.raise": 120, "left.arm.plane": 30,
           "left.elbow.bend": 70, "right.arm.raise": 45, "right.arm.plane": 50,
           "right.elbow.bend": 95, "left.knee.bend": 30, "left.leg.flex": 22,
           "left.ankle.lift": -10, "head.lean": 12}),
    (1.0, {"hips.lean": -10, "trunk.lean": 16, "right.arm.raise": 120, "right.arm.plane": 30,
           "right.elbow.bend": 70, "left.arm.raise": 45, "left.arm.plane": 50,
           "left.elbow.bend": 95, "right.knee.bend": 30, "right.leg.flex": 22,
           "right.ankle.lift": -10, "head.lean": -12}),
    (1.6, {"leg.flex": 45, "knee.bend": 65, "ankle.lift": 20, "leg.open": 20, "leg.turn": 25,
           "trunk.twist": 28, "arm.raise": 75, "arm.plane": 55, "elbow.bend": 80,
           "head.turn": -35, "forearm.twist": 35}),
    (2.2, {"right.leg.flex": 65, "right.leg.open": 30, "right.knee.bend": 90,
           "right.leg.turn": 25, "right.ankle.lift": -25, "arm.raise": 140, "arm.plane": 10,
           "elbow.bend": 45, "trunk.twist": -15, "head.bend": -12, "wrist.bend": -25}),
    (2.8, {"left.leg.flex": -20, "left.leg.open": 12, "left.knee.bend": 25, "trunk.bend": 25,
           "left.ankle.lift": -20, "right.leg.flex": 18, "right.knee.bend": 28,
           "right.ankle.lift": 10, "left.arm.raise": 60, "left.arm.plane": -35,
           "right.arm.raise": 100, "right.arm.plane": 80, "right.elbow.bend": 30,
           "head.turn": 25}),
    (3.4, {"trunk.lean": 20, "trunk.twist": 20, "left.arm.raise": 30, "left.elbow.bend": 100,
           "right.arm.raise": 160, "right.arm.plane": 35, "right.elbow.bend": 60,
           "knee.bend": 22, "leg.flex": 14, "ankle.lift": 8, "leg.open": 10}),
    (4.0, {}),
]  # fmt: skip

STRIDE = 1.1  # seconds from a foot's strike to its next
# (phase of the stride, pose of one side); phase 0 is its heel's strike.
GAIT: Keys = [
    (0.00, {"leg.flex": 27, "knee.bend": 4, "ankle.lift": 2, "arm.raise": 26, "arm.plane": -55,
            "elbow.bend": 10}),
    (0.12, {"leg.flex": 22, "knee.bend": 16, "ankle.lift": -6, "arm.raise": 22, "arm.plane": -45,
            "elbow.bend": 11}),
    (0.30, {"leg.flex": 4, "knee.bend": 7, "ankle.lift": 5, "arm.raise": 13, "arm.plane": 10,
            "elbow.bend": 17}),
    (0.50, {"leg.flex": -12, "knee.bend": 10, "ankle.lift": 8, "toes.lift": 16,
            "arm.raise": 30, "arm.plane": 70, "elbow.bend": 32}),
    (0.62, {"leg.flex": -4, "knee.bend": 40, "ankle.lift": -17, "toes.lift": 22,
            "arm.raise": 27, "arm.plane": 62, "elbow.bend": 30}),
    (0.74, {"leg.flex": 18, "knee.bend": 60, "ankle.lift": 0, "arm.raise": 15, "arm.plane": 25,
            "elbow.bend": 20}),
    (0.87, {"leg.flex": 29, "knee.bend": 26, "ankle.lift": 5, "arm.raise": 17, "arm.plane": -30,
            "elbow.bend": 14}),
]  # fmt: skip


def walk_curves(times: FloatArray) -> dict[str, FloatArray]:
    """The controls of a steady walk: each side repeats GAIT, half a stride apart."""
    phase = times / STRIDE
    laps = [(lap + at, side("left", pose)) for lap in (-1, 0, 1) for at, pose in GAIT]
    stride = {d: control_curves(laps, (phase + d) % 1.0) for d in (0.0, 0.5)}
    curves = stride[0.0] | {f"right.{name}": stride[0.5][f"left.{name}"] for name in SIDE_RANGES}
    swing = np.cos(2 * np.pi * phase)  # 1 when the left foot is in front
    curves["hips.twist"] = -6.0 * swing
    curves["trunk.twist"] = 13.0 * swing
    curves["head.turn"] = -7.0 * swing
    sway = np.sin(2 * np.pi * phase)  # 1 when the left foot carries
    curves["hips.lean"], curves["trunk.lean"] = -3.0 * sway, 3.0 * sway
    curves["trunk.bend"] = np.full(len(times), 4.0)
    return curves


def frames(duration: float) -> FloatArray:
    """Key times from zero to ``duration`` in seconds."""
    return np.linspace(0.0, duration, round(duration * FPS) + 1)


def clips() -> tuple[Clip, ...]:
    """All clips; ``dance`` is meant to be held out of training."""
    told = {"range_of_motion": RANGE_OF_MOTION, "reach": REACH, "dance": DANCE}
    baked = {}
    for name, keys in told.items():
        times = frames(keys[-1][0])
        baked[name] = bake(name, control_curves(keys, times), times, planted=True)
    times = frames(2 * STRIDE)
    baked["walk"] = bake("walk", walk_curves(times), times, planted=False)
    return tuple(baked[name] for name in ("range_of_motion", "walk", "reach", "dance"))
