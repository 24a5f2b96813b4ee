"""What receivers of a deforming sheet see, for a shader: ``prtnet.patches`` in GLSL.

Of a pose: the vertices, the receivers' normals and tangents, and every patch's centroid and vector
area. A back receiver is its front with bitangent and normal turned round.
"""

from __future__ import annotations

import math

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.glsl import filled
from prtnet.gpu_surroundings import SeenTables, cap_glsl, fours, slots_of_sums
from prtnet.patches import SMALLEST, PatchSurroundings, applied
from prtnet.scene import face_normals

__all__ = ["posed_patches", "seen_by_sheet"]

SHEET = """\
const highp int PRTNET_FRONTS = $FRONTS;  // receivers; those of the back follow
const highp int PRTNET_CONTROL_TEXELS = $CONTROL;  // of a front's indices: its control points
const highp int PRTNET_NEAR_TEXELS = $NEAR;  // then the patches it looks at
const highp int PRTNET_VERTEX_OF = $VERTEX_OF;  // where the fronts' vertices are in the indices
const highp int PRTNET_FRAMES = $FRAMES;  // where they begin in the pose
const highp int PRTNET_PATCHES = $PATCHES;
const highp int PRTNET_SEEN_TEXELS = 3 * PRTNET_CONTROL_TEXELS + PRTNET_CAP_TEXELS;

// Where a receiver is: about vertex 0, in units of the sheet's size. The columns of the frame are
// tangent, bitangent and normal.
void prtnet_carried(highp int receiver, out highp vec3 position, out highp mat3 frame) {
    highp int front = receiver % PRTNET_FRONTS;
    highp uvec4 vertices = prtnet_index(PRTNET_INDICES + PRTNET_VERTEX_OF + front / 4);
    position = prtnet_pose(int(vertices[front % 4])).xyz;
    highp vec3 normal = prtnet_pose(PRTNET_FRAMES + 2 * front).xyz;
    highp vec3 tangent = prtnet_pose(PRTNET_FRAMES + 2 * front + 1).xyz;
    if (receiver >= PRTNET_FRONTS) normal = -normal;
    frame = mat3(tangent, cross(normal, tangent), normal);
}

// What a receiver sees: its control points, then the caps of the patches near it.
void prtnet_seen(highp int receiver, highp vec3 position, highp mat3 frame,
                 out highp vec4 seen[PRTNET_SEEN_TEXELS]) {
    highp int at = (receiver % PRTNET_FRONTS) * (PRTNET_CONTROL_TEXELS + PRTNET_NEAR_TEXELS);
    at += PRTNET_INDICES;
    for (highp int c = 0; c < PRTNET_CONTROL_TEXELS; ++c) {
        highp uvec4 four = prtnet_index(at + c);
        highp vec4 x, y, z;
        for (highp int j = 0; j < 4; ++j) {
            highp vec3 local = (prtnet_pose(int(four[j])).xyz - position) * frame;
            x[j] = local.x;
            y[j] = local.y;
            z[j] = local.z;
        }
        highp vec4 radius = prtnet_number(PRTNET_NUMBERS + c);
        seen[3 * c] = x / radius;
        seen[3 * c + 1] = y / radius;
        seen[3 * c + 2] = z / radius;
    }
    highp vec4 sum[PRTNET_CAP_TEXELS], cap[PRTNET_CAP_TEXELS];
    for (highp int k = 0; k < PRTNET_CAP_TEXELS; ++k) sum[k] = vec4(0.0);
    at += PRTNET_CONTROL_TEXELS;
    for (highp int texel = at; texel < at + PRTNET_NEAR_TEXELS; ++texel) {
        highp uvec4 four = prtnet_index(texel);
        for (highp int j = 0; j < 4; ++j) {
            highp int patch_texel = PRTNET_PATCHES + 2 * int(four[j]);
            highp vec3 away = prtnet_pose(patch_texel).xyz - position;
            highp float distance2 = max(dot(away, away), $SMALLEST);
            highp vec3 toward = away / sqrt(distance2);
            highp float area = abs(dot(prtnet_pose(patch_texel + 1).xyz, toward));
            prtnet_cap(toward * frame, area / ($PI * distance2 + area), cap);
            for (highp int k = 0; k < PRTNET_CAP_TEXELS; ++k) sum[k] += cap[k];
        }
    }
    for (highp int k = 0; k < PRTNET_CAP_TEXELS; ++k)
        seen[3 * PRTNET_CONTROL_TEXELS + k] = sum[k];
}
"""


def seen_by_sheet(sees: PatchSurroundings) -> SeenTables:
    """Surroundings of a point cache laid out for a shader."""
    fronts, points = sees.control.shape
    vertices, patches = sees.patch.shape[1], int(sees.patch.max()) + 1
    control = fours(sees.control, 0)
    near = fours(np.where(sees.near >= 0, sees.near, patches), patches)
    lists = np.concatenate([control, near], axis=1).reshape(-1, 4)
    texels = control.shape[1]
    slots = np.full((texels, 3, 4), -1, dtype=np.int64)
    four, place = np.divmod(np.arange(points), 4)
    for axis in range(3):
        slots[four, axis, place] = axis * points + np.arange(points)
    radius = np.ones((texels, 4), dtype=np.float32)
    radius.ravel()[:points] = sees.radius
    words = {
        "FRONTS": fronts, "CONTROL": texels, "NEAR": near.shape[1], "VERTEX_OF": len(lists),
        "FRAMES": vertices, "PATCHES": vertices + 2 * fronts, "SMALLEST": SMALLEST,
        "PI": f"{math.pi:.9e}",
    }  # fmt: skip
    return SeenTables(
        kind=sees.kind,
        slots=np.concatenate([slots.ravel(), slots_of_sums(3 * points, 1, sees.order)]),
        indices=np.concatenate([lists, fours(sees.vertex[None], 0)[0]]),
        rest=np.zeros((0, 4), dtype=np.float32),
        numbers=radius,
        posed_texels=vertices + 2 * fronts + 2 * (patches + 1),
        posed=lambda pose: posed_patches(sees, pose),
        glsl=cap_glsl(sees.order) + filled(SHEET, words),
        layout={"vertices": vertices, "fronts": fronts, "patches": patches, "size": sees.size},
    )


def posed_patches(sees: PatchSurroundings, pose: FloatArray) -> FloatArray:
    """Texels (N, 4) float32 of a flattened pose (D,).

    The vertices; normal and tangent, a texel each, of each front receiver; centroid and vector
    area of each patch, an empty one last.
    """
    points = pose.astype(np.float64).reshape(1, -1, 3)
    points = (points - points[:, :1]) / sees.size
    crosses = face_normals(points, sees.faces)
    axes = sees.axes(points, crosses)[0]  # [R, 3, 3]
    frames, patches = np.zeros((len(axes), 2, 4)), np.zeros((int(sees.patch.max()) + 2, 2, 4))
    frames[..., :3] = axes[..., [2, 0]].swapaxes(1, 2)
    patches[:-1, 0, :3] = applied(sees.centring, points)[0]
    patches[:-1, 1, :3] = applied(sees.facing, crosses)[0]
    vertices = np.concatenate([points[0], np.zeros((points.shape[1], 1))], axis=1)
    parts = [vertices, frames.reshape(-1, 4), patches.reshape(-1, 4)]
    return np.concatenate(parts).astype(np.float32)
