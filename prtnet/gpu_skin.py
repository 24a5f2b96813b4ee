"""What receivers of a skinned mesh see, for a shader: ``prtnet.skin_surroundings`` in GLSL.

Of a pose: the joints' matrices, and every sphere and patch where it is carried. A receiver is
carried by its joints in the shader, as any vertex is.
"""

from __future__ import annotations

import math

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.glsl import filled
from prtnet.gpu_surroundings import SeenTables, cap_glsl, fours, slots_of_sums
from prtnet.skin_surroundings import SkinSurroundings
from prtnet.surroundings import SMALLEST

__all__ = ["posed_skin", "seen_by_skin"]

FIXED = 3  # texels of a receiver: position and cluster, normal, tangent; then pairs of joints

SKIN = """\
uniform highp sampler2D prtnet_prior_rest;

const highp int PRTNET_RECEIVER_TEXELS = $RECEIVER;  // position, normal, tangent, pairs of joints
const highp int PRTNET_SPHERES = $SPHERES;  // where they begin in the pose
const highp int PRTNET_PATCHES = $PATCHES;
const highp int PRTNET_SEEN_TEXELS = 4 * PRTNET_CAP_TEXELS;

highp vec4 prtnet_rest(highp int texel) {
    return texelFetch(prtnet_prior_rest, prtnet_place(texel), 0);
}

highp vec3 prtnet_unit(highp vec3 v) {
    return v / sqrt(max(dot(v, v), $SMALLEST));
}

// Where the pose carries a receiver: about joint 0, in units of the character's size. The columns
// of the frame are tangent, bitangent and normal.
void prtnet_carried(highp int receiver, out highp vec3 position, out highp mat3 frame) {
    highp int at = receiver * PRTNET_RECEIVER_TEXELS;
    highp vec4 x = vec4(0.0), y = vec4(0.0), z = vec4(0.0);  // rows of the blended matrix
    for (highp int k = $FIXED; k < PRTNET_RECEIVER_TEXELS; ++k) {
        highp vec4 pair = prtnet_rest(at + k);
        for (highp int h = 0; h < 4; h += 2) {
            highp int joint = 3 * int(pair[h]);
            x += pair[h + 1] * prtnet_pose(joint);
            y += pair[h + 1] * prtnet_pose(joint + 1);
            z += pair[h + 1] * prtnet_pose(joint + 2);
        }
    }
    highp mat3 rows = mat3(x.xyz, y.xyz, z.xyz);
    highp vec3 n = prtnet_rest(at + 1).xyz;
    position = prtnet_rest(at).xyz * rows + vec3(x.w, y.w, z.w);
    highp vec3 a = vec3(x.x, y.x, z.x), b = vec3(x.y, y.y, z.y), c = vec3(x.z, y.z, z.z);
    highp vec3 normal = prtnet_unit(cross(b, c) * n.x + cross(c, a) * n.y + cross(a, b) * n.z);
    highp vec3 tangent = prtnet_rest(at + 2).xyz * rows;
    tangent = prtnet_unit(tangent - dot(tangent, normal) * normal);
    frame = mat3(tangent, cross(normal, tangent), normal);
}

// Caps of the spheres in so many texels of indices.
void prtnet_spheres(highp int first, highp uint texels, highp vec3 position, highp mat3 frame,
                    out highp vec4 sum[PRTNET_CAP_TEXELS]) {
    highp vec4 cap[PRTNET_CAP_TEXELS];
    for (highp int k = 0; k < PRTNET_CAP_TEXELS; ++k) sum[k] = vec4(0.0);
    for (highp int texel = first; texel < first + int(texels); ++texel) {
        highp uvec4 four = prtnet_index(texel);
        for (highp int j = 0; j < 4; ++j) {
            highp vec4 sphere = prtnet_pose(PRTNET_SPHERES + int(four[j]));
            highp vec3 away = sphere.xyz - position;
            highp float distance2 = max(dot(away, away), $SMALLEST);
            prtnet_cap(away * frame / sqrt(distance2), min(sphere.w / distance2, 1.0), cap);
            for (highp int k = 0; k < PRTNET_CAP_TEXELS; ++k) sum[k] += cap[k];
        }
    }
}

// What a receiver sees: spheres of other joints, of its own; patches from outside, from inside.
void prtnet_seen(highp int receiver, highp vec3 position, highp mat3 frame,
                 out highp vec4 seen[PRTNET_SEEN_TEXELS]) {
    highp int cluster = int(prtnet_rest(receiver * PRTNET_RECEIVER_TEXELS).w);
    highp uvec4 entry = prtnet_index(PRTNET_INDICES + cluster);
    highp int first = PRTNET_INDICES + int(entry.x);
    highp vec4 sum[PRTNET_CAP_TEXELS], cap[PRTNET_CAP_TEXELS];
    prtnet_spheres(first, entry.y, position, frame, sum);
    for (highp int k = 0; k < PRTNET_CAP_TEXELS; ++k) seen[k] = sum[k];
    first += int(entry.y);
    prtnet_spheres(first, entry.z, position, frame, sum);
    for (highp int k = 0; k < PRTNET_CAP_TEXELS; ++k) seen[PRTNET_CAP_TEXELS + k] = sum[k];
    first += int(entry.z);
    highp vec4 inside[PRTNET_CAP_TEXELS];
    for (highp int k = 0; k < PRTNET_CAP_TEXELS; ++k) sum[k] = inside[k] = vec4(0.0);
    for (highp int texel = first; texel < first + int(entry.w); ++texel) {
        highp uvec4 four = prtnet_index(texel);
        for (highp int j = 0; j < 4; ++j) {
            highp int patch_texel = PRTNET_PATCHES + 2 * int(four[j]);
            highp vec3 away = prtnet_pose(patch_texel).xyz - position;
            highp float distance2 = max(dot(away, away), $SMALLEST);
            highp vec3 toward = away / sqrt(distance2);
            highp float facing = -dot(prtnet_pose(patch_texel + 1).xyz, toward);
            highp float area = abs(facing);
            prtnet_cap(toward * frame, area / ($PI * distance2 + area), cap);
            highp float outside = facing > 0.0 ? 1.0 : 0.0;
            for (highp int k = 0; k < PRTNET_CAP_TEXELS; ++k) {
                sum[k] += outside * cap[k];
                inside[k] += (1.0 - outside) * cap[k];
            }
        }
    }
    for (highp int k = 0; k < PRTNET_CAP_TEXELS; ++k) {
        seen[2 * PRTNET_CAP_TEXELS + k] = sum[k];
        seen[3 * PRTNET_CAP_TEXELS + k] = inside[k];
    }
}
"""


