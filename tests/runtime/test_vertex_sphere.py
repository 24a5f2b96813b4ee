from __future__ import annotations

import numpy as np
import pytest

from data_gen.procedural import arm
from prtnet import sh
from runtime.camera import Camera
from runtime.looks import open_visibility
from runtime.pick import projected
from runtime.posed_surface import posed_subject, sides
from runtime.vertex_sphere import BELOW, inset_of, receiver_at, sphere_picture, vertex_inset
from tests.runtime.test_posed_surface import modelled

FRONT = Camera((0.0, 0.0, 5.0), (0.0, 0.0, 0.0))
FACING = np.eye(3)  # tangent right, bitangent up, normal at the camera
UP = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])  # tangent away, normal right: columns


def grey(picture: np.ndarray) -> np.ndarray:
    return picture[..., :3].astype(float).mean(axis=-1)


def test_an_open_vertex_is_white_above_its_horizon_and_dark_below():
    visibility = open_visibility(1, 4)[0]
    whole = sphere_picture(visibility, FACING, FRONT, 64)
    inside = whole[..., 3] == 255
    assert 0.7 * np.pi / 4 < inside.mean() < 1.05 * np.pi / 4
    assert (grey(whole)[inside] == 255).all()
    frame = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])  # normal to the right
    half = grey(sphere_picture(visibility, frame, FRONT, 64))
    assert (half[20:44, 36:50] == 255).all()
    assert half[20:44, 14:28] == pytest.approx(255 * (0.06 + 0.94 * BELOW), abs=1)


def test_light_comes_from_where_it_is_drawn():
    """Visibility of the left half of space, seen from the front, then from behind."""
    left = sh.project_function(lambda s: (s[:, :1] < 0).astype(float), 6)[:, 0]
    picture = grey(sphere_picture(left, FACING, FRONT, 64))
    assert picture[32, 12] > 200 > 60 > picture[32, 52]
    above = sh.project_function(lambda s: (s[:, 1:2] > 0).astype(float), 6)[:, 0]
    picture = grey(sphere_picture(above, FACING, FRONT, 64))
    assert picture[12, 32] > 200 > 60 > picture[52, 32]
    turned = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # local x is world y
    picture = grey(sphere_picture(left, turned, FRONT, 64))
    assert picture[52, 32] > 200 > 60 > picture[12, 32]


def test_values_no_visibility_has_are_tinted():
    low, high = -open_visibility(1, 2)[0], 1.5 * open_visibility(1, 2)[0]
    middle = sphere_picture(low, FACING, FRONT, 32)[16, 16]
    assert middle[2] > middle[0] + 50
    middle = sphere_picture(high, FACING, FRONT, 32)[16, 16]
    assert middle[0] > middle[1] + 50


def test_spheres_stand_side_by_side():
    shown = [("one", open_visibility(1, 2)[0]), ("other", open_visibility(1, 2)[0])]
    alone = vertex_inset("vertex 7", shown[:1], FACING, FRONT, 80)
    both = vertex_inset("vertex 7", shown, FACING, FRONT, 80)
    assert both.shape[0] == alone.shape[0]
    assert both.shape[1] - alone.shape[1] >= 80


@pytest.mark.parametrize("back", [False, True])
def test_the_vertex_has_its_own_visibility_frame_and_ring(back):
    actor = modelled(arm(segments=6), two_sided=True)
    pose = actor.poses("bend", np.array([1.0]))
    subject = posed_subject(actor, pose)
    rng = np.random.default_rng(0)
    visibility = rng.normal(0.3, 0.3, (len(actor.receivers), actor.model.order**2))
    vertex, size = 17, (300, 200)
    camera = Camera.framing(subject.positions, 1.5)
    receiver = sides(actor)[back][vertex]
    assert receiver_at(actor, (vertex, back)) == receiver
    (ring, place), (inset, corner) = inset_of(
        subject, (vertex, back), [("a", visibility[receiver])], camera, size
    )
    frame = actor.frames(pose)[0, receiver]
    title = f"vertex {vertex}{' (back)' if back else ''}"
    expected = vertex_inset(title, [("a", visibility[receiver])], frame, camera, 64)
    assert np.array_equal(inset, expected)
    assert corner == (300 - 8 - inset.shape[1], 200 - 8 - inset.shape[0])
    middle = np.array(place) + 0.5 * np.array(ring.shape[1::-1])
    at = projected(subject.positions[vertex][None], camera.matrix(1.5), size)[0, :2]
    assert np.abs(middle - at).max() <= 0.5
