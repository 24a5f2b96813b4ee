"""A model together with the scene it was fitted to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from prtnet.animation import Clip
from prtnet.arrays import FloatArray, IntArray
from prtnet.errors import PrtnetError
from prtnet.files import writing
from prtnet.frames import FrameField
from prtnet.model import VisibilityModel
from prtnet.output_space import OutputSpace
from prtnet.scene import Geometry, Receivers, Scene
from prtnet.sh_rotation import rotate
from prtnet.time_range import part_of

__all__ = ["ModelledScene", "Moment", "OtherMeshError"]


class Moment(NamedTuple):
    """A clip and seconds into it."""

    clip: str
    time: float


class OtherMeshError(PrtnetError):
    """A model and a scene do not belong together; either may be well by itself."""


@dataclass(frozen=True, eq=False)
class ModelledScene:
    """A model on its scene.

    Raises:
        PrtnetError: the model was fitted to another mesh or rig, or gives no plain visibility.
    """

    model: VisibilityModel
    scene: Scene

    def __post_init__(self) -> None:
        """Refuse a pair that does not belong together."""
        OutputSpace.of(self.model.metadata).require_plain("use it on a scene")
        wanted = self.model.metadata.get("mesh_sha256")
        if wanted != self.scene.mesh_sha256 or len(self.receivers) != self.model.receiver_count:
            name = self.model.metadata.get("scene_name", "another scene")
            raise OtherMeshError(
                self.scene.path or self.scene.name,
                f"is not the mesh this model was fitted to ({name}); "
                "give that scene, or generate and train for this one",
            )

    @cached_property
    def receivers(self) -> Receivers:
        """The receivers, in the model's order."""
        return self.scene.receivers(bool(self.model.metadata.get("two_sided", False)))

    @cached_property
    def frame_field(self) -> FrameField:
        """The frames the model's visibility is in."""
        return FrameField(self.scene, self.receivers, self.model.rest_tangents)

    def geometry(self, poses: FloatArray) -> Geometry:
        """Positions and normals of receivers (P, V, 3) of flattened poses (P, D)."""
        return self.receivers.gather(self.scene.geometry(poses))

    def frames(self, poses: FloatArray) -> FloatArray:
        """Frames of receivers, (P, V, 3, 3), columns tangent, bitangent, normal."""
        return self.frame_field.frames(poses, self.geometry(poses))

    @cached_property
    def faces(self) -> IntArray:
        """Triangles (T, 3) over front receivers."""
        return self.receivers.of_vertex[self.scene.faces]

    def poses(self, clip: str, times: FloatArray | None = None, fps: float = 5.0) -> FloatArray:
        """Flattened poses (P, D) of a clip or a part of one, at times or so many a second.

        Raises:
            PrtnetError: there is no such clip, or a time is outside it.
        """
        found = part_of(self.scene, clip)
        if times is None:
            times = found.times(fps=fps)
        self._require_inside(found, times)
        return self.scene.poses(found, times)

    def blended(self, first: Moment, second: Moment, share: float) -> FloatArray:
        """The flattened pose (1, D) on the way from one moment to another.

        Args:
            first: where from; a whole clip.
            second: where to.
            share: of the second, 0 to 1.

        Raises:
            PrtnetError: there is no such clip, or a time is outside it.
        """
        one, other = (self.scene.clip(moment.clip) for moment in (first, second))
        times = np.array([first.time]), np.array([second.time])
        self._require_inside(one, times[0])
        self._require_inside(other, times[1])
        return self.scene.blended((one, other), times, np.array([share]))

    def _require_inside(self, clip: Clip, times: FloatArray) -> None:
        """Refuse times outside a clip."""
        if not (np.min(times) >= clip.start - 1e-6 and np.max(times) <= clip.end + 1e-6):
            raise PrtnetError(
                self.scene.path or self.scene.name,
                f"clip '{clip.name}' runs from {clip.start:g} to {clip.end:g} s; "
                "give a time inside it",
            )

    def dump(
        self,
        path: Path,
        clips: Sequence[str],
        fps: float,
        predict: Callable[..., FloatArray],
        progress: Callable[[int, int], object] | None = None,
    ) -> int:
        """Write predicted visibility in the **world** frame, for anybody's own ray tracer.

        The ``.npz`` holds ``positions``, ``normals`` (P, V, 3), ``faces`` (T, 3) over the front
        receivers and ``visibility`` (P, V, n²), clip after clip.

        Args:
            path: the file.
            clips: names.
            fps: poses a second.
            predict: poses (P, D) to local visibility (P, V, n²).
            progress: told the number of poses done, and of all.

        Returns:
            The number of poses.
        """
        poses = np.concatenate([self.poses(clip, fps=fps) for clip in clips])
        shape = (len(poses), len(self.receivers))
        positions, normals = (np.empty((*shape, 3), dtype=np.float32) for _ in range(2))
        visibility = np.empty((*shape, self.model.order**2), dtype=np.float32)
        for index in range(len(poses)):  # one pose at a time: a frame has nine numbers a receiver
            pose = poses[index : index + 1]
            surface = self.geometry(pose)
            positions[index], normals[index] = surface.positions[0], surface.normals[0]
            frames = self.frame_field.frames(pose, surface)[0].astype(np.float64)
            visibility[index] = rotate(predict(pose)[0].astype(np.float64), frames)
            if progress is not None:
                progress(index + 1, len(poses))
        with writing(path) as partial, open(partial, "wb") as file:
            np.savez_compressed(
                file, positions=positions, normals=normals, faces=self.faces, visibility=visibility
            )
        return len(poses)
