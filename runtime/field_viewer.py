"""The window of ``prtnet view FIELD``: a :class:`runtime.field_show.FieldShow`."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import ClassVar

from runtime.base_viewer import (
    CAMERA_KEYS,
    COMMON_KEYS,
    LIGHTS,
    PLAY_KEYS,
    BaseDesk,
    BaseViewer,
    Steps,
)
from runtime.field_cast import FieldCast
from runtime.field_panel import FieldPanel
from runtime.field_show import FieldShow
from runtime.field_view import FIELD_MODES, FieldView

__all__ = ["FieldDesk", "FieldViewer"]


@dataclass
class FieldDesk(BaseDesk):
    """What is at a viewer's hand.

    Attributes:
        built_in: names of what patches can be laid on.
        open_files: a field's file and what it is on, made into what can be shown.
        field: the file of what is shown.
        on: what it is on; None for what goes with the field.
    """

    built_in: tuple[str, ...]
    open_files: Callable[[Path, str | None], FieldCast]
    field: Path
    on: str | None = None


class FieldViewer(BaseViewer[FieldShow, FieldView, FieldDesk]):
    """A window and the field it shows; see ``BaseViewer``."""

    modes = FIELD_MODES
    help = (
        *CAMERA_KEYS,
        *PLAY_KEYS,
        ("1 to 4", "lobes, one lobe, harmonics, truth"),
        ("drop", "fields, meshes and scenes to show them on, lights"),
        *COMMON_KEYS,
    )
    kinds: ClassVar[Mapping[str, str]] = {
        ".safetensors": "field",
        **dict.fromkeys((".glb", ".gltf", ".npz", ".ply", ".obj", ".stl", ".off"), "on"),
        **LIGHTS,
    }

    def made_panel(self) -> FieldPanel:
        """Surface, look, light."""
        return FieldPanel(self)

    def take_files(self, found: Mapping[str, Path]) -> None:
        """Show another field, or this one on something else."""
        on = str(found["on"]) if "on" in found else self.desk.on
        name = " and ".join(path.name for path in found.values())
        self.reopen(found.get("field", self.desk.field), on, name)

    def reopen(self, field: Path, on: str | None, name: str) -> None:
        """Show a field on something; what cannot be shown is told, and what is there stays.

        Args:
            field: its file.
            on: what it is to be on.
            name: what of both is opened.
        """

        def take(cast: FieldCast) -> Steps[str]:
            yield from self.take(cast)
            self.desk.field, self.desk.on = field, on
            return f"{field.name} on {Path(cast.worn.name).name}"

        self.open(name, partial(self.desk.open_files, field, on), take)

    def take(self, cast: FieldCast) -> Steps[None]:
        """Show another field, as this one is shown, if it can be.

        Raises:
            Exception: it cannot be drawn; this one stays.
        """

        def adapted() -> FieldView:
            view = dataclasses.replace(self.view)
            clip = cast.worn.clip(None)
            view.clip, view.time = ("", 0.0) if clip is None else (clip.name, clip.start)
            view.pan = (0.0, 0.0)
            view.left, view.right = "lobes", "harmonics"
            if cast.transfer is None:
                view.right, view.split = "lobes", 1.0
            return view

        context, lights = self.window.ctx, self.show.environments
        yield from self.replace(lambda: FieldShow(context, cast, lights), adapted)
