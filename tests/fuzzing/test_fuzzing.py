"""Every reader on damaged and hostile files: each case is read, or refused in one line."""

from __future__ import annotations

import collections
import json
import os
import random
import shutil
import socket
import time
import traceback
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from prtnet.errors import PrtnetError
from tests.fuzzing import array_files
from tests.fuzzing.array_files import bytes_of
from tests.fuzzing.files import Files, Holed, Link, Place, target
from tests.fuzzing.readers import READERS
from tests.fuzzing.scenes import LINKS, URIS
from tests.fuzzing.watch import WATCH, BreachError, bounded, outcome

CASES, WRITES = 300, 60  # of those that write, which take long
SECONDS = 4.0  # of processor time, for one case: the largest picture takes up to two
ROOM = 1 << 30  # bytes that a reader may take for files of a few kilobytes


@pytest.fixture
def place(tmp_path: Path) -> Place:
    (tmp_path / "outside.bin").write_bytes(bytes(4096))
    return Place(tmp_path / "case")


@pytest.mark.parametrize("name", READERS)
def test_sound_files_are_read(place: Place, name: str) -> None:
    for files in READERS[name].sound:
        if name == "picture" and files.keys() & {"GIF.png", "EPS.png", "PCX.png", "DDS.png"}:
            assert outcome(READERS[name].use, place.hold(files)) == "refused"
        else:
            reader = READERS[name]
            assert outcome(reader.use, place.hold(files), reader.writes) == "read", target(files)


