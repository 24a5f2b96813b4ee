"""What lives on the GPU is given back once, and nothing is left by a picture after the other."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import moderngl
import numpy as np
import pytest

from data_gen.procedural import arm
from prtnet.cli_render import tracers
from prtnet.environment import environment
from prtnet.gpu_tables import gpu_tables
from prtnet.lobe_fit import lobe_field
from prtnet.materials import brdf_named, material
from prtnet.one_dimensional import OneDimensional
from prtnet.zh import exact_lobes
from runtime.all_frequency_stage import AllFrequencyStage
from runtime.cast import Cast
from runtime.field_show import FieldShow
from runtime.field_view import FieldView
from runtime.gl import GLRenderer, create_context
from runtime.lobe_stage import LobeStage
from runtime.one_dimensional_stage import OneDimensionalStage
from runtime.overlay import Overlay
from runtime.painted import Painted
from runtime.screen import Screen
from runtime.show import Show
from runtime.stage import Stage
from runtime.studio import Studio
from runtime.view import MODES, View
from tests.all_frequency import random_field
from tests.models import random_model, random_poses
from tests.runtime.scenes import knot, knot_subject, sky, three_quarters
from tests.runtime.shader import latents_of
from tests.runtime.test_field_viewer import of_mesh
from tests.runtime.test_lobe_stage import bumpy
from tests.runtime.test_one_dimensional_stage import lobed
from tests.runtime.test_posed_surface import modelled

pytestmark = pytest.mark.gl

SIZE = (64, 48)
MAKERS = (
    "buffer", "texture", "program", "vertex_array", "framebuffer", "renderbuffer",
    "depth_renderbuffer",
)  # fmt: skip


class Books:
    """What a context made and what was given back of it, by identity."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.made: list[Any] = []
        self.returned: Counter[int] = Counter()
        for name in MAKERS:
            monkeypatch.setattr(moderngl.Context, name, self.noting(name))
        for kind in (
            moderngl.Buffer, moderngl.Texture, moderngl.Program, moderngl.VertexArray,
            moderngl.Framebuffer, moderngl.Renderbuffer,
        ):  # fmt: skip
            monkeypatch.setattr(kind, "release", self.counting(kind.release))

    def noting(self, name: str) -> Callable[..., Any]:
        real = getattr(moderngl.Context, name)

        def make(context: moderngl.Context, *given: Any, **named: Any) -> Any:
            self.made.append(real(context, *given, **named))
            return self.made[-1]

        return make

    def counting(self, real: Callable[[Any], None]) -> Callable[[Any], None]:
        def release(held: Any) -> None:
            self.returned[id(held)] += 1
            real(held)

        return release

    @property
    def open(self) -> list[Any]:
        return [held for held in self.made if not self.returned[id(held)]]


@pytest.fixture
def context() -> Iterator[moderngl.Context]:
    made = create_context()
    with made:
        made.extra = made.simple_framebuffer(SIZE)
        made.extra.use()
        yield made
    made.release()


@pytest.fixture
def books(monkeypatch: pytest.MonkeyPatch) -> Books:
    """Of what is made from here on."""
    return Books(monkeypatch)


def stage(context: moderngl.Context) -> Stage:
    """Shown twice, with and without a back, in two materials."""
    found = Stage(context, 4)
    found.light(exact_lobes(sky().T))
    for both, name in ((True, "gold"), (False, "satin")):
        found.show(knot_subject(two_sided=both, detail=1))
        found.material(material(brdf_named(name)))
        found.draw(context.extra, np.eye(4), np.ones(3))
    return found


def rebuilding(context: moderngl.Context) -> Stage:
    model, pose = random_model(receivers=700), random_poses(1, 5)
    tables = gpu_tables(model)
    found = Stage(context, model.order, tables)
    latents = latents_of(model, tables, pose[0])
    subject = knot_subject(model.order, detail=1)
    found.light(exact_lobes(sky(model.order).T))
    found.material(material(brdf_named("matte"), order=model.order))
    found.show_latents(subject, latents, [np.zeros(len(subject.positions), np.int32)])
    found.draw(context.extra, np.eye(4), np.ones(3))
    found.visibility_of(3, latents)
    return found


