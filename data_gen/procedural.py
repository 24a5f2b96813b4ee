"""Characters made by code, for the demonstration and for tests: a mannequin and an arm."""

from __future__ import annotations

import functools
import hashlib

import numpy as np
import scipy.sparse

from data_gen import mannequin_motion, mannequin_rig, mannequin_shape, skin_weights
from prtnet.animation import Channel, Clip, Rig
from prtnet.arrays import FloatArray, IntArray
from prtnet.errors import PrtnetError
from prtnet.scene import SkinnedScene, face_normals, unit

__all__ = ["HELD_OUT", "arm", "mannequin"]

HELD_OUT = ("dance",)  # the mannequin's clips that no model should be trained on
SHORTEST_EDGE, LONGEST_EDGE = 0.013, 0.06  # metres
HEAT_SPREAD = 1.0  # of skin weights; 1 is the paper's

ARM_LENGTHS = 0.30, 0.28  # metres: upper arm, forearm
ARM_RADII = 0.050, 0.036  # metres: at the shoulder, at the wrist
BLEND_LENGTH = 0.12  # metres over which the skin goes from one joint to the other
BEND_DEGREES = 140.0
BEND_SECONDS = 4.0


def skinned_scene(
    name: str,
    mesh: tuple[FloatArray, IntArray, FloatArray],
    weights: scipy.sparse.csr_array,
    skeleton: tuple[tuple[str, ...], IntArray, FloatArray],
    clips: tuple[Clip, ...],
) -> SkinnedScene:
    """A scene of one mesh whose joints are aligned with the world at rest.

    Args:
        name: of the scene.
        mesh: vertices (V, 3), triangles (T, 3) and normals (V, 3).
        weights: skin weights (V, J).
        skeleton: joint names, parents (J,) and rest positions (J, 3).
        clips: its animations.
    """
    vertices, faces, normals = mesh
    names, parents, origins = skeleton
    count = len(names)
    above = np.where((parents >= 0)[:, None], origins[parents], 0.0)
    rig = Rig(
        names=names,
        parents=parents,
        translation=origins - above,
        rotation=np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)),
        scale=np.ones((count, 3)),
        offset=np.tile(np.eye(4), (count, 1, 1)),
        weights=np.zeros(0),
        weights_of_node={},
    )
    inverse_bind = np.concatenate([np.tile(np.eye(3), (count, 1, 1)), -origins[:, :, None]], axis=2)
    positions = vertices.astype(np.float32)
    digest = hashlib.sha256(name.encode())
    keys = [values for clip in clips for channel in clip.channels
            for values in (channel.times, channel.values)]  # fmt: skip
    for array in (faces, positions, weights.toarray(), origins, *keys):
        digest.update(np.ascontiguousarray(array).tobytes())
    return SkinnedScene(
        name=name,
        path=None,
        sha256=digest.hexdigest(),
        faces=faces.astype(np.int32),
        clips=clips,
        rig=rig,
        joint_nodes=np.arange(count, dtype=np.int32),
        bone_joint=np.arange(count, dtype=np.int32),
        bone_inverse_bind=inverse_bind,
        weights=weights,
        positions=positions,
        normals=normals.astype(np.float32),
        morph_positions=np.zeros((0, len(vertices), 3), dtype=np.float32),
        morph_normals=np.zeros((0, len(vertices), 3), dtype=np.float32),
    )


@functools.lru_cache(maxsize=4)
def mannequin(edge: float = 0.016) -> SkinnedScene:
    """A smooth, closed mannequin of 21 joints, 1.7 m tall, facing +z, with four clips.

    The clips are ``range_of_motion``, ``walk``, ``reach`` and ``dance`` (see ``HELD_OUT``).

    Args:
        edge: length of the longest edges in metres, about; the default gives 6,000 vertices, 0.04
            gives 1,000, for fast tests.

    Raises:
        PrtnetError: the edges are too short or too long to describe the body.
    """
    if not SHORTEST_EDGE <= edge <= LONGEST_EDGE:
        limits = f"from {SHORTEST_EDGE} to {LONGEST_EDGE}"
        raise PrtnetError("mannequin", f"needs edges {limits} m long, not {edge}")
    vertices, faces, normals = mannequin_shape.build(edge)
    segments, joint = mannequin_rig.bones()
    heat = skin_weights.bone_heat(vertices, faces, segments, joint, HEAT_SPREAD)
    skeleton = mannequin_rig.JOINT_NAMES, mannequin_rig.PARENTS, mannequin_rig.POSITIONS
    return skinned_scene(
        "mannequin",
        (vertices, faces, normals),
        skin_weights.strongest(heat),
        skeleton,
        mannequin_motion.clips(),
    )