@pytest.mark.parametrize("name", READERS)
def test_damaged_files(place: Place, name: str, capfd: pytest.CaptureFixture[str]) -> None:
    reader = READERS[name]
    reader.use(place.hold(reader.sound[0]))  # imports what it needs
    counts: collections.Counter[str] = collections.Counter()
    cases = WRITES if reader.writes else CASES

    def one(rng: random.Random) -> None:
        path = place.hold(reader.drawn(rng))
        start = time.process_time()
        counts[outcome(reader.use, path, reader.writes)] += 1
        assert time.process_time() - start < SECONDS

    some = settings(max_examples=cases // 3, suppress_health_check=list(HealthCheck))
    with bounded(ROOM):
        for case in range(cases):
            try:
                one(random.Random(f"test {name} {case}"))
            except Exception as error:
                pytest.fail(f"case {case}: {''.join(traceback.format_exception(error))[-2000:]}")
        # These repeat themselves, but go to the ends of every choice, and what fails they make
        # small.
        some(given(st.randoms(use_true_random=False))(one))()
    assert counts.total() >= cases + cases // 3
    assert counts["read"] > 0
    # What is damaged is mended by most of those that write.
    assert counts["refused"] > (0 if reader.writes else cases // 3)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", READERS)
def test_cases_are_the_same_again(name: str) -> None:
    assert READERS[name].case(3) == READERS[name].case(3)
    assert any(READERS[name].case(3) != READERS[name].case(seed) for seed in range(4, 9))


def leave(path: Path) -> None:
    (path.parent / "../outside.bin").read_bytes()


def link(path: Path) -> None:
    (path.parent / "link").read_bytes()


def write(path: Path) -> None:
    path.write_bytes(b"")


def call(path: Path) -> None:
    with socket.socket() as made:
        made.settimeout(1.0)
        made.connect_ex(("127.0.0.1", 9))


def run(path: Path) -> None:
    os.system("true")


def lines(path: Path) -> None:
    error = PrtnetError(path, "")
    raise type("Two", (PrtnetError,), {"__str__": lambda _: "two\nlines"})(path, "") from error


def hoard(path: Path) -> None:
    try:
        bytearray(1 << 60)
    except MemoryError as error:
        raise PrtnetError(path, "is damaged") from error


@pytest.mark.parametrize("misuse", [leave, link, write, call, run, lines, hoard])
def test_what_no_reader_may_do(place: Place, misuse: object) -> None:
    path = place.hold({"a": b"x", "link": Link("../outside.bin")})
    with pytest.raises(BreachError):
        outcome(misuse, path)  # type: ignore[arg-type]
    assert outcome(Path.read_bytes, place.hold({"a": b"x"})) == "read"


@pytest.mark.parametrize("name", ["in.bin", "folder/in.bin"])
def test_writers_change_their_folder_alone(place: Place, name: str) -> None:
    def use(path: Path) -> None:
        target = path.parent / name
        if target.parent != path.parent:
            target.parent.mkdir(exist_ok=True)
        target.write_bytes(b"")
        target.rename(path.parent / "other")
        (path.parent / "other").unlink()

    def steal(path: Path) -> None:
        os.rename(path, path.parent.parent / "outside.bin")

    path = place.hold({"a": b"x"})
    with pytest.raises(BreachError, match=r"open|mkdir"):
        outcome(use, path)
    assert outcome(use, path, writes=True) == "read"
    with pytest.raises(BreachError, match="rename"):
        outcome(steal, path, writes=True)


def stray(_: Path) -> None:
    Path("stray").write_bytes(b"")


def stray_folder(_: Path) -> None:
    os.mkdir("stray")


def cut(path: Path) -> None:
    os.truncate(path.parent / "link", 0)


def copied(path: Path) -> None:
    shutil.copyfile(path, path.parent.parent / "outside.bin")


@pytest.mark.parametrize("misuse", [stray, stray_folder, cut, copied])
def test_what_no_writer_may_do(
    place: Place, misuse: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = place.hold({"a": b"x", "link": Link("../outside.bin")})
    with pytest.raises(BreachError):
        outcome(misuse, path, writes=True)  # type: ignore[arg-type]


def test_memory_is_bounded() -> None:
    with bounded(ROOM), pytest.raises(MemoryError):
        bytearray(2 * ROOM)
    assert len(bytearray(2 * ROOM)) == 2 * ROOM  # not written to: no memory is taken


def test_a_place_holds_one_case_after_another(place: Place) -> None:
    place.hold({"a/b": b"1", "a/c": b"2"})
    path = place.hold({"a": Holed(10**12, {5: b"x"}), "d": Link("a")})
    assert path.stat().st_size == 10**12
    assert sorted(os.listdir(place.folder)) == ["a", "d"]
    with open(place.folder / "d", "rb") as file:
        assert file.read(7) == b"\0\0\0\0\0x\0"


@pytest.mark.parametrize("uri", URIS)
def test_buffers_lie_in_the_folder(place: Place, uri: str) -> None:
    (files,) = READERS["gltf"].sound
    document = json.loads(bytes_of(files["scene.gltf"]))
    document["buffers"][0]["uri"] = uri
    case = files | LINKS | {"scene.gltf": json.dumps(document).encode()}
    same = uri in ("in.bin", "./in.bin")  # all else lies outside or is no buffer
    assert outcome(READERS["gltf"].use, place.hold(case)) == ("read" if same else "refused")


def test_a_link_to_a_buffer_in_the_folder_is_followed(place: Place) -> None:
    (files,) = READERS["gltf"].sound
    case = files | {"in.bin": Link("far/real.bin"), "far/real.bin": files["in.bin"]}
    assert outcome(READERS["gltf"].use, place.hold(case)) == "read"


def test_links_out_of_a_dataset_are_not_followed(place: Place) -> None:
    reader = READERS["dataset"]
    files = reader.sound[0]
    name = next(name for name in files if name.endswith("visibility/c/0/0/0"))
    elsewhere = place.folder.parent / "chunk"
    elsewhere.write_bytes(bytes_of(files[name]))
    with pytest.raises(PrtnetError, match="is a link to something outside"):
        reader.use(place.hold(files | {name: Link(str(elsewhere))}))
    inside = "old.zarr/chunk"
    case = files | {inside: files[name], name: Link("../../../../chunk")}
    assert outcome(reader.use, place.hold(case)) == "read"


def test_a_group_whose_header_holds_others_of_its_arrays(place: Place) -> None:
    reader = READERS["dataset"]
    files = reader.sound[0]
    document = json.loads(bytes_of(files["old.zarr/zarr.json"]))
    other = json.loads(bytes_of(files["old.zarr/faces/zarr.json"])) | {"shape": [10**12, 3]}
    document["consolidated_metadata"] = {
        "kind": "inline", "must_understand": False, "metadata": {"faces": other},
    }  # fmt: skip
    case = files | {"old.zarr/zarr.json": json.dumps(document).encode()}
    assert outcome(reader.use, place.hold(case)) == "read"


def change(text: bytes, **values: object) -> bytes:
    return json.dumps(json.loads(text) | values).encode()


@pytest.mark.parametrize(
    ("array", "values", "told"),
    [
        ("faces", {"shape": [10**12, 3]}, "claims"),
        ("visibility", {"shape": [10**12, 6, 4]}, "claims"),
        ("time", {"shape": [9]}, "not whole"),
        ("normals", {"shape": [10, 0, 3], "chunk_grid": {"name": "regular", "configuration": {
            "chunk_shape": [10**30, 1, 3]}}}, "blocks of other sizes"),
        ("pose", {"data_type": "int32"}, "int32"),
        ("faces", {"codecs": [{"name": "bytes", "configuration": {"endian": "little"}},
                              {"name": "zstd", "configuration": {}}]}, "ZstdCodec"),
    ],
)  # fmt: skip
def test_arrays_of_a_dataset_that_do_not_fit(
    place: Place, array: str, values: dict[str, object], told: str
) -> None:
    files = READERS["dataset"].sound[0]  # without checksums of headers
    name = f"old.zarr/{array}/zarr.json"
    path = place.hold(signed(files | {name: change(bytes_of(files[name]), **values)}))
    with bounded(ROOM), pytest.raises(PrtnetError, match=told):
        READERS["dataset"].use(path)


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("order", 10**12, "order"),
        ("held_out", ["no such clip"], "held_out names"),
        ("clip_names", [1, 2, 3], "no list of names"),
        ("joint_names", ["\ud800", "b"], "surrogates"),
        ("scene_kind", "liquid", "scene_kind is neither"),
    ],
)
def test_attributes_of_a_dataset_that_are_none(
    place: Place, name: str, value: object, told: str
) -> None:
    files = READERS["dataset"].sound[0]
    document = json.loads(bytes_of(files["old.zarr/zarr.json"]))
    document["attributes"][name] = value
    case = files | {"old.zarr/zarr.json": json.dumps(document).encode()}
    with pytest.raises(PrtnetError, match=told):
        READERS["dataset"].use(place.hold(signed(case)))


def signed(files: Files) -> Files:
    """The files of a dataset without checksums of its headers."""
    return files | {"old.zarr/zarr.json": array_files.signed(files, "old.zarr/zarr.json", old=True)}


def test_pictures_are_not_given_to_other_programs(place: Place) -> None:
    (eps,) = (files for files in READERS["picture"].sound if "EPS.png" in files)
    with pytest.raises(PrtnetError, match="it is no picture"):  # rather than: no Ghostscript
        READERS["picture"].use(place.hold(eps))


def test_materials_of_a_mesh_are_not_looked_for(
    place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    (files,) = (files for files in READERS["mesh"].sound if "material.obj" in files)
    opened: list[str] = []
    monkeypatch.setattr(WATCH, "opened", opened)
    assert outcome(READERS["mesh"].use, place.hold(files)) == "read"
    assert [Path(name).name for name in opened if "case" in name] == ["material.obj"]


@pytest.mark.parametrize("name", ["glb", "hdr light", "model"])
def test_a_terabyte_is_not_read(place: Place, name: str) -> None:
    ((file, data),) = READERS[name].sound[0].items()
    path = place.hold({file: Holed(10**12, {0: bytes_of(data)})})
    with bounded(ROOM):
        assert outcome(READERS[name].use, path) == "refused"
