"""Everything that prtnet reads: sound files of each kind, how they are damaged, and their use."""

from __future__ import annotations

import functools
import io
import json
import os
import random
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenEXR
import trimesh
from PIL import Image

from data_gen.gltf_writer import write_glb
from data_gen.grey_image import read_grey
from data_gen.readers import read_scene
from data_gen.scene_info import describe
from data_gen.static_mesh import read_mesh
from prtnet.all_frequency_file import load_fields, save_fields
from prtnet.array_file import ALL_FREQUENCY, header_key
from prtnet.block_files import read_block, read_part, write_block
from prtnet.cli_info import described
from prtnet.cli_render_field import read_field, worn_by
from prtnet.dataset import POSE_ARRAYS, Dataset
from prtnet.dataset_repair import DatasetRepair
from prtnet.dataset_writer import DatasetWriter
from prtnet.environment import environment
from prtnet.errors import PrtnetError
from prtnet.lobe_fit import lobe_field
from prtnet.merl import read_merl
from prtnet.model import VisibilityModel
from runtime.all_frequency_shot import framing, opened
from runtime.camera import Camera
from runtime.field_shot import FieldShot
from tests.all_frequency import random_field
from tests.fuzzing import array_files, pictures, scenes
from tests.fuzzing.files import Files, Holed, target
from tests.gltf_builder import Builder
from tests.models import random_model
from tests.priors import beside_prior, random_prior, sheet_with_prior
from tests.prtnet import test_dataset, test_hdr, test_transfer
from tests.prtnet.test_lobe_field import mesh as lobe_mesh
from tests.prtnet.test_lobe_field import patch as lobe_patch
from tests.small_scene import small_scene

__all__ = ["READERS", "Reader"]

LARGE = 1 << 20  # bytes
STRETCHED = 0.01  # of cases: a whole file, and then zeros up to a terabyte
UP = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8]])


@dataclass(frozen=True)
class Reader:
    """One kind of input.

    Attributes:
        make: writes sound files into an empty folder, each with what belongs to it.
        mutate: a damaged copy of a case's files.
        use: reads the file as commands do, and does a little with it.
        writes: whether it changes files, of the case's folder alone.
    """

    make: Callable[[Path], list[Files]]
    mutate: Callable[[Files, random.Random], Files]
    use: Callable[[Path], object]
    writes: bool = False

    @functools.cached_property
    def sound(self) -> list[Files]:
        """Small valid cases."""
        with tempfile.TemporaryDirectory() as folder:
            return self.make(Path(folder))

    def case(self, seed: object) -> Files:
        """The damaged files of a seed."""
        return self.drawn(random.Random(str(seed)))

    def drawn(self, rng: random.Random) -> Files:
        """The damaged files that come of what is drawn: by chance, or by Hypothesis."""
        files = dict(rng.choice(self.sound))
        (name, data), *_ = files.items()
        if isinstance(data, bytes) and rng.random() < STRETCHED:
            return files | {name: Holed(10**12, {0: data})}
        return self.mutate(files, rng)


def single(folder: Path) -> list[Files]:
    """Each file of a folder as a case of its own."""
    return [{path.name: path.read_bytes()} for path in sorted(folder.iterdir()) if path.is_file()]


def glbs(folder: Path) -> list[Files]:
    write_glb(small_scene(), folder / "one.glb")
    write_glb(small_scene(flat=True), folder / "two.glb")
    return single(folder)


def gltfs(folder: Path) -> list[Files]:
    b = Builder()
    b.mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [0, 1, 2, 0, 2, 3])
    b.json["nodes"] = [{"mesh": 0}]
    b.clip((0, "scale", [0, 1], np.ones((2, 3)), "LINEAR"))
    b.gltf(folder / "scene.gltf", "in.bin")
    return [{name: (folder / name).read_bytes() for name in ("scene.gltf", "in.bin")}]


def use_scene(path: Path) -> None:
    scene = read_scene(path)
    json.dumps(describe(scene))
    for clip in scene.clips:
        geometry = scene.geometry(scene.poses(clip, clip.times(count=3)))
        assert np.isfinite(geometry.positions).all()
        length = np.linalg.norm(geometry.normals.astype(float), axis=-1)
        assert np.abs(length - 1.0).max(initial=0.0) < 1e-5


