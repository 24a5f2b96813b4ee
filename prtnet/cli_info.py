"""The work of ``prtnet info``: what there is to say about a file, whatever it is.

Beside ``prtnet.cli``, which it serves, it may import the other packages.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from prtnet.array_file import ALL_FREQUENCY, LOBES, TRANSFER, header_key
from prtnet.places import is_folder, is_remote

__all__ = ["described"]


def described(path: Path) -> dict[str, Any]:
    """Facts about a scene, a dataset, a model or a field.

    Raises:
        PrtnetError: it is none, or damaged.
    """
    if path.suffix == ".safetensors" and not is_remote(path):
        return arrays_described(path)
    if is_folder(path):
        from prtnet.dataset import Dataset

        dataset = Dataset.open(path)
        sizes = {"poses": len(dataset), "receivers": len(dataset.receiver_side)}
        return {**sizes, "held_out_poses": len(dataset.held_out_poses()), **dataset.attributes}
    from data_gen.readers import read_scene
    from data_gen.scene_info import describe

    return describe(read_scene(path))


def arrays_described(path: Path) -> dict[str, Any]:
    """Facts about a field of any kind, or a model."""
    kind = header_key(path)
    if kind == ALL_FREQUENCY:
        from prtnet.all_frequency_file import facts, load_fields

        return facts(load_fields(path))
    if kind in (TRANSFER, LOBES):
        from prtnet.lobe_field import LobeField
        from prtnet.transfer import TransferField

        return (TransferField if kind == TRANSFER else LobeField).load(path).facts()
    from prtnet.model import VisibilityModel

    told = dict(VisibilityModel.load(path).metadata)
    return told | ({"search": told["search"]["why"]} if "search" in told else {})
