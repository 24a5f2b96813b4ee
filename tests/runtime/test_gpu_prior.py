"""Priors in the vertex shader, against the model's own NumPy."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from data_gen.procedural import arm
from prtnet.cli_view import rebuilt
from prtnet.environment import environment
from prtnet.errors import PrtnetError
from prtnet.glsl import WIDTH, texture
from prtnet.gpu_prior import prior_tables
from prtnet.gpu_tables import gpu_tables
from prtnet.modelled_scene import ModelledScene
from prtnet.prior import NetworkPrior
from prtnet.storage import STORAGES
from runtime.cast import Cast
from runtime.draw import opened, render_material
from runtime.gl import create_context
from runtime.picture import develop
from runtime.posed_surface import posed_subject
from runtime.show import Show, View
from runtime.studio import Studio
from tests.models import random_model, random_poses
from tests.priors import beside_prior, random_prior, sheet_with_prior
from tests.runtime.shader import WEB, shaded
from tests.runtime.test_posed_surface import modelled
from tests.skin import random_skin

pytestmark = pytest.mark.gl

KINDS = ["maps", "network"]
SIZE = (160, 120)
# Of the largest coefficient: float32 through some hundreds of caps and products, and directions to
# occluders whose places are rounded to float32.
RELATIVE = 3e-6


def skinned(kind, receivers=40, **options):
    """A model of a random body, and poses of it."""
    skin = random_skin(receivers=receivers, **options)
    prior = random_prior(kind, receivers=receivers, surroundings=skin)
    return beside_prior(random_model(receivers=receivers), prior), random_poses(3, 5)


def check(model, poses, head="#version 330", relative=RELATIVE):
    """The shader gives what the model gives, of every pose."""
    expected = model(poses)
    error = np.abs(shaded(model, poses, head) - expected).max()
    assert error <= relative * np.abs(expected).max()
    without = dataclasses.replace(model, prior=None)(poses)
    assert np.abs(expected - without).max() > 0.1 * np.abs(expected).max()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("body", ["skin", "sheet", "one-sided sheet"])
def test_the_shader_gives_the_models_visibility(kind, storage, body):
    # A skin large enough for its tables to be rounded, as those of any real one.
    model, poses = (
        skinned(kind, receivers=300)
        if body == "skin"
        else sheet_with_prior(kind, two_sided=body == "sheet")
    )
    model = model.stored_as(storage)
    textures = gpu_tables(model).textures
    small = storage != "float32"
    if body == "skin":
        assert textures["prtnet_prior_rest"].dtype == (np.float16 if small else np.float32)
    if kind == "maps":
        wanted = {"float32": np.float32, "float16": np.float16}.get(storage, np.int8)
        assert textures["prtnet_prior_weights"].dtype == wanted
    check(model, poses)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("body", ["skin", "sheet"])
def test_it_is_a_shader_of_webgl(kind, body):
    model, poses = skinned(kind) if body == "skin" else sheet_with_prior(kind)
    check(dataclasses.replace(model, bounds=np.array([[-1.0], [1.5]]).repeat(9, 1)), poses, WEB)


@pytest.mark.parametrize("order", [1, 2, 3, 4])
@pytest.mark.parametrize("body", ["skin", "sheet"])
def test_orders_of_what_is_seen(order, body):
    if body == "skin":
        check(*skinned("maps", order=order))
    else:
        check(*sheet_with_prior("maps", order=order))


def test_eight_bits_of_a_large_network():
    """All of its tables are large enough to be rounded, so its texels are bytes."""
    rng = np.random.default_rng(0)
    model, poses = skinned("network", receivers=300)
    prior = model.prior
    widths = [len(prior.low) + 18, 34, 33, 9]
    layers = [rng.normal(size=s) / s[0] ** 0.5 for s in itertools.pairwise(widths)]
    prior = NetworkPrior(
        prior.surroundings, prior.low, prior.high,
        rng.normal(size=(300, 18)).astype(np.float32),
        tuple(layer.astype(np.float32) for layer in layers),
        tuple(rng.normal(size=n).astype(np.float32) for n in widths[1:]),
    )  # fmt: skip
    model = dataclasses.replace(model, prior=prior).stored_as("int8")
    assert gpu_tables(model).textures["prtnet_prior_weights"].dtype == np.int8
    check(model, poses)


@pytest.mark.parametrize("storage", ["float32", "int8"])
def test_a_network_of_one_layer_without_codes(storage):
    rng = np.random.default_rng(0)
    model, poses = skinned("network")
    prior = model.prior
    plain = NetworkPrior(
        prior.surroundings, prior.low, prior.high, np.zeros((40, 0), dtype=np.float32),
        (rng.normal(size=(len(prior.low), 9)).astype(np.float32),), (np.ones(9, np.float32),),
    )  # fmt: skip
    check(dataclasses.replace(model, prior=plain).stored_as(storage), poses)


@pytest.mark.parametrize("body", ["skin", "sheet"])
def test_indices_too_large_for_two_bytes(body, monkeypatch):
    model, poses = skinned("maps") if body == "skin" else sheet_with_prior("maps")
    assert gpu_tables(model).textures["prtnet_prior_indices"].dtype == np.uint16
    monkeypatch.setattr("prtnet.gpu_prior.MOST_SHORT", 10)
    assert gpu_tables(model).textures["prtnet_prior_indices"].dtype == np.uint32
    check(model, poses)


def test_many_receivers_take_many_rows():
    model, poses = skinned("network", receivers=2 * WIDTH)
    assert gpu_tables(model).textures["prtnet_prior_rest"].shape[0] > 2
    check(model, poses[:1])


@pytest.mark.parametrize("kind", KINDS)
def test_bounds_hold(kind):
    model, poses = skinned(kind)
    bounded = beside_prior(model, model.prior, bounded=True)
    free, kept = model(poses), bounded(poses)
    assert (free > 1.5).any()
    assert (free < -1.0).any()
    assert np.abs(shaded(bounded, poses) - kept).max() <= RELATIVE * np.abs(kept).max()


def test_a_model_without_latents_has_its_prior_alone():
    model, poses = skinned("maps")
    constant = random_model("constant", receivers=40)
    check(beside_prior(constant, model.prior), poses)


def test_what_the_viewer_rebuilds_visibility_from():
    model, poses = skinned("maps")
    constant = random_model("constant", receivers=40)
    assert rebuilt(constant, 1) == (None, None)
    given, occluders = rebuilt(random_model(), 1)
    assert given is not None
    assert occluders is None
    (latents, tables), occluders = rebuilt(beside_prior(constant, model.prior), 1)
    assert latents(poses).shape == (len(poses), 0)
    assert occluders(poses).shape == (len(poses), tables.prior.seen.posed_texels, 4)


def test_surroundings_without_a_shader_are_refused():
    prior = random_prior("maps")

    class Elsewhere:
        kind = "elsewhere"

    object.__setattr__(prior, "surroundings", Elsewhere())
    with pytest.raises(PrtnetError, match="elsewhere, which no shader does"):
        prior_tables(prior, lambda _: None)


def test_rows_are_whole():
    assert texture(np.ones((WIDTH + 1, 4))).shape == (2, WIDTH, 4)
    assert texture(np.zeros((0, 1))).shape == (1, WIDTH, 1)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("storage", "graph"), [("float32", False), ("int8", True)])
def test_pictures_are_those_of_numpy(kind, storage, graph):
    """The viewer's own picture of a posed character, and one drawn without OpenGL."""
    scene = arm(segments=6)
    actor = modelled(scene, two_sided=False)
    count = len(actor.receivers)
    skin = random_skin(scene.joint_count, count)
    poses = actor.poses("bend", np.linspace(0.0, 3.0, 9))
    prior = random_prior(kind, scene.joint_count, count, 3, surroundings=skin, poses=poses)
    model = beside_prior(actor.model, prior, bounded=True).stored_as(storage)
    actor = ModelledScene(model, scene)
    latents, occluders = rebuilt(model, threads=1)
    assert latents is not None
    if not graph:
        occluders = lambda poses: np.stack([latents[1].prior.seen.posed(p) for p in poses])  # noqa: E731
    view = View("bend", 1.5, brdf="phong")
    context = create_context()
    with context:
        cast = Cast(
            actor, model, lambda _: model(poses)[0], lambda *_: model(poses)[0, :, :3], latents,
            occluders=occluders,
        )  # fmt: skip
        show = Show(context, cast, Studio(environment))
        show.screen.samples = 0
        show.operator(view, wait=True)
        target = context.framebuffer([context.texture(SIZE, 4)])
        for view.time in (0.2, 1.5):
            show.draw(view, SIZE, target)
        seen = np.frombuffer(target.read(components=3), np.uint8).reshape(SIZE[1], SIZE[0], 3)
        light, operator, camera = show.lit(view), show.operator(view), show.camera(view)
        exposure = show.exposures["studio"]
        show.release()
    context.release()
    subject = posed_subject(actor, actor.poses("bend", np.array([1.5])), model(show.pose(view))[0])
    with opened("cpu") as renderer:
        linear = render_material(renderer, subject, light, operator, camera, SIZE, samples=1)
    assert linear[..., 3].mean() > 0.03
    expected = develop(linear, exposure).astype(int)
    assert np.ptp(expected) > 60
    assert np.mean(np.abs(seen[::-1] - expected).max(axis=-1) <= 2) >= 0.999