def capped_tube(segments: int) -> tuple[FloatArray, IntArray, FloatArray]:
    """A tapering limb along +x from the origin, closed by round caps: vertices, faces, normals."""
    length = sum(ARM_LENGTHS)
    near, far = ARM_RADII
    quarter = np.linspace(0.0, np.pi / 2, 200)
    x = np.linspace(0.0, length, 800)[1:-1]
    taper = far + (near - far) * 0.5 * (1 + np.cos(np.pi * x / length))
    profile = np.concatenate(
        [
            np.stack([-near * np.cos(quarter), near * np.sin(quarter)], axis=1),
            np.stack([x, taper], axis=1),
            np.stack([length + far * np.sin(quarter), far * np.cos(quarter)], axis=1),
        ]
    )  # [., 2] along the limb and away from its axis
    arc = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(profile, axis=0), axis=1)))
    rings = max(4, round(arc[-1] * segments / (np.pi * (near + far))))
    even = np.linspace(0.0, arc[-1], rings + 2)[1:-1]  # without the poles
    along, radius = (np.interp(even, arc, column)[:, None] for column in profile.T)
    angle = 2 * np.pi * np.arange(segments) / segments
    ring = np.stack(np.broadcast_arrays(
        along, radius * np.cos(angle), radius * np.sin(angle)
    ), axis=-1)  # fmt: skip
    poles = np.array([[-near, 0.0, 0.0], [length + far, 0.0, 0.0]])
    vertices = np.concatenate([ring.reshape(-1, 3), poles])

    index = np.arange(rings * segments).reshape(rings, segments)
    ahead = np.roll(index, -1, axis=1)
    a, b, c, d = index[:-1], index[1:], ahead[1:], ahead[:-1]
    start, end = np.full(segments, rings * segments), np.full(segments, rings * segments + 1)
    faces = np.concatenate([
        np.stack([a, c, b], axis=-1).reshape(-1, 3), np.stack([a, d, c], axis=-1).reshape(-1, 3),
        np.stack([start, ahead[0], index[0]], axis=-1),
        np.stack([end, index[-1], ahead[-1]], axis=-1),
    ]).astype(np.int32)  # fmt: skip
    weighted = np.repeat(face_normals(vertices, faces), 3, axis=0)
    sums = [np.bincount(faces.ravel(), weighted[:, k]) for k in range(3)]
    return vertices, faces, unit(np.stack(sums, axis=1))


def arm(segments: int = 28) -> SkinnedScene:
    """A smooth, closed limb with one moving joint and the clip ``bend``.

    The limb lies along +x, the joint ``forearm`` 0.3 m from its root; ``bend`` turns it about +z
    from 0 to 140 degrees and back in 4 s.

    Args:
        segments: vertices around the limb; 28 give about 2,000 in all, 8 about 170.

    Raises:
        PrtnetError: fewer than 3 segments.
    """
    if segments < 3:
        raise PrtnetError("arm", f"needs at least 3 segments, not {segments}")
    vertices, faces, normals = capped_tube(segments)
    elbow = ARM_LENGTHS[0]
    t = np.clip((vertices[:, 0] - elbow) / BLEND_LENGTH + 0.5, 0.0, 1.0)
    forearm = t * t * (3 - 2 * t)
    weights = scipy.sparse.csr_array(np.stack([1 - forearm, forearm], axis=1).astype(np.float32))
    times = np.linspace(0.0, BEND_SECONDS, 81)
    half = np.radians(BEND_DEGREES) / 4 * (1 - np.cos(2 * np.pi * times / BEND_SECONDS))
    turn = np.stack([0 * half, 0 * half, np.sin(half), np.cos(half)], axis=1)
    clip = Clip("bend", 0.0, BEND_SECONDS, (Channel(1, "rotation", times, turn),))
    origins = np.array([[0.0, 0.0, 0.0], [elbow, 0.0, 0.0]])
    skeleton = ("upper_arm", "forearm"), np.array([-1, 0], dtype=np.int32), origins
    return skinned_scene("arm", (vertices, faces, normals), weights, skeleton, (clip,))
