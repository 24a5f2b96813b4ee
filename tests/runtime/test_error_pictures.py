from __future__ import annotations

import base64
import io
import math
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from prtnet.light import load_light
from runtime.draw import opened
from runtime.error_pictures import data_uri, draw_error, error_scale, vertex_error
from runtime.picture import colour_map
from runtime.posed_surface import recorded_surface

OPEN = math.sqrt(4.0 * math.pi)


def flat_dataset(two_sided: bool = False) -> SimpleNamespace:
    """A square that faces +z, its four corners open; order 2."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=np.float32)
    normals = np.tile(np.array([0, 0, 1], dtype=np.float32), (4, 1))
    tangents = np.tile(np.array([1, 0, 0], dtype=np.float32), (4, 1))
    side = np.ones(4)
    if two_sided:
        corners, tangents = np.tile(corners, (2, 1)), np.tile(tangents, (2, 1))
        normals, side = np.concatenate([normals, -normals]), np.repeat([1, -1], 4)
    visibility = np.zeros((len(corners), 4), dtype=np.float32)
    visibility[:, 0] = OPEN
    arrays = {"positions": corners, "normals": normals, "tangents": tangents,
              "visibility": visibility}  # fmt: skip
    return SimpleNamespace(
        read=lambda name, _: arrays[name],
        faces=np.array([[0, 1, 2], [0, 2, 3]]),
        receiver_of_vertex=np.arange(4),
        receiver_side=side,
    )


def test_error_of_a_closed_vertex_is_one() -> None:
    dataset = flat_dataset()
    truth = dataset.read("visibility", 0)
    assert vertex_error(np.zeros_like(truth), truth) == pytest.approx(np.ones(4))
    assert vertex_error(truth, truth).tolist() == [0, 0, 0, 0]
    assert error_scale(np.linspace(0, 0.04, 100)) == 5.0
    assert error_scale(np.zeros(9)) > 0


@pytest.mark.parametrize("two_sided", [False, True])
def test_recorded_surface_is_what_the_dataset_holds(two_sided: bool) -> None:
    dataset = flat_dataset(two_sided)
    surface = recorded_surface(dataset, 0, dataset.read("visibility", 0))
    assert surface.positions.shape == (4, 3)
    assert surface.faces.max() == 3
    # An open vertex under a white sky reflects all of it: irradiance π.
    white = np.array([OPEN, 0, 0, 0])
    assert surface.transfer @ white == pytest.approx(np.full(4, math.pi), rel=1e-5)
    assert (surface.back_transfer is not None) == two_sided
    if two_sided:
        above = np.array([0, 0, 1.0, 0])  # a light that varies along +z: y₁₀
        assert surface.back_transfer @ above == pytest.approx(-(surface.transfer @ above))


@pytest.mark.parametrize("name", ["cpu", pytest.param("gl", marks=pytest.mark.gl)])
def test_pictures_show_where_the_error_is(name: str) -> None:
    dataset = flat_dataset()
    predicted = dataset.read("visibility", 0).copy()
    predicted[:2] *= 0.5  # the lower corners are half closed
    with opened(name) as renderer:
        light = load_light("overcast", 2)
        pictures = draw_error(renderer, dataset, 0, predicted, light, 50.0, (60, 60))
    heat, truth, guess = (
        picture[:, 30].astype(int)
        for picture in (pictures.error, pictures.truth, pictures.prediction)
    )
    drawn = np.flatnonzero(np.abs(truth - truth[0]).sum(axis=-1) > 60)
    top, middle, foot = drawn[2], drawn[len(drawn) // 2], drawn[-3]
    assert heat[foot].sum() > heat[middle].sum() > heat[top].sum()
    assert np.abs(heat[foot] - colour_map(np.array(1.0))).max() < 50
    assert np.abs(heat[top] - colour_map(np.array(0.0))).max() < 50
    assert guess[foot].sum() < truth[foot].sum() - 30
    assert np.abs(guess[top] - truth[top]).max() < 10


def test_address_holds_the_picture() -> None:
    picture = np.random.default_rng(0).integers(0, 256, (5, 7, 3), dtype=np.uint8)
    head, _, body = data_uri(picture).partition(",")
    assert head == "data:image/png;base64"
    assert np.array_equal(np.asarray(Image.open(io.BytesIO(base64.b64decode(body)))), picture)
