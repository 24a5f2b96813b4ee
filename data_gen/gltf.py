"""glTF 2.0 scenes [1]: every mesh of a file's default scene in one skinned scene.

What the files do and do not say, and what is made of it:

- A mesh without a skin hangs on its node as on a joint; a mesh used by several nodes is there
  several times. The transform of a skinned mesh's own node is ignored, as [1] demands.
- Where no mesh has normals the scene is shaded flat in every pose. Where only some have, the
  others get the normals of their faces at rest. Either way their faces then share no vertex.
- Faces mirrored by their transform at rest are turned round, so that all are counter-clockwise.
- Skin weights need not sum to one (gltf_mesh.py), names need not be there or unique.

[1] glTF 2.0 specification, Khronos Group.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import scipy.sparse

from data_gen.gltf_animation import default_weights, read_clips, read_hierarchy, read_rig
from data_gen.gltf_buffers import Buffers
from data_gen.gltf_document import Document, Element, parse, read_bytes
from data_gen.gltf_mesh import Primitive, read_primitive, vertex_bound
from prtnet.arrays import FloatArray, IntArray
from prtnet.errors import PrtnetError
from prtnet.scene import SkinnedScene

__all__ = ["read_gltf"]

MAX_VERTICES = 2**22  # whose visibility, 256 MB a pose, nobody trains on
MAX_MORPH_OFFSETS = 2**25  # every target on every vertex: 0.8 GB


@dataclass(eq=False)
class Assembly:
    """The vertices, bones and morph targets gathered so far."""

    path: Path
    joints: dict[int, int] = field(default_factory=dict)  # node -> joint
    bones: dict[tuple[int, bytes], int] = field(default_factory=dict)  # joint, matrix -> bone
    pieces: list[Piece] = field(default_factory=list)
    vertices: int = 0
    rest_weights: list[FloatArray] = field(default_factory=list)
    weights_of_node: dict[int, slice] = field(default_factory=dict)
    morphs: int = 0

    def bone(self, node: int, inverse_bind: FloatArray) -> int:
        """The bone of a node and an inverse bind matrix (3, 4)."""
        joint = self.joints.setdefault(node, len(self.joints))
        return self.bones.setdefault((joint, inverse_bind.tobytes()), len(self.bones))

    def reserve(self, node: int, vertices: int, weights: FloatArray) -> None:
        """Make room for a node's mesh with its morph weights at rest.

        Raises:
            PrtnetError: there would be too much to hold.
        """
        self.vertices += vertices
        if self.vertices > MAX_VERTICES:
            raise PrtnetError(
                self.path, f"has over {MAX_VERTICES} vertices; simplify it, or export fewer meshes"
            )
        if len(weights):
            self.weights_of_node[node] = slice(self.morphs, self.morphs + len(weights))
            self.rest_weights.append(weights)
            self.morphs += len(weights)
        if self.morphs * self.vertices > MAX_MORPH_OFFSETS:
            raise PrtnetError(
                self.path,
                f"has {self.morphs} morph targets on {self.vertices} vertices, more than fit in "
                "memory; remove the targets that are not used",
            )

    def add(self, primitive: Primitive, node: int, slots: IntArray) -> None:
        """Append a primitive that hangs on ``node``, its joints naming bones through ``slots``."""
        self.pieces.append(
            Piece(primitive, slots, self.weights_of_node.get(node, slice(0, 0)).start)
        )


@dataclass(frozen=True, eq=False)
class Piece:
    """A primitive at its place in the scene: bones of its slots, and its first morph target."""

    primitive: Primitive
    slots: IntArray
    first_morph: int

    def weights(self, bones: int) -> scipy.sparse.coo_array:
        """Skin weights (V, bones)."""
        count = len(self.primitive.positions)
        joints, weights = self.primitive.joints, self.primitive.weights
        if joints is None or weights is None:
            joints, weights = np.zeros((count, 1), dtype=int), np.ones((count, 1))
        rows = np.repeat(np.arange(count), joints.shape[1])
        entries = weights.ravel(), (rows, self.slots[joints].ravel())
        return scipy.sparse.coo_array(entries, shape=(count, bones))


def read_gltf(path: Path) -> SkinnedScene:
    """Read the default scene of a ``.glb`` or ``.gltf`` file; its clips may be none.

    Raises:
        PrtnetError: the file is damaged, has no triangles, or uses what is not supported.
    """
    data = read_bytes(path)
    document = parse(path, data)
    buffers = Buffers(document)
    hierarchy = read_hierarchy(document)
    assembly = Assembly(path)
    for slot in hierarchy.shown:
        node = document.list("nodes")[hierarchy.order[slot]]
        if "mesh" in node:
            add_mesh(assembly, document, buffers, node, slot, hierarchy.slot)
    if not any(len(piece.primitive.faces) for piece in assembly.pieces):
        raise PrtnetError(path, "has no triangles in its default scene; export the mesh with it")
    rest = np.concatenate([np.zeros(0), *assembly.rest_weights])
    rig = read_rig(document, hierarchy, rest, assembly.weights_of_node)
    clips = read_clips(document, buffers, hierarchy, assembly.weights_of_node)
    digest = hashlib.sha256(data)
    for buffer in buffers.external():
        digest.update(buffer)
    positions, normals, faces, weights, morphs = merge(assembly)
    scene = SkinnedScene(
        name=path.stem,
        path=path,
        sha256=digest.hexdigest(),
        faces=faces.astype(np.int32),
        clips=clips,
        rig=rig,
        joint_nodes=np.array(list(assembly.joints), dtype=np.int32),
        bone_joint=np.array([joint for joint, _ in assembly.bones], dtype=np.int32),
        bone_inverse_bind=np.array([np.frombuffer(m).reshape(3, 4) for _, m in assembly.bones]),
        weights=weights,
        positions=positions.astype(np.float32),
        normals=None if normals is None else normals.astype(np.float32),
        morph_positions=morphs[0],
        morph_normals=morphs[1],
    )
    return turned_outward(scene)


def add_mesh(
    assembly: Assembly,
    document: Document,
    buffers: Buffers,
    node: Element,
    slot: int,
    slot_of_node: list[int],
) -> None:
    """Append a node's mesh to the assembly; ``slot`` is the node's place in the rig."""
    meshes, skins = document.list("meshes"), document.list("skins")
    mesh = meshes[node.integer("mesh", limit=len(meshes))]
    primitives = mesh.children("primitives")
    morphs = max((len(primitive.children("targets")) for primitive in primitives), default=0)
    bound = sum(vertex_bound(primitive, buffers) for primitive in primitives)
    assembly.reserve(slot, bound, default_weights(node, mesh, morphs))
    skin = None
    if "skin" in node:
        skin = skins[node.integer("skin", limit=len(skins))]
    for element in primitives:
        primitive = read_primitive(element, buffers)
        if primitive is None:
            continue
        if skin is None or primitive.joints is None:
            rigid = replace(primitive, joints=None, weights=None)
            assembly.add(rigid, slot, np.array([assembly.bone(slot, np.eye(4)[:3])]))
        else:
            slots = skin_bones(assembly, document, buffers, skin, slot_of_node)
            assembly.add(checked(primitive, skin, len(slots)), slot, slots)


def skin_bones(
    assembly: Assembly,
    document: Document,
    buffers: Buffers,
    skin: Element,
    slot_of_node: list[int],
) -> IntArray:
    """The bone of every joint that a skin lists, (B,)."""
    joints = skin.integers("joints", len(document.list("nodes")))
    if not joints:
        skin.fail("has no joints")
    inverse_bind: FloatArray = np.tile(np.eye(4)[:3], (len(joints), 1, 1))
    if "inverseBindMatrices" in skin:
        matrices = buffers.floats(skin, "inverseBindMatrices", "MAT4")
        if len(matrices) < len(joints):
            skin.fail(f"has {len(joints)} joints but {len(matrices)} inverse bind matrices")
        inverse_bind = matrices[: len(joints)].reshape(-1, 4, 4).transpose(0, 2, 1)[:, :3]
    return np.array(
        [assembly.bone(slot_of_node[j], m) for j, m in zip(joints, inverse_bind, strict=True)]
    )


def checked(primitive: Primitive, skin: Element, bones: int) -> Primitive:
    """The primitive with every joint in range: what weighs nothing may name any joint."""
    joints, weights = primitive.joints, primitive.weights
    if joints is None or weights is None:
        return primitive
    joints = np.where(weights > 0, joints, 0)
    if joints.max() >= bones:
        skin.fail(f"has {bones} joints but a vertex follows number {joints.max()}")
    return replace(primitive, joints=joints)


def merge(
    assembly: Assembly,
) -> tuple[FloatArray, FloatArray | None, IntArray, scipy.sparse.csr_array, FloatArray]:
    """Positions, normals, faces, weights and morph offsets (2, M, V, 3) of all pieces."""
    pieces = [
        piece if piece.primitive.normals is not None
        else replace(piece, primitive=piece.primitive.unshared())
        for piece in assembly.pieces
    ]  # fmt: skip
    primitives = [piece.primitive for piece in pieces]
    counts = [len(primitive.positions) for primitive in primitives]
    first = np.concatenate([[0], np.cumsum(counts)])
    total = int(first[-1])
    morphs = np.zeros((2, assembly.morphs, total, 3), dtype=np.float32)
    for piece, start, count in zip(pieces, first, counts, strict=False):
        for index, target in enumerate(piece.primitive.targets, piece.first_morph):
            morphs[:, index, start : start + count] = target
    normals = None
    if any(primitive.normals is not None for primitive in primitives):
        normals = np.concatenate(
            [p.flat_normals() if p.normals is None else p.normals for p in primitives]
        )
    weights = scipy.sparse.vstack(
        [piece.weights(len(assembly.bones)) for piece in pieces], format="csr"
    )
    weights.sum_duplicates()
    weights.eliminate_zeros()
    return (
        np.concatenate([primitive.positions for primitive in primitives]),
        normals,
        np.concatenate([p.faces + start for p, start in zip(primitives, first, strict=False)]),
        weights,
        morphs,
    )


def turned_outward(scene: SkinnedScene) -> SkinnedScene:
    """The scene with those faces turned round that are mirrored at rest."""
    matrices = scene.vertex_matrices(scene.rest_pose())[0, :, :, :3]
    mirrored = np.linalg.det(matrices)[scene.faces[:, 0]] < 0
    if not mirrored.any():
        return scene
    return replace(scene, faces=np.where(mirrored[:, None], scene.faces[:, ::-1], scene.faces))