def seen_by_skin(sees: SkinSurroundings) -> SeenTables:
    """Surroundings of a skinned mesh laid out for a shader."""
    spheres, patches = len(sees.sphere_joint), len(sees.patch_joint)
    rest = resting(sees)
    words = {
        "RECEIVER": rest.shape[1], "SPHERES": 3 * sees.joints, "FIXED": FIXED,
        "PATCHES": 3 * sees.joints + spheres + 1, "SMALLEST": SMALLEST, "PI": f"{math.pi:.9e}",
    }  # fmt: skip
    return SeenTables(
        kind=sees.kind,
        slots=slots_of_sums(0, sees.GROUPS, sees.order),
        indices=near_lists(sees),
        rest=rest.reshape(-1, 4),
        numbers=np.zeros((0, 4), dtype=np.float32),
        posed_texels=3 * sees.joints + spheres + 1 + 2 * (patches + 1),
        posed=lambda pose: posed_skin(sees, pose),
        glsl=cap_glsl(sees.order) + filled(SKIN, words),
        layout={"joints": sees.joints, "spheres": spheres, "patches": patches, "size": sees.size},
    )


def resting(sees: SkinSurroundings) -> FloatArray:
    """Receivers at rest, (V, texels, 4): places, and joints with their weights two by two."""
    count, influences = sees.skin_joint.shape
    texels = np.zeros((count, FIXED + -(-influences // 2), 4), dtype=np.float32)
    for row, values in enumerate((sees.position, sees.normal, sees.tangent)):
        texels[:, row, :3] = values
    texels[:, 0, 3] = sees.cluster
    pairs = texels[:, FIXED:].reshape(count, -1)
    pairs[:, 0 : 2 * influences : 2] = sees.skin_joint
    pairs[:, 1 : 2 * influences : 2] = sees.skin_weight
    texels[:, FIXED:] = pairs.reshape(count, -1, 4)
    return texels


def near_lists(sees: SkinSurroundings) -> IntArray:
    """Texels of indices: where each cluster's lists begin and how long they are, then the lists.

    Lists are spheres of other joints, spheres of its own, patches; each is filled up with the
    empty one behind all others.
    """
    entries, lists = [], []
    begins = len(sees.own_joint)
    for own, spheres, patches in zip(
        sees.own_sphere > 0, sees.near_spheres, sees.near_patches, strict=True
    ):
        parts = [
            fours(spheres[None, ~own], len(sees.sphere_joint))[0],
            fours(spheres[None, own], len(sees.sphere_joint))[0],
            fours(patches[None], len(sees.patch_joint))[0],
        ]
        entries.append([begins, *(len(part) for part in parts)])
        begins += sum(len(part) for part in parts)
        lists += parts
    return np.concatenate([np.array(entries, dtype=np.int64), *lists])


def posed_skin(sees: SkinSurroundings, pose: FloatArray) -> FloatArray:
    """Texels (N, 4) float32 of a flattened pose (D,).

    Three rows a joint, from rest; centre and squared radius of each sphere; centroid and vector
    area, a texel each, of each patch. An empty sphere and an empty patch are last of their kind.
    """
    carry = sees.carry(pose)
    centre, radius2 = sees.posed_spheres(carry)
    middle, area = sees.posed_patches(carry)
    spheres, patches = np.zeros((len(centre) + 1, 4)), np.zeros((len(middle) + 1, 2, 4))
    spheres[:-1, :3], spheres[:-1, 3] = centre, radius2
    patches[:-1, 0, :3], patches[:-1, 1, :3] = middle, area
    parts = [carry.reshape(-1, 4), spheres, patches.reshape(-1, 4)]
    return np.concatenate(parts).astype(np.float32)
