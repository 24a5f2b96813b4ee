from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest
from tyro.conf import Positional

from prtnet import cli
from prtnet.cli import COMMANDS, Command
from prtnet.cli_arguments import (
    check_output,
    check_report,
    input_file,
    one_line,
    output_folder,
    parse,
    parse_size,
    split_names,
    value_of,
)
from prtnet.errors import PrtnetError


@dataclass(frozen=True)
class Options:
    """Options of a command that only tests know."""

    scene: Positional[Path]  # the scene
    clips: tuple[str, ...] = ()  # names
    size: tuple[int, int] = (64, 48)  # of the picture
    two_sided: bool = False  # both sides
    count: int = 3  # how many


def parsed(*argv: str) -> Options:
    (options,) = parse("try", argv, (Options,), "does nothing", "prtnet try a.glb")
    assert isinstance(options, Options)
    return options


def complaint(*argv: str) -> str:
    with pytest.raises(PrtnetError) as caught:
        parsed(*argv)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def install(monkeypatch: pytest.MonkeyPatch, error: BaseException | None) -> None:
    """Put a command ``try`` in the table that raises ``error``."""

    def work(argv: Sequence[str]) -> None:
        del argv
        if error:
            raise error

    monkeypatch.setitem(COMMANDS, "try", Command(work, "does nothing", "prtnet try"))


def one_error(capsys: pytest.CaptureFixture[str], *argv: str) -> str:
    """Run a command line that must fail with status 2 and one line on stderr."""
    assert cli.run(argv) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("prtnet: error: ")
    assert err.count("\n") == 1
    assert err.endswith("\n")
    return err.removeprefix("prtnet: error: ").rstrip()


def test_lists_and_sizes_have_their_spelling() -> None:
    options = parsed("a.glb", "--clips", "Walk, Run,", "--size", "640X480", "--two-sided")
    assert options == Options(Path("a.glb"), ("Walk", "Run"), (640, 480), True)


def test_defaults_stand() -> None:
    assert parsed("a.glb") == Options(Path("a.glb"))


def test_instance_gives_the_defaults() -> None:
    default = Options(Path("b.glb"), ("Run", "Walk"), (1, 2), True, 7)
    (same,) = parse("try", [], (default,), "", "")
    assert same == default
    (other,) = parse("try", ["--clips", "Jump"], (default,), "", "")
    assert other.clips == ("Jump",)
    assert other.count == 7


@pytest.mark.parametrize("text", ["640", "x480", "640x", "0x480", "-1x5", "axb", "1x2x3"])
def test_bad_size_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="write width x height"):
        parse_size(text)


def test_names_are_split_at_commas_only() -> None:
    assert split_names("Walk fast,Run") == ("Walk fast", "Run")
    assert split_names("") == ()


def test_parse_errors_are_one_line() -> None:
    assert "Missing" in complaint()
    assert "see prtnet try --help" in complaint()
    assert "--cuont" in complaint("a.glb", "--cuont", "4")
    assert "--count" in complaint("a.glb", "--cuont", "4")  # what was meant
    assert "'x'" in complaint("a.glb", "--count", "x")
    assert "640x480" in complaint("a.glb", "--size", "large")


def test_value_is_found_before_parsing() -> None:
    assert value_of("--preset", ["a", "--preset", "small"]) == "small"
    assert value_of("--preset", ["--preset=small", "a"]) == "small"
    assert value_of("--preset", ["--presets", "small"]) is None
    assert value_of("--preset", ["--preset"]) == ""


def test_box_is_flattened_without_its_help() -> None:
    box = (
        "╭─ Title ──╮\n│ a is     │\n│ wrong    │\n│ ──────── │\n│ For full helptext │\n╰───────╯\n"
    )
    assert one_line(box) == "a is wrong"


def test_input_must_be_there(tmp_path: Path) -> None:
    with pytest.raises(PrtnetError, match="does not exist"):
        input_file(tmp_path / "no.glb")
    with pytest.raises(PrtnetError, match="is a folder"):
        input_file(tmp_path)
    assert input_file(tmp_path, folder=True) == tmp_path


def test_output_is_checked_before_the_work(tmp_path: Path) -> None:
    file = tmp_path / "a.npz"
    file.write_text("x")
    check_output(None)
    check_output(tmp_path / "new")
    check_output(file)
    with pytest.raises(PrtnetError, match="also an input"):
        check_output(tmp_path / "." / "a.npz", file)
    with pytest.raises(PrtnetError, match="is a folder"):
        check_output(tmp_path)
    with pytest.raises(PrtnetError, match="there is no folder"):
        check_output(tmp_path / "no" / "a")


