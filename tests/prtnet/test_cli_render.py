"""What the commands that draw trace."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from prtnet.cli_render import tracers
from prtnet.environment import Environment
from prtnet.equirectangular import Picture
from prtnet.errors import PrtnetError
from prtnet.frames import FrameField, rest_tangents
from prtnet.one_dimensional import OneDimensional
from tests.data_gen.meshes import cache, quad, together

SUN = np.array([1.0, 2.0, 4.0])
SKY = Environment(Picture(np.ones((4, 8, 3)) * SUN))


def sheet(two_sided: bool) -> SimpleNamespace:
    """A small square that faces +z, a large wall close behind it."""
    corners = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    wall = 40.0 * corners - [0.0, 0.0, 0.1]
    positions, faces, _ = together(quad(corners), quad(wall))
    scene = cache(positions[None], faces)
    receivers = scene.receivers(two_sided)
    field = FrameField(scene, receivers, rest_tangents(scene, receivers))
    model = SimpleNamespace(metadata={"two_sided": two_sided})
    return SimpleNamespace(scene=scene, receivers=receivers, frame_field=field, model=model)


def pose_of(actor: SimpleNamespace) -> np.ndarray:
    return actor.scene.poses(actor.scene.clips[0], np.array([0.0]))


def test_light_through_a_membrane_is_that_of_its_other_side():
    """The front's light leaves the back; behind there is a wall, so none leaves the front."""
    actor = sheet(True)
    radiance = tracers(actor, 512, 1)[1]
    material = OneDimensional(0.0, 0.0, 1.0, (0.5, 0.25, 0.5))
    seen = radiance(pose_of(actor), np.array([0.0, 0.0, 3.0]), SKY, material)
    front, back = seen[:4], seen[8:12]
    assert np.abs(front).max() < 0.02
    assert back == pytest.approx(np.tile(SUN * [0.5, 0.25, 0.5], (4, 1)), rel=0.02)
    opaque = radiance(pose_of(actor), np.array([0.0, 0.0, 3.0]), SKY,
                      OneDimensional(0.5, 0.0))  # fmt: skip
    assert opaque[:4] == pytest.approx(np.tile(0.5 * SUN, (4, 1)), rel=0.02)


def test_without_backs_it_is_refused():
    actor = sheet(False)
    radiance = tracers(actor, 16, 1)[1]
    with pytest.raises(PrtnetError, match="generate --two-sided"):
        radiance(pose_of(actor), np.ones(3), SKY, OneDimensional(transmitted=0.1))
