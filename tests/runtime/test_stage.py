from __future__ import annotations

import dataclasses

import moderngl
import numpy as np
import pytest

from prtnet.errors import PrtnetError
from prtnet.gpu_tables import gpu_tables
from prtnet.materials import brdf_named, material
from prtnet.reflection import ReflectionOperator
from prtnet.storage import STORAGES
from prtnet.zh import Lobes, exact_lobes
from runtime import stage as module
from runtime.draw import opened, render_material
from runtime.gl import GLRenderer, create_context
from runtime.material_shader import most_lobes
from runtime.picture import srgb_encode
from runtime.reflected import Side, Subject
from runtime.stage import Stage
from tests.models import random_model, random_poses
from tests.priors import beside_prior, random_prior, sheet_with_prior
from tests.runtime.scenes import knot_subject, sky, three_quarters
from tests.runtime.shader import latents_of
from tests.skin import random_skin

pytestmark = pytest.mark.gl

SIZE = (96, 72)


def shining(order: int, factors: int = 5, seed: int = 0) -> ReflectionOperator:
    """An operator of random numbers: no shader can be right by chance."""
    rng = np.random.default_rng(seed)
    matrices = rng.normal(size=(factors, order**2, order**2)) / order**2
    view = rng.normal(size=(factors, order**2, 3))
    return ReflectionOperator(
        (matrices + matrices.swapaxes(1, 2)).astype(np.float32), view.astype(np.float32)
    )


def drawn(name: str, subject: Subject, lobes: Lobes, operator: ReflectionOperator) -> np.ndarray:
    camera = three_quarters(subject, SIZE)
    with opened(name) as renderer:
        return render_material(renderer, subject, lobes, operator, camera, SIZE, samples=1)


@pytest.mark.parametrize("two_sided", [False, True])
@pytest.mark.parametrize("order", [1, 2, 3, 4, 5, 6, 8])
def test_the_shader_does_what_numpy_does(order, two_sided):
    subject, lobes = knot_subject(order, two_sided), exact_lobes(sky(order).T)
    operator = shining(order)
    pictures = [drawn(name, subject, lobes, operator) for name in ("cpu", "gl")]
    assert pictures[0][..., 3].mean() > 0.2
    scale = np.abs(pictures[0]).max()
    # Drivers snap corners for coverage but need not for colour: up to 1/512 pixel of its slope.
    assert np.mean(np.abs(pictures[0] - pictures[1]).max(-1) > 3e-3 * scale) < 1e-3


@pytest.mark.parametrize("two_sided", [False, True])
@pytest.mark.parametrize("order", [2, 4, 5])
def test_bands_are_cut_in_the_shader(order, two_sided):
    """As arrays of the lower order are shaded by NumPy, with one program for all orders."""
    subject, lobes = knot_subject(order, two_sided), exact_lobes(sky(order).T)
    operator = shining(order)
    camera = three_quarters(subject, SIZE)
    with GLRenderer() as renderer, opened("cpu") as numpy:
        whole = renderer.draw_material(subject, lobes, operator, camera, SIZE)
        program = renderer._stages[order].program
        for few in range(1, order):
            seen = renderer.draw_material(subject, lobes, operator, camera, SIZE, few)
            size = few * few
            lower = (
                Subject(subject.positions, subject.faces,
                        *(Side(one.visibility[:, :size], one.frames) for one in subject.sides)),
                Lobes(lobes.axes, lobes.coefficients[..., :few]),
                ReflectionOperator(operator.matrices[:, :size, :size], operator.view),
            )  # fmt: skip
            for expected in (
                numpy.draw_material(*lower, camera, SIZE),
                numpy.draw_material(subject, lobes, operator, camera, SIZE, few),
            ):
                scale = np.abs(expected).max()
                assert np.mean(np.abs(seen - expected).max(-1) > 3e-3 * scale) < 1e-3
            assert np.abs(seen - whole).max() > 0.05
        assert list(renderer._stages) == [order]
        assert renderer._stages[order].program is program
        for every in (0, order, order + 1):
            again = renderer.draw_material(subject, lobes, operator, camera, SIZE, every)
            assert np.array_equal(again, whole)