def test_only_regular_files_are_replaced(tmp_path: Path) -> None:
    """A pipe stands for /dev/null, which a superuser would really replace were this to fail."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(PrtnetError, match="is no regular file"):
        check_output(pipe)
    with pytest.raises(PrtnetError, match="is a file where a folder"):
        check_output(pipe, replaces="model.onnx")


def test_report_has_a_file_of_its_own(tmp_path: Path) -> None:
    scene, dataset = tmp_path / "a.glb", tmp_path / "a.zarr"
    scene.write_text("x")
    dataset.mkdir()
    (dataset / "zarr.json").write_text("{}")
    check_report(None, Options(scene))
    check_report(tmp_path / "a.json", Options(scene))
    with pytest.raises(PrtnetError, match="named twice"):
        check_report(tmp_path / "." / "a.glb", Options(scene))
    with pytest.raises(PrtnetError, match="in one"):
        check_report(dataset / "zarr.json", Options(dataset))


def test_only_folders_of_our_own_are_replaced(tmp_path: Path) -> None:
    folder = tmp_path / "export"
    check_output(folder, replaces="model.onnx")
    folder.mkdir()
    check_output(folder, replaces="model.onnx")
    (folder / "thesis.tex").write_text("x")
    with pytest.raises(PrtnetError, match="not replaced"):
        check_output(folder, replaces="model.onnx")
    (folder / "model.onnx").write_text("x")
    check_output(folder, replaces="model.onnx")
    with pytest.raises(PrtnetError, match="is a file"):
        check_output(folder / "thesis.tex", replaces="model.onnx")


def test_output_folder_is_made_or_taken(tmp_path: Path) -> None:
    folder = tmp_path / "demo"
    output_folder(folder)
    (folder / "a").write_text("x")
    output_folder(folder)
    assert (folder / "a").exists()
    with pytest.raises(PrtnetError, match="is a file"):
        output_folder(folder / "a")


def test_output_without_permission_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def read_only(path: Path, mode: int) -> bool:
        return not (mode & os.W_OK and Path(path) == tmp_path)

    monkeypatch.setattr("os.access", read_only)  # root may write anywhere: nothing else would tell
    with pytest.raises(PrtnetError, match="permission denied"):
        check_output(tmp_path / "a")
    with pytest.raises(PrtnetError, match="permission denied"):
        output_folder(tmp_path)


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (PrtnetError("a.glb", "is damaged; export it again"), "a.glb: is damaged; export it again"),
        (FileNotFoundError(2, "No such file", "b.npz"), "b.npz: No such file; check it"),
        (OSError(28, "No space left on device"), "system: No space left on device; check it"),
        (ValueError("two\nlines"), "internal: ValueError: two lines; please report it"),
    ],
)
def test_every_failure_is_one_line(
    error: Exception,
    line: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    install(monkeypatch, error)
    assert one_error(capsys, "try").startswith(line)


def test_debug_shows_the_traceback(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    install(monkeypatch, PrtnetError("a.glb", "is damaged"))
    assert cli.run(["try", "--debug"]) == 2
    err = capsys.readouterr().err
    assert err.startswith("Traceback")
    assert err.splitlines()[-1] == "prtnet: error: a.glb: is damaged"


def test_interrupt_is_130(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    install(monkeypatch, KeyboardInterrupt())
    assert cli.run(["try"]) == 130
    assert capsys.readouterr().err == "prtnet: error: interrupted\n"


def test_success_is_zero(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, None)
    assert cli.run(["try"]) == 0


def test_unknown_command_suggests_a_known_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert "did you mean 'info'" in one_error(capsys, "inof")
    assert "info" in one_error(capsys)


def test_overview_lists_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["--help"]) == 0
    out = capsys.readouterr().out
    assert [name for name in COMMANDS if f"\n  {name} " not in out] == []
    assert "example:" in out


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["--version"]) == 0
    assert capsys.readouterr().out.startswith("prtnet ")


@pytest.mark.parametrize("name", COMMANDS)
def test_help_ends_with_an_example(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run([name, "--help"]) == 0
    out = capsys.readouterr().out
    assert out.splitlines()[-2:] == ["example:", f"  {COMMANDS[name].example}"]
    for option in ("--quiet", "--json", "--debug"):
        assert option in out
    assert "_" not in "".join(word for word in out.split() if word.startswith("--"))


@pytest.mark.parametrize("name", COMMANDS)
def test_example_parses(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every option of every example exists: parsing succeeds, then a file turns out missing."""
    monkeypatch.setattr("prtnet.cli_arguments.parse", stop_after(parse))
    words = COMMANDS[name].example.split()
    assert words[:2] == ["prtnet", name]
    with pytest.raises(Parsed):
        COMMANDS[name].run(words[2:])


class Parsed(Exception):  # noqa: N818 - not an error: it says how far we got
    pass


def stop_after(function):  # type: ignore[no-untyped-def]
    def stopped(*arguments: object) -> None:
        function(*arguments)
        raise Parsed

    return stopped


def test_help_needs_no_heavy_library() -> None:
    code = (
        "import sys; from prtnet.cli import run; run(['--help']);"
        "heavy = {'torch', 'numpy', 'scipy', 'zarr', 'moderngl', 'onnxruntime', 'data_gen',"
        " 'training', 'runtime'};"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.DEVNULL)


def test_process_exits_with_the_status(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "prtnet", "info", str(tmp_path / "no.glb")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr == f"prtnet: error: {tmp_path / 'no.glb'}: does not exist; check the name\n"


def test_closed_pipe_is_no_error() -> None:
    command = f"{sys.executable} -m prtnet --help | true"
    done = subprocess.run(command, shell=True, capture_output=True, text=True, check=False)
    assert done.stderr == ""


def test_info_of_a_sample_scene(
    shared_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report = tmp_path / "info.json"
    assert cli.run(["info", str(shared_data / "robot.glb"), "--json", str(report)]) == 0
    assert "Robot_Yes" in capsys.readouterr().out
    assert json.loads(report.read_text())


@pytest.mark.parametrize("command", ["render", "view"])
def test_a_file_that_is_not_there_is_told_before_what_it_would_need(
    command: str, tmp_path: Path
) -> None:
    """A field needs no scene: whether one is missing cannot be known yet."""
    with pytest.raises(PrtnetError, match=r"none\.safetensors: does not exist"):
        COMMANDS[command].run([str(tmp_path / "none.safetensors")])