def point_caches(folder: Path) -> list[Files]:
    rng = np.random.default_rng(0)
    positions = rng.normal(size=(3, 5, 3)).astype(np.float32)
    faces = np.array([[0, 1, 2], [2, 1, 3], [3, 4, 0]], dtype=np.int32)
    np.savez(folder / "stored.npz", positions=positions, faces=faces, fps=24.0)
    np.savez_compressed(folder / "packed.npz", positions=positions, faces=faces, fps=np.int32(30))
    return single(folder)


def hdrs(folder: Path) -> list[Files]:
    rng = np.random.default_rng(0)
    rgbe = test_hdr.encode(rng.uniform(0.1, 9.0, (8, 16, 3)))
    (folder / "flat.hdr").write_bytes(test_hdr.flat(rgbe))
    (folder / "runs.hdr").write_bytes(test_hdr.coded(rgbe))
    text = test_hdr.coded(rgbe).replace(b"\n\n", b"\nEXPOSURE=2.5\n# by hand\n\n", 1)
    (folder / "told.hdr").write_bytes(text)
    return single(folder)


def exrs(folder: Path) -> list[Files]:
    pixels = np.random.default_rng(0).uniform(0, 9, (8, 16, 3)).astype(np.float32)
    for name in ("NO", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "B44", "DWAA"):
        header = {"type": OpenEXR.scanlineimage,
                  "compression": getattr(OpenEXR, f"{name}_COMPRESSION")}  # fmt: skip
        half = pixels.astype(np.float16) if name in ("B44", "PIZ") else pixels
        OpenEXR.File(header, {"RGB": half}).write(str(folder / f"{name}.exr"))
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {"Y": pixels[..., 0].copy()}).write(
        str(folder / "grey.exr")
    )
    return single(folder)


def use_light(path: Path) -> None:
    light = environment(path)
    assert np.isfinite(light.harmonics(4)).all()
    assert np.isfinite(light.radiance(UP)).all()


def grey_pictures(folder: Path) -> list[Files]:
    grey = np.random.default_rng(0).integers(0, 256, (6, 8), dtype=np.uint8)
    for suffix in ("png", "jpg", "tif", "bmp", "webp", "tga", "pgm"):
        Image.fromarray(grey).save(folder / f"grey.{suffix}")
    colour = np.dstack([grey, grey[::-1], grey, grey])
    for suffix in ("png", "tif", "webp", "tga"):
        Image.fromarray(colour).save(folder / f"colour.{suffix}")
    for how in ("tiff_lzw", "jpeg", "tiff_adobe_deflate", "packbits", "group4"):
        bits = Image.fromarray(grey).convert("1") if how == "group4" else Image.fromarray(grey)
        bits.save(folder / f"{how}.tif", compression=how)
    Image.fromarray(grey.astype(np.uint16) * 256).save(folder / "deep.png")
    Image.fromarray(grey.astype(np.float32)).save(folder / "float.tif")
    Image.fromarray(grey).convert("P").save(folder / "palette.png")
    # What Pillow knows and a height field is not, under a name that fits.
    for kind in ("GIF", "EPS", "PCX", "DDS"):
        file = io.BytesIO()
        Image.fromarray(np.dstack([np.tile(grey, (4, 4))] * 3)).save(file, kind)
        (folder / f"{kind}.png").write_bytes(file.getvalue())
    (folder / "exr").mkdir()
    return sorted(single(folder), key=target, reverse=True) + exrs(folder / "exr")


def merls(folder: Path) -> list[Files]:
    return [{"zeros.binary": Holed(pictures.WHOLE, {0: pictures.HEADER})}]


def use_merl(path: Path) -> None:
    assert np.isfinite(read_merl(path).above(UP, UP[::-1])).all()


