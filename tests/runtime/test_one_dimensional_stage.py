"""Pictures of 1D BRDFs by OpenGL against NumPy, and what changes without a new shader."""

from __future__ import annotations

import dataclasses

import moderngl
import numpy as np
import pytest

from prtnet.errors import PrtnetError
from prtnet.one_dimensional import OneDimensional
from prtnet.zh import Lobes, exact_lobes
from runtime import one_dimensional_shader
from runtime.draw import opened
from runtime.gl import GLRenderer, create_context
from runtime.looks import shaded_lobes
from runtime.one_dimensional import LobeSide, LobeSubject
from runtime.one_dimensional_stage import OneDimensionalStage
from runtime.picture import auto_exposure, srgb_encode
from tests.runtime.scenes import knot_subject, sky, three_quarters

pytestmark = pytest.mark.gl

SIZE = (120, 90)
MATERIAL = OneDimensional((0.1, 0.2, 0.3), (0.5, 0.4, 0.3), 7.3, (0.2, 0.1, 0.4))


def lobed(order: int, two_sided: bool, count: int | None = None) -> LobeSubject:
    """The knot with visibility as lobes: those that hold it exactly, or its first few."""
    knot = knot_subject(order, two_sided)
    sides = []
    for side in knot.sides:
        lobes = exact_lobes(side.visibility)
        few = Lobes(lobes.axes[:, :count], lobes.coefficients[:, :count])
        sides.append(LobeSide(shaded_lobes(few, 0), side.frames))
    return LobeSubject(knot.positions, knot.faces, *sides)


def drawn(name: str, subject: LobeSubject, material: OneDimensional = MATERIAL) -> np.ndarray:
    order = subject.front.visibility.coefficients.shape[-1]
    light, camera = exact_lobes(sky(order).T), three_quarters(knot_subject(), SIZE)
    with opened(name) as renderer:
        return renderer.draw_lobes(subject, light, material, camera, SIZE)


@pytest.mark.parametrize("two_sided", [False, True])
@pytest.mark.parametrize(("order", "count"), [(1, None), (2, 1), (4, 2), (4, None), (6, 1)])
def test_opengl_draws_what_numpy_draws(order, count, two_sided):
    subject = lobed(order, two_sided, count)
    want, got = drawn("cpu", subject), drawn("gl", subject)
    assert (want[..., 3] > 0).mean() > 0.1
    gain = auto_exposure(want)
    one, other = (255.0 * srgb_encode(gain * part[..., :3]) for part in (got, want))
    assert (np.abs(one - other).max(axis=-1) <= 2.0).mean() >= 0.999


def test_the_back_shadows_what_comes_through():
    """Without a back nothing does: more light, and only where there is transmission."""
    both = lobed(4, True)
    alone = dataclasses.replace(both, back=None)
    through = OneDimensional(0.0, 0.0, 1.0, 0.8)
    shadowed, unshadowed = (drawn("gl", subject, through) for subject in (both, alone))
    assert unshadowed[..., :3].sum() > 1.05 * shadowed[..., :3].sum()
    opaque = dataclasses.replace(through, transmitted=0.0)
    assert not drawn("gl", both, opaque)[..., :3].any()


def test_exponent_light_and_pose_change_without_a_new_shader(monkeypatch):
    subject, camera = lobed(4, True, 2), three_quarters(knot_subject(), SIZE)
    light = exact_lobes(sky(4).T)
    moved = dataclasses.replace(subject, positions=subject.positions + 0.1)
    dim = Lobes(light.axes, 0.5 * light.coefficients)
    flatter = dataclasses.replace(MATERIAL, exponent=0.5)
    with GLRenderer() as renderer:
        first = renderer.draw_lobes(subject, light, MATERIAL, camera, SIZE)
        monkeypatch.setattr(moderngl.Context, "program", None)
        for changed in ((moved, light, MATERIAL), (subject, dim, MATERIAL),
                        (subject, light, flatter)):  # fmt: skip
            again = renderer.draw_lobes(*changed, camera, SIZE)
            assert not np.array_equal(again, first)
        assert np.array_equal(renderer.draw_lobes(subject, light, MATERIAL, camera, SIZE), first)
    monkeypatch.undo()
    assert np.array_equal(again, drawn("gl", subject, flatter))


def test_meshes_of_other_sizes_go_into_the_same_stage():
    both = lobed(4, True, 1)
    small = knot_subject(detail=1)
    side = LobeSide(
        both.front.visibility[: len(small.positions)], both.front.frames[: len(small.positions)]
    )
    other = LobeSubject(small.positions, small.faces, side)
    camera, light = three_quarters(knot_subject(), SIZE), exact_lobes(sky(4).T)
    with GLRenderer() as renderer:
        for subject in (both, other, both):
            got = renderer.draw_lobes(subject, light, MATERIAL, camera, SIZE)
            assert np.array_equal(got, drawn("gl", subject))


def test_what_does_not_fit_is_refused(monkeypatch):
    subject = lobed(4, False, 2)
    context = create_context()
    with context:
        stage = OneDimensionalStage(context, 4, 3)
        with pytest.raises(ValueError, match="3 lobes of order 4"):
            stage.show(lobed(4, False, 1))
        with pytest.raises(ValueError, match="do not fit"):
            stage.light(exact_lobes(sky(3).T))
        monkeypatch.setattr(one_dimensional_shader, "WIDTH", 6)  # a vertex a row
        many = np.zeros(int(context.info["GL_MAX_TEXTURE_SIZE"]) + 1, dtype=int)
        side = LobeSide(subject.front.visibility[many], subject.front.frames[many])
        huge = LobeSubject(subject.positions[many], subject.faces, side)
        with pytest.raises(PrtnetError, match="use --renderer cpu"):
            stage.show(huge)
        stage.release()
    context.release()