def screen(context: moderngl.Context) -> Screen:
    """Of two sizes."""
    found = Screen(context)
    for size in (SIZE, (32, 32), SIZE):
        found.clear(size)
        found.present(context.extra, 1.0)
    return found


def overlay(context: moderngl.Context) -> Overlay:
    found = Overlay(context)
    found.draw(context.extra, np.zeros((5, 7, 4), np.uint8), (1, 2))
    return found


def painted(context: moderngl.Context) -> Painted:
    found, surface = Painted(context), knot(detail=1)
    found.draw(context.extra, surface, np.eye(4), 1.0)
    return found


def one_dimensional(context: moderngl.Context) -> OneDimensionalStage:
    """Shown with and without a back."""
    found = OneDimensionalStage(context, 4, 3)
    found.light(exact_lobes(sky().T))
    found.material(OneDimensional(transmitted=0.2))
    for both in (True, False):
        found.show(lobed(4, both, 2))
        found.draw(context.extra, np.eye(4), np.ones(3))
    return found


OWNERS: dict[str, Callable[[moderngl.Context], Any]] = {
    "stage": stage, "rebuilding": rebuilding, "screen": screen, "overlay": overlay,
    "painted": painted, "one-dimensional": one_dimensional,
    "all-frequency": lambda context: AllFrequencyStage(context, random_field()),
    "summed by the GPU": lambda context: AllFrequencyStage(context, random_field(), "gpu"),
    "lobes": lambda context: LobeStage(context, lobe_field(bumpy(1, 4), 2)),
}  # fmt: skip


@pytest.mark.parametrize("name", OWNERS)
def test_everything_is_given_back_once(context, books, name):
    owner = OWNERS[name](context)
    assert books.open
    owner.release()
    assert not books.open
    assert set(books.returned.values()) == {1}
    owner.release()  # harmless


def test_a_renderer_can_be_closed_twice(books):
    renderer = GLRenderer()
    subject, surface = knot_subject(detail=1), knot(detail=1)
    camera = three_quarters(subject, SIZE)
    for _ in range(2):
        renderer.draw(surface, sky(), camera.matrix(4 / 3), SIZE)
        renderer.draw_material(
            subject, exact_lobes(sky().T), material(brdf_named("gold")), camera, SIZE
        )
    renderer.close()
    assert not books.open
    assert set(books.returned.values()) == {1}
    renderer.close()


def test_pictures_leave_nothing_behind(context, books):
    """Every mode, split, a crowd, a vertex: the second time round nothing is held but the first."""
    actor = modelled(arm(segments=6), False)
    tables = gpu_tables(actor.model)

    def latents(poses: np.ndarray) -> np.ndarray:
        return np.stack([latents_of(actor.model, tables, pose) for pose in poses])

    cast = Cast(actor, actor.model, *tracers(actor, 16, 1), (latents, tables))
    show = Show(context, cast, Studio(environment))
    view = View("bend", 1.0, brdf="gold", split=0.5, right="ambient", vertex=(3, False))
    held = []
    for _ in range(3):
        for mode in MODES:
            for view.copies in (1, 2):
                view.left = mode
                show.settle(view)
                show.draw(view, SIZE, context.extra)
        held.append(len(books.open))
    assert held[1] == held[2]
    show.release()
    assert not books.open
    assert set(books.returned.values()) == {1}
    show.release()


def test_pictures_of_fields_leave_nothing_behind(context, books):
    """Every mode, other numbers of lobes and poses: the second time round nothing more is held."""
    show = FieldShow(context, of_mesh(), environment)
    view = FieldView(split=0.5, right="harmonics")
    held = []
    for turn in range(3):
        for view.left, view.count in (("lobes", 2), ("lobes", 3), ("one lobe", 3), ("truth", 3)):
            view.twist = 10.0 * turn  # traced anew
            show.settle(view)
            show.draw(view, SIZE, context.extra)
        held.append(len(books.open))
    assert held[0] == held[1] == held[2]
    show.release()
    assert not books.open
    assert set(books.returned.values()) == {1}
    show.release()