def meshes(folder: Path) -> list[Files]:
    mesh = trimesh.creation.box()
    for suffix in ("ply", "obj", "stl", "off"):
        mesh.export(folder / f"mesh.{suffix}")
    mesh.export(folder / "text.ply", encoding="ascii", vertex_normal=True)
    mesh.export(folder / "text.stl", file_type="stl_ascii")
    mesh.export(folder / "normals.ply", vertex_normal=True)
    made = (folder / "mesh.obj").read_text()
    links = "mtllib mesh.mtl\nmtllib ../outside.mtl\nusemtl a\n"
    (folder / "material.obj").write_text(links + made)
    words = (folder / "text.ply").read_text()
    (folder / "texture.ply").write_text(
        words.replace("\nelement", "\ncomment TextureFile ../outside.png\nelement", 1)
    )
    beside: Files = {"mesh.mtl": b"newmtl a\nmap_Kd ../outside.png\nmap_Ka http://localhost:9/x\n"}
    return [case | beside for case in single(folder)]


def transfer_fields(folder: Path) -> list[Files]:
    fields = (test_transfer.patch(), test_transfer.patch(3, glossy=True), test_transfer.mesh())
    for number, field in enumerate(fields):
        field.save(folder / f"{number}.safetensors")
    return single(folder)


def lobe_fields(folder: Path) -> list[Files]:
    for number, field in enumerate((lobe_patch(), lobe_patch(3), lobe_mesh())):
        lobe_field(field, 2, coherent=False).save(folder / f"{number}.safetensors")
    return single(folder)


def all_frequency_fields(folder: Path) -> list[Files]:
    for number in range(2):
        field = random_field(number, rows=1 + number, size=4, clusters=2, cells=4, terms=2)
        save_fields(folder / f"{number}.safetensors", [field] * (number + 1))
    return single(folder)


def models(folder: Path) -> list[Files]:
    made = {
        "neural": random_model(),
        "linear": random_model("linear", "joint_angles"),
        "quadratic": random_model("quadratic", "local_joints", morphs=2),
        "constant": random_model("constant", "local_joints"),
        "parts": random_model("neural", "local_joints", parts=2, clamped=False),
        "lobes": random_model("neural", "occluders", lobes=2),
        "hybrid": beside_prior(random_model(), random_prior("maps"), bounded=True),
        "shared": beside_prior(random_model(), random_prior("network")),
        "sheet": sheet_with_prior("network")[0],
    }
    for name, model in made.items():
        model.save(folder / f"{name}.safetensors")
    for storage in ("float16", "int8", "int4"):
        made["neural"].stored_as(storage).save(folder / f"{storage}.safetensors")
    made["hybrid"].stored_as("int8").save(folder / "hybrid8.safetensors")
    return single(folder)


def use_model(path: Path) -> None:
    use_facts(path)
    model = VisibilityModel.load(path)
    with np.errstate(all="ignore"):  # made-up numbers may be of any size
        model(np.resize(np.eye(3, 4, dtype=np.float32).ravel(), (1, model.pose_size)))


def use_facts(path: Path) -> None:
    json.dumps(described(path)).encode()


def datasets(folder: Path) -> list[Files]:
    test_dataset.write(folder / "old.zarr")
    test_dataset.write(folder / "new.zarr", made_with={"prtnet": "0"})
    return [folder_files(folder, folder / name) for name in ("old.zarr", "new.zarr")]


def whole_datasets(folder: Path) -> list[Files]:
    test_dataset.write(folder / "set.zarr")
    return [folder_files(folder, folder / "set.zarr")]


def use_dataset(path: Path) -> None:
    data = Dataset.open(path)
    json.dumps(data.attributes).encode()
    for name in POSE_ARRAYS:
        data.read(name, slice(0, 4))
    data.training_poses()
    for clip in data.clip_names:
        data.poses_of(clip)


def half_written(folder: Path) -> list[Files]:
    """Datasets with none, one and two of their three blocks."""
    found = []
    for blocks in range(3):
        own = folder / str(blocks)
        own.mkdir()
        book = test_dataset.writer(own / "set.zarr")
        for block in range(blocks):
            book.write(block, test_dataset.part(test_dataset.whole(), book.span(block)))
        found.append(folder_files(own, book.partial))
    return found


def folder_files(folder: Path, root: Path) -> Files:
    """What is in a group of Zarr, its own header first."""
    names = [root / "zarr.json", *(p for p in sorted(root.rglob("*")) if p != root / "zarr.json")]
    return {str(path.relative_to(folder)): path.read_bytes() for path in names if path.is_file()}