@pytest.mark.parametrize("name", ["gold", "satin"])
def test_pictures_are_within_two_steps_of_eight_bits(name):
    subject, lobes = knot_subject(two_sided=True), exact_lobes(sky().T)
    operator = material(brdf_named(name))
    pictures = [srgb_encode(drawn(renderer, subject, lobes, operator)[..., :3])
                for renderer in ("cpu", "gl")]  # fmt: skip
    assert np.mean(np.abs(pictures[0] - pictures[1]).max(-1) <= 2 / 255) >= 0.999


def test_lights_materials_and_poses_are_swapped_without_new_shaders():
    subject = knot_subject()
    camera = three_quarters(subject, SIZE)
    few, many = exact_lobes(sky().T), exact_lobes(2.0 * sky().T)
    moved = dataclasses.replace(subject, positions=subject.positions + 0.1)
    one, other = shining(4, 2), shining(4, 7, seed=1)
    with GLRenderer() as renderer:
        first = renderer.draw_material(subject, few, one, camera, SIZE)
        program = renderer._stages[4].program
        faces = np.ascontiguousarray(subject.faces[::-1][:, [1, 2, 0]])
        faces[: len(faces) // 2] = faces[0]
        rewired = dataclasses.replace(subject, faces=faces)
        for changed in (
            (moved, few, one), (subject, many, one), (subject, few, other), (rewired, few, one),
        ):  # fmt: skip
            again = renderer.draw_material(*changed, camera, SIZE)
            with GLRenderer() as fresh:
                alone = fresh.draw_material(*changed, camera, SIZE)
            assert np.array_equal(again, alone)
            assert not np.array_equal(again, first)
        both = knot_subject(two_sided=True)
        renderer.draw_material(both, few, one, camera, SIZE)
        assert np.array_equal(renderer.draw_material(subject, few, one, camera, SIZE), first)
        assert renderer._stages[4].program is program


def test_what_does_not_fit_is_refused(monkeypatch):
    context = create_context()
    with context:
        stage = Stage(context, 4)
        lobes = exact_lobes(sky().T)
        crowd = Lobes(np.ones((3, most_lobes(4) + 1, 3)), np.ones((3, most_lobes(4) + 1, 4)))
        with pytest.raises(ValueError, match="do not fit"):
            stage.light(crowd)
        with pytest.raises(ValueError, match="do not fit"):
            stage.light(exact_lobes(sky(3).T))
        with pytest.raises(ValueError, match="does not fit"):
            stage.material(shining(3))
        monkeypatch.setattr(module, "TEXTURE_WIDTH", 4)
        small = Stage(context, 4)
        huge = Subject(np.zeros((17_000, 3)), np.zeros((1, 3), np.int32), knot_subject().front)
        with pytest.raises(PrtnetError, match="do not fit a texture"):
            small.show(huge)
        stage.light(lobes)
        stage.release()
    context.release()


def test_it_draws_without_timers(monkeypatch):
    subject, lobes, operator = knot_subject(), exact_lobes(sky().T), shining(4)
    with_timer = drawn("gl", subject, lobes, operator)

    def none(*_args: object, **_kwargs: object) -> None:
        raise RuntimeError("no queries")

    monkeypatch.setattr(moderngl.Context, "query", none)
    assert np.array_equal(drawn("gl", subject, lobes, operator), with_timer)


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("two_sided", [False, True])
def test_visibility_is_rebuilt_from_latents(two_sided, storage):
    """As from the model's own visibility, whatever it is stored in."""
    model = random_model(receivers=700, clusters=7, parts=2).stored_as(storage)
    pictures = pictures_of(model, random_poses(1, 5), two_sided)
    assert np.abs(pictures[0] - pictures[1]).max() <= 1e-4 * np.abs(pictures[0]).max()


@pytest.mark.parametrize("storage", ["float32", "int8"])
@pytest.mark.parametrize("count", [1, 2])
def test_lobes_are_rebuilt_from_latents(count, storage):
    model = random_model(receivers=700, clusters=7, parts=2, lobes=count).stored_as(storage)
    pictures = pictures_of(model, random_poses(1, 5), True)
    assert np.abs(pictures[0] - pictures[1]).max() <= 1e-4 * np.abs(pictures[0]).max()


@pytest.mark.parametrize("kind", ["maps", "network"])
@pytest.mark.parametrize("body", ["skin", "sheet"])
@pytest.mark.parametrize("two_sided", [False, True])
def test_a_prior_is_added_in_the_shader(kind, body, two_sided):
    if body == "skin":
        prior = random_prior(kind, receivers=700, surroundings=random_skin(receivers=700))
        model, pose = beside_prior(random_model(receivers=700), prior), random_poses(1, 5)
    else:
        model, poses = sheet_with_prior(kind)
        pose = poses[-1:]
    pictures = pictures_of(model, pose, two_sided)
    assert np.abs(pictures[0] - pictures[1]).max() <= 1e-4 * np.abs(pictures[0]).max()


@pytest.mark.parametrize("what", ["coefficients", "lobes", "skin", "sheet"])
def test_what_one_receiver_sees_is_read_back(what):
    """As the model has it, whatever pose or characters were drawn before."""
    poses = random_poses(2, 5)
    if what == "skin":
        prior = random_prior("maps", receivers=700, surroundings=random_skin(receivers=700))
        model = beside_prior(random_model(receivers=700), prior)
    elif what == "sheet":
        model, found = sheet_with_prior("network")
        poses = found[-2:]
    else:
        model = random_model(receivers=700, parts=2, lobes=2 if what == "lobes" else 0)
    tables, context = gpu_tables(model), create_context()
    expected = model(poses)
    with context:
        stage = Stage(context, model.order, tables)
        for pose in (0, 1, 0):
            given = [latents_of(model, tables, poses[pose])]
            given += [] if tables.prior is None else [tables.prior.seen.posed(poses[pose])]
            for receiver in (0, 5, len(expected[0]) - 1):
                seen = stage.visibility_of(receiver, *given)
                assert seen.shape == (model.order**2,)
                np.testing.assert_allclose(
                    seen, expected[pose, receiver], atol=1e-4 * np.abs(expected).max()
                )
        stage.release()
    context.release()


@pytest.mark.parametrize("order", [1, 2])
def test_bands_of_rebuilt_visibility_are_cut(order):
    model, pose = random_model(receivers=700, clusters=7, parts=2), random_poses(1, 5)
    pictures = pictures_of(model, pose, False, order)
    assert np.abs(pictures[0] - pictures[1]).max() <= 1e-4 * np.abs(pictures[0]).max()
    whole = pictures_of(model, pose, False)
    assert np.abs(pictures[1] - whole[1]).max() > 0.05 * np.abs(whole[1]).max()


def pictures_of(model, pose, two_sided, order=0):
    """Pictures with the model's own visibility, and with that rebuilt in the shader."""
    tables = gpu_tables(model)
    visibility = model(pose)[0]
    latents = latents_of(model, tables, pose[0])
    occluders = None if tables.prior is None else tables.prior.seen.posed(pose[0])
    knot = knot_subject(model.order, two_sided)
    rng = np.random.default_rng(3)
    receivers = [rng.integers(0, len(visibility), len(knot.positions)) for _ in knot.sides]
    sides = [
        Side(visibility[own], side.frames) for own, side in zip(receivers, knot.sides, strict=True)
    ]
    subject = Subject(knot.positions, knot.faces, *sides)
    lobes, operator = exact_lobes(sky(model.order).T), shining(model.order)
    camera = three_quarters(knot, SIZE)
    context = create_context()
    with context:
        pictures = []
        for given in (None, tables):
            stage = Stage(context, model.order, given)
            stage.light(lobes)
            stage.material(operator)
            stage.show_bands(order)
            if given is None:
                stage.show(subject)
            else:
                for _ in range(2):  # a second pose goes into what is there
                    stage.show_latents(knot, latents, receivers, occluders)
            frame = context.framebuffer(
                [context.texture(SIZE, 4, dtype="f4")], context.depth_renderbuffer(SIZE)
            )
            frame.clear(0.0, 0.0, 0.0, 0.0, depth=1.0)
            stage.draw(frame, camera.matrix(SIZE[0] / SIZE[1]), np.asarray(camera.eye))
            pictures.append(np.frombuffer(frame.read(components=4, dtype="f4"), dtype="f4"))
            stage.release()
    context.release()
    assert np.abs(pictures[0]).max() > 0.1
    return pictures
