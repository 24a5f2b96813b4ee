"""A picture without a window is the one that a window would show."""

from __future__ import annotations

import numpy as np
import pytest

from data_gen.procedural import arm
from prtnet.cli_render import tracers
from prtnet.environment import environment
from prtnet.materials import brdf_named, material
from prtnet.modelled_scene import ModelledScene
from prtnet.one_dimensional import OneDimensional
from runtime.cast import Cast
from runtime.draw import opened
from runtime.gl import create_context
from runtime.looks import lobes_of
from runtime.shot import Posed, Shot
from runtime.show import Show
from runtime.studio import Studio
from runtime.view import MODES, Mode, View, framing
from tests.runtime.test_posed_surface import modelled

SIZE = (120, 90)
RAYS = 32


@pytest.fixture(scope="module", params=[False, True], ids=["one-sided", "two-sided"])
def actor(request: pytest.FixtureRequest) -> ModelledScene:
    return modelled(arm(segments=6), request.param)


def shot_of(actor: ModelledScene, view: View, show: Show) -> Shot:
    """What ``prtnet render`` makes of the same options, from where the viewer's camera is."""
    order = actor.model.order
    light = environment(view.light).turned(view.light_turn)
    brdf = brdf_named(view.brdf, bool(actor.model.lobes))
    lobed = isinstance(brdf, OneDimensional)
    return Shot(
        Posed(actor, view.pose(actor), *tracers(actor, RAYS, 1)), show.camera(view), light,
        lobes_of(light.harmonics(order), view.lobes), brdf,
        None if lobed else material(brdf, view.factors, order), SIZE, view.order,
    )  # fmt: skip


@pytest.mark.gl
@pytest.mark.parametrize("mode", MODES)
def test_both_draw_every_mode_alike(actor, mode):
    """Fewer bands, a blended pose, a turned light, a vertex's sphere: in everything there is."""
    alike(actor, mode, "phong")


@pytest.mark.gl
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("two_sided", [False, True])
def test_both_draw_lobes_alike(mode, two_sided):
    words = "lobe:exponent=3.5,diffuse=0.3/0.2/0.1"
    words += ",transmitted=0.3" if two_sided or mode != "truth" else ""
    alike(modelled(arm(segments=6), two_sided, lobes=2), mode, words)


def alike(actor: ModelledScene, mode: Mode, brdf: str) -> None:
    """What a viewer draws is what is drawn without one."""
    view = View("bend", 1.5, "bend", 3.0, 0.4, light_turn=70.0, lobes=0, brdf=brdf, left=mode,
                order=2, distance=0.7)  # fmt: skip
    context = create_context()
    with context:
        cast = Cast(actor, actor.model, *tracers(actor, RAYS, 1))
        show = Show(context, cast, Studio(environment))
        show.screen.samples = 0
        show.settle(view)
        view.vertex = (25, False)
        target = context.framebuffer([context.texture(SIZE, 4)])
        for _ in range(2):
            show.draw(view, SIZE, target)
        data = np.frombuffer(target.read(components=3, alignment=1), dtype=np.uint8)
        seen = data.reshape(SIZE[1], SIZE[0], 3)[::-1].astype(int)
        shot = shot_of(actor, view, show)
        with opened("cpu") as renderer:
            exposure = show.exposures.get("studio")
            picture, _ = shot.split(renderer, (mode, mode), 1.0, exposure)
            covered = shot.draw(renderer, mode)[..., 3] == 1.0
            assert covered.mean() > 0.03
        traced = mode in ("visibility", "error")
        expected = shot.with_vertex(picture, 25, traced).astype(int)
        show.release()
    context.release()
    away = np.abs(seen - expected).max(axis=-1)
    # Of one sample a pixel and of the mean of four; at edges they differ.
    assert np.mean(away[covered] <= 4) > 0.9
    assert np.mean(away <= 4) > 0.97


def test_a_split_shows_one_beside_the_other(actor):
    view = View("bend", 1.5, brdf="phong")
    order = actor.model.order
    posed = Posed(actor, view.pose(actor), *tracers(actor, RAYS, 1))
    light, brdf = environment("studio"), brdf_named("phong")
    shot = Shot(posed, framing(actor, "bend"), light, lobes_of(light.harmonics(order), 3), brdf,
                material(brdf, 8, order), SIZE)  # fmt: skip
    with opened("cpu") as renderer:
        whole, exposure = shot.split(renderer, ("prediction", "open"), 1.0, None)
        right, same = shot.split(renderer, ("prediction", "open"), 0.0, exposure)
        both, _ = shot.split(renderer, ("prediction", "open"), 0.5, exposure)
        assert same == exposure
        brighter, _ = shot.split(renderer, ("prediction", "open"), 1.0, exposure, stops=1.0)
        _, unlit = shot.split(renderer, ("error", "ambient"), 0.5, None)
    assert np.array_equal(both[:, :60], whole[:, :60])
    assert np.array_equal(both[:, 60:], right[:, 60:])
    assert brighter.astype(int).sum() > whole.astype(int).sum()
    assert unlit is None