def ended(path: Path, name: str, write: Callable[[Path], DatasetWriter]) -> None:
    """Write the rest of a dataset, of a copy under that name; what comes of it must be whole."""
    with tempfile.TemporaryDirectory(dir=path.parent) as made:
        shutil.copytree(path, Path(made) / name, symlinks=True, copy_function=copied)
        done = test_dataset.filled(write(Path(made) / "set.zarr")).finish()
        try:
            use_dataset(done)
        except PrtnetError as error:
            raise AssertionError("what was called whole is not") from error


def copied(source: str, target: str) -> None:
    """A file that is small, or the same one again."""
    (os.link if os.path.getsize(source) > LARGE else shutil.copyfile)(source, target)


def use_half_written(path: Path) -> None:
    ended(path, path.name, test_dataset.writer)


def use_damaged(path: Path) -> None:
    ended(path, "set.zarr", repair)


def repair(path: Path) -> DatasetRepair:
    """One of the datasets that ``test_dataset`` writes."""
    told = test_dataset.ATTRIBUTES, test_dataset.fixed(), test_dataset.POSES, test_dataset.BLOCK
    return DatasetRepair(path, *told)


def blocks(folder: Path) -> list[Files]:
    """What passes between machines: JSON, and arrays of several types."""
    rng = np.random.default_rng(0)
    arrays = {"a": rng.normal(size=(4, 3)), "b": np.arange(5, dtype=np.int32), "c": np.zeros(0)}
    write_block(folder / "given", {}, arrays)
    write_block(folder / "done", {"rounds": 3, "error": [0.5, 0.25]}, arrays)
    return single(folder)


def use_block(path: Path) -> None:
    header, arrays = read_block(path)
    json.dumps(header).encode()
    for name in arrays:
        read_part(path, name, slice(1, 3)) if arrays[name].ndim else read_part(path, name)


def use_field(path: Path) -> None:
    """Facts, and a picture of a few pixels."""
    use_facts(path)
    if header_key(path) == ALL_FREQUENCY:
        fields = load_fields(path)
        camera = framing(fields, 1.0, 0.5, 0.2)
        with opened(fields, "cpu", (4, 4)) as drawer:
            drawer.light(np.ones((24, (fields[0].size // 2) ** 2, 3), dtype=np.float32))
            drawn = drawer.draw(camera.matrix(1.0), np.asarray(camera.eye))
    else:
        field = read_field(path)
        canvas = worn_by(None, 1, field.layout).rest
        light = np.linspace(1.0, 0.5, 3 * field.order**2).reshape(-1, 3)
        camera = Camera.framing(canvas.positions, 1.0, 0.5, 0.2)
        drawn = FieldShot(canvas, light, camera, (4, 4)).draw(field, by_table=False, samples=1)
    assert np.isfinite(drawn).all()


READERS = {
    "glb": Reader(glbs, scenes.gltf, use_scene),
    "gltf": Reader(gltfs, scenes.gltf, use_scene),
    "point cache": Reader(point_caches, array_files.npz, use_scene),
    "hdr light": Reader(hdrs, pictures.lines, use_light),
    "exr light": Reader(exrs, pictures.plain, use_light),
    "picture": Reader(grey_pictures, pictures.plain, read_grey),
    "merl": Reader(merls, pictures.measured, use_merl),
    "mesh": Reader(meshes, pictures.lines, read_mesh),
    "dataset": Reader(datasets, array_files.zarr_group, use_dataset),
    "model": Reader(models, array_files.safetensors_file, use_model),
    "transfer": Reader(transfer_fields, array_files.safetensors_file, use_field),
    "lobes": Reader(lobe_fields, array_files.safetensors_file, use_field),
    "all-frequency": Reader(all_frequency_fields, array_files.safetensors_file, use_field),
    "half a dataset": Reader(half_written, array_files.zarr_group, use_half_written, True),
    "dataset to repair": Reader(whole_datasets, array_files.zarr_group, use_damaged, True),
    "block of a cluster": Reader(blocks, array_files.safetensors_file, use_block),
}
"""By name, in the order of the table in docs/reliability.md."""
