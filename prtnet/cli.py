"""The command line: one function a command, thin over the packages it drives.

This module and the ``cli_…`` of its longer commands may import ``data_gen``, ``training`` and
``runtime``, inside the commands: ``prtnet --help`` answers at once.
"""

from __future__ import annotations

import dataclasses
import functools
import os
import shlex
import sys
import traceback
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import prtnet
from prtnet.errors import PrtnetError, nearest_name

if TYPE_CHECKING:
    from prtnet.console import Console

__all__ = ["COMMANDS", "main", "run"]


@dataclass(frozen=True)
class Command:
    """One command.

    Attributes:
        run: parses the arguments and does the work.
        summary: what it does, in a line.
        example: a line to copy.
    """

    run: Callable[[Sequence[str]], None]
    summary: str
    example: str


@dataclass(frozen=True)
class Session:
    """How one run of a command talks back."""

    console: Console
    json: Path | None

    def finish(self, results: Mapping[str, Any], shown: Mapping[str, Any] | None = None) -> None:
        """Show the results, as ``shown`` if given, and write them where ``--json`` says."""
        from prtnet.console import write_json

        self.console.facts(results if shown is None else shown)
        if self.json is not None:
            write_json(self.json, results)


def main() -> None:
    """Entry point: leaves with 0, 2 after an error, 130 after Ctrl-C."""
    if not sys.warnoptions and "--debug" not in sys.argv:
        warnings.simplefilter("ignore")  # libraries' deprecations are no news to the user
    sys.exit(run(sys.argv[1:]))


def run(argv: Sequence[str]) -> int:
    """Run one command line and return its exit status."""
    debug = "--debug" in argv
    try:
        dispatch(argv)
        sys.stdout.flush()
    except SystemExit as stop:
        return int(stop.code or 0)
    except KeyboardInterrupt:
        return fail("interrupted", 130, debug)
    except BrokenPipeError:  # whoever read our output has had enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except PrtnetError as error:
        return fail(f"{error.subject}: {error.message}", 2, debug)
    except OSError as error:
        what = error.strerror or str(error)
        return fail(f"{error.filename or 'system'}: {what}; check it and try again", 2, debug)
    except Exception as error:  # a bug; still one line
        what = " ".join(f"{type(error).__name__}: {error}".split())
        return fail(f"internal: {what}; please report it with the output of --debug", 2, debug)
    return 0


def fail(text: str, status: int, debug: bool) -> int:
    """Print the error, after its traceback if asked for, and return the exit status."""
    if debug:
        traceback.print_exc()
    sys.stderr.write(f"prtnet: error: {text}\n")
    return status


def dispatch(argv: Sequence[str]) -> None:
    """Hand the arguments to the command they begin with."""
    name = argv[0] if argv else ""
    if name in ("-h", "--help"):
        sys.stdout.write(overview())
    elif name == "--version":
        sys.stdout.write(f"prtnet {prtnet.__version__}\n")
    elif name in COMMANDS:
        COMMANDS[name].run(argv[1:])
    elif name:
        raise PrtnetError(name, f"is no command; {nearest_name(name, COMMANDS)}")
    else:
        raise PrtnetError("command", f"is missing; {nearest_name('', COMMANDS)}")


def overview() -> str:
    """What ``prtnet --help`` prints."""
    width = max(map(len, COMMANDS))
    lines = "\n".join(f"  {name:<{width}}  {each.summary}" for name, each in COMMANDS.items())
    return (
        "usage: prtnet COMMAND [OPTIONS]\n\n"
        "Learned soft self-shadows for animated characters and cloth.\n\n"
        f"commands:\n{lines}\n\n"
        "Every command knows --help, --quiet, --json FILE and --debug.\n\n"
        f"example:\n  {COMMANDS['info'].example}\n"
    )


def arguments(name: str, argv: Sequence[str], *parts: Any) -> tuple[Any, ...]:
    """The options of a command, as ``cli_arguments.parse`` gives them, and its session."""
    from prtnet.cli_arguments import check_report, parse
    from prtnet.cli_options import Common
    from prtnet.console import Console

    command = COMMANDS[name]
    *options, common = parse(name, argv, (*parts, Common), command.summary, command.example)
    check_report(common.json, *options)
    return (*options, Session(Console(common.quiet), common.json))


def info(argv: Sequence[str]) -> None:
    """Describe a scene, a dataset, a model or a field."""
    from prtnet.cli_arguments import input_file
    from prtnet.cli_options import InfoOptions

    options, session = arguments("info", argv, InfoOptions)
    path = input_file(options.file, folder=True)

    from prtnet.cli_info import described

    session.finish(described(path))


def generate(argv: Sequence[str]) -> None:
    """Ray-trace visibility over the poses of a scene."""
    from data_gen.generate import GenerateConfig
    from prtnet.cli_arguments import check_output, input_file
    from prtnet.cli_options import GenerateFiles

    files, config, session = arguments("generate", argv, GenerateFiles, GenerateConfig)
    check_output(files.out, input_file(files.scene), replaces="zarr.json")

    from data_gen.generate import generate as trace
    from data_gen.readers import read_scene, require_clips

    scene = read_scene(files.scene)
    require_clips(scene)
    with session.console.progress() as report:
        where = files.cluster, files.scene
        summary = trace(scene, config, files.out, report, files.repair, *where)
    session.finish(dataclasses.asdict(summary))


def train(argv: Sequence[str]) -> None:
    """Fit a model to a dataset."""
    from prtnet.cli_arguments import check_output, input_file, named_options, value_of
    from prtnet.cli_options import TrainOptions, fraction_of
    from prtnet.cli_train import check_cluster, check_lobe_options
    from training.budget import Budget
    from training.config import PRESETS

    preset = value_of("--preset", argv) or "default"
    if preset not in PRESETS:
        raise PrtnetError("--preset", f"'{preset}' is none; {nearest_name(preset, PRESETS)}")
    options, config, session = arguments("train", argv, TrainOptions, PRESETS[preset])
    budget = Budget(fraction_of("--max-error", options.max_error), options.max_ms, options.max_mb)
    check_lobe_options(config, named_options(argv))
    check_cluster(options.cluster, options.exchange, config, budget, session.console.message)
    check_output(options.out, input_file(options.dataset, folder=True))

    from prtnet.cli_train import fitting, summary
    from prtnet.console import StageMonitor, in_per_cent
    from prtnet.cores import use_threads
    from prtnet.dataset import Dataset
    from prtnet.exchange import elsewhere
    from training.train import PACKAGES

    count = threads(options.threads)
    use_threads(count)
    handed = options.cluster, options.out, PACKAGES, count
    place = options.exchange, options.dataset
    with session.console.progress() as report, elsewhere(*handed, report, *place):
        monitor = StageMonitor(report)
        dataset = Dataset.open(options.dataset)
        fit = fitting(dataset, config, budget, count)
        if options.log_dir is None:
            model = fit(monitor)
        else:
            from training.tensorboard import TensorBoard

            with TensorBoard(options.log_dir, monitor) as watched:
                model = fit(watched)
        model.save(options.out)
    results = {"out": options.out, "model_bytes": options.out.stat().st_size, **model.metadata}
    session.finish(results, in_per_cent(summary(results)))


def evaluate(argv: Sequence[str]) -> None:
    """Measure a model against ray-traced visibility."""
    from prtnet.cli_arguments import check_output, input_file
    from prtnet.cli_options import EvaluateOptions

    options, session = arguments("evaluate", argv, EvaluateOptions)
    inputs = input_file(options.model), input_file(options.data, folder=True)
    check_output(options.dump, *inputs)

    from prtnet.cli_evaluate import dataset_truth, scene_truth, summary
    from prtnet.evaluation import evaluate as measure
    from prtnet.model import VisibilityModel
    from prtnet.places import is_folder
    from runtime.onnx_model import OnnxModel
    from training.onnx_export import build_onnx

    model = VisibilityModel.load(options.model)
    predict = OnnxModel(build_onnx(model).SerializeToString(), options.threads)
    with session.console.progress() as report:
        if is_folder(options.data):
            truth = dataset_truth(options, model)
        else:
            dumped = functools.partial(report, "dumped poses")
            truth = scene_truth(options, model, predict, dumped, threads(options.threads))
        results = measure(model, predict, truth.counted(report), truth.nearest)
    results["ms_per_pose"] = predict.milliseconds(truth.pose)
    results["model_bytes"] = options.model.stat().st_size
    session.finish(results, summary(results))


def export(argv: Sequence[str]) -> None:
    """Write a model for a game engine."""
    from prtnet.cli_arguments import check_output, input_file
    from prtnet.cli_options import ExportOptions

    options, session = arguments("export", argv, ExportOptions)
    check_output(options.out, input_file(options.model), replaces="model.onnx")

    from prtnet.model import VisibilityModel
    from training.export import export_folder

    model = VisibilityModel.load(options.model)
    if options.storage is not None:
        model = model.stored_as(options.storage)
    session.finish(export_folder(model, options.out))


def by_kind(
    argv: Sequence[str],
    field: Callable[[Sequence[str]], None],
    all_frequency: Callable[[Sequence[str]], None],
) -> bool:
    """Hand the arguments to what their file is for; whether it is for one of these."""
    from prtnet.array_file import ALL_FREQUENCY, LOBES, TRANSFER, kind_named
    from prtnet.cli_arguments import input_file

    if argv and argv[0].endswith(".safetensors") and (len(argv) == 1 or argv[1].startswith("-")):
        input_file(Path(argv[0]))  # before a scene is asked for that it may have no need of
    run = {TRANSFER: field, LOBES: field, ALL_FREQUENCY: all_frequency}.get(kind_named(argv) or "")
    if run is not None:
        run(argv)
    return run is not None


def render(argv: Sequence[str]) -> None:
    """Draw pictures or a movie of a posed scene, or of a baked field, without a window."""
    if by_kind(argv, render_field, render_all_frequency):
        return
    from prtnet.cli_arguments import check_output, input_file, named_options
    from prtnet.cli_options import RenderOptions
    from prtnet.cli_render import check_options, make_picture

    options, session = arguments("render", argv, RenderOptions)
    check_options(options, named_options(argv))
    check_output(options.out, input_file(options.model), input_file(options.scene))

    session.finish(make_picture(options, threads(options.threads), session.console))


def render_field(argv: Sequence[str]) -> None:
    """Draw a field of transfer or lobes on a mesh."""
    from prtnet.cli_arguments import check_output, named_options
    from prtnet.cli_render_field import FieldOptions, make_field_picture

    options, session = arguments("render", argv, FieldOptions)
    check_output(options.out, *options.inputs())
    work = threads(options.threads), session.console
    session.finish(make_field_picture(options, named_options(argv), *work))


def render_all_frequency(argv: Sequence[str]) -> None:
    """Draw an object with all-frequency transfer."""
    from prtnet.cli_arguments import check_output, named_options
    from prtnet.cli_render_all_frequency import AllFrequencyOptions, make_all_frequency_pictures

    options, session = arguments("render", argv, AllFrequencyOptions)
    options.refuse_idle(named_options(argv))
    check_output(options.out, *options.inputs())
    work = threads(options.threads), session.console
    session.finish(make_all_frequency_pictures(options, *work))


def view(argv: Sequence[str]) -> None:
    """Play a model, or show a baked field, in a window."""
    if by_kind(argv, view_field, view_all_frequency):
        return
    from prtnet.cli_arguments import input_file
    from prtnet.cli_options import ViewOptions

    options, session = arguments("view", argv, ViewOptions)
    input_file(options.model)
    input_file(options.scene)

    from prtnet.cli_view import opened_viewer

    viewer = opened_viewer(options, threads(options.threads), session.console.message)
    played(viewer, session, "clip")


def view_field(argv: Sequence[str]) -> None:
    """Show a field of transfer or lobes on what moves, in a window."""
    from prtnet.cli_view_field import ViewFieldOptions, opened_field_viewer

    options, session = arguments("view", argv, ViewFieldOptions)
    work = threads(options.threads), session.console.message
    played(opened_field_viewer(options, *work), session, "clip")


def view_all_frequency(argv: Sequence[str]) -> None:
    """Show an object with all-frequency transfer, in a window."""
    from prtnet.cli_view_all_frequency import AllFrequencyViewOptions, opened_all_frequency_viewer

    options, session = arguments("view", argv, AllFrequencyViewOptions)
    work = threads(options.threads), session.console.message
    played(opened_all_frequency_viewer(options, *work), session, "light")


def played(viewer: Any, session: Session, told: str) -> None:
    """A viewer until it is closed, then what there is to tell: of its view, what a frame took."""
    from prtnet.cli_view import until_closed

    until_closed(viewer, fail)
    session.finish({told: getattr(viewer.view, told), "milliseconds": viewer.show.milliseconds})


def report(argv: Sequence[str]) -> None:
    """One page about a dataset: what models of it cost, and what they get wrong."""
    from prtnet.cli_arguments import check_output, input_file
    from prtnet.cli_options import ReportOptions

    options, session = arguments("report", argv, ReportOptions)
    check_output(options.out, input_file(options.dataset, folder=True))

    from prtnet.cli_report import in_figures, make_report
    from prtnet.console import in_per_cent

    with session.console.progress() as progress:
        results = make_report(options, threads(options.threads), progress, session.console.message)
    shown = {"out": options.out, "best": results["best"], "models": in_figures(results)}
    session.finish(results, in_per_cent(shown))


def bake(argv: Sequence[str]) -> None:
    """Simulate local transfer of a mesh, a height field or a parametric model."""
    from prtnet.cli_arguments import check_output, named_options
    from prtnet.cli_bake import PACKAGES, BakeOptions, baked, check_options, warnings_of
    from prtnet.exchange import elsewhere

    options, session = arguments("bake", argv, BakeOptions)
    check_options(options, named_options(argv))
    check_output(options.out, *options.inputs())
    count = threads(options.threads)
    handed, place = (options.cluster, options.out, PACKAGES, count), options.exchange
    with session.console.progress() as progress, elsewhere(*handed, progress, place):
        field = baked(options, count, progress)
        field.save(options.out)
    facts = field.facts()
    for warning in warnings_of(facts):
        session.console.message(warning)
    session.finish({"out": options.out, "bytes": options.out.stat().st_size, **facts})


def bake_all_frequency(argv: Sequence[str]) -> None:
    """Simulate and compress how a still object answers sharp light."""
    from prtnet.cli_arguments import check_output
    from prtnet.cli_bake_all_frequency import PACKAGES, AllFrequencyOptions, baked_fields, stages

    options, session = arguments("bake-all-frequency", argv, AllFrequencyOptions)
    check_output(options.out, *options.inputs())

    from prtnet.all_frequency_file import facts, save_fields
    from prtnet.exchange import elsewhere

    count = threads(options.threads)
    handed, place = (options.cluster, options.out, PACKAGES, count), options.exchange
    with session.console.progress() as report, elsewhere(*handed, report, place):
        fields = baked_fields(options, count, report)
        save_fields(options.out, fields)
    for field in fields:
        columns = (field.metadata["source"], "bytes", "of raw", "squared error")
        session.console.table(columns, stages(field))
    results = {"out": options.out, "bytes": options.out.stat().st_size, **facts(fields)}
    lists = ("sizes", "squared_error", "squared_error_of_segments", "dropped")
    shown = {k: v for k, v in results.items() if k not in lists and not k.startswith("beside")}
    session.finish(results, shown)


def demo(argv: Sequence[str]) -> None:
    """Everything, on the bundled character."""
    from prtnet.cli_arguments import output_folder
    from prtnet.cli_demo import demo_steps, edge
    from prtnet.cli_options import DemoOptions

    options, session = arguments("demo", argv, DemoOptions)
    output_folder(options.out)

    from data_gen.gltf_writer import write_glb
    from data_gen.procedural import HELD_OUT, mannequin

    write_glb(mannequin(edge(options.quick)), options.out / "mannequin.glb")
    for step in demo_steps(options.out, HELD_OUT, options.quick):
        session.console.message(f"\n$ prtnet {shlex.join(step)}")
        dispatch([*step, "--quiet"] if session.console.quiet else step)
    session.console.message("")
    onnx, picture = options.out / "export" / "model.onnx", options.out / "frame.png"
    session.finish({"onnx": onnx, "picture": picture, "errors": options.out / "errors.json"})


def threads(count: int | None) -> int:
    """As many as asked for, or one a core."""
    from prtnet.cores import core_count

    return count or core_count()


COMMANDS = {
    "info": Command(info, "Describe a scene, dataset, model or field.", "prtnet info robot.glb"),
    "generate": Command(
        generate,
        "Ray-trace visibility over the poses of a scene.",
        "prtnet generate robot.glb --out robot.zarr --holdout Walk,Jump@1:2.5",
    ),
    "train": Command(
        train,
        "Fit a model to a dataset.",
        "prtnet train robot.zarr --out robot.safetensors --preset small",
    ),
    "evaluate": Command(
        evaluate,
        "Measure a model's error and speed against ray-traced visibility.",
        "prtnet evaluate robot.safetensors robot.zarr --json errors.json",
    ),
    "export": Command(
        export,
        "Write a model for a game engine: ONNX and what goes with it.",
        "prtnet export robot.safetensors --out export",
    ),
    "render": Command(
        render,
        "Draw pictures or a movie of a posed scene, or a baked FIELD (render FIELD --help).",
        "prtnet render robot.safetensors robot.glb --clip Walk --out frame.png --compare truth",
    ),
    "view": Command(
        view,
        "Play a model in a window, the truth beside it, or show a FIELD (view FIELD --help).",
        "prtnet view robot.safetensors robot.glb --brdf gold",
    ),
    "report": Command(
        report,
        "Fit models of many sizes to a dataset and show on one page what they cost and miss.",
        "prtnet report robot.zarr --out report.html --quick",
    ),
    "bake": Command(
        bake,
        "Simulate how a mesh, or a relief on any mesh, answers light: shadows, bounces, scatter.",
        "prtnet bake waffle --out waffle.safetensors --subsurface marble --metres 0.03",
    ),
    "bake-all-frequency": Command(
        bake_all_frequency,
        "Simulate a still object for sharp, moving light: shadows with hard edges, glossy too.",
        "prtnet bake-all-frequency bunny.ply --out bunny.safetensors --brdf gold --ground",
    ),
    "demo": Command(demo, "Do all of it on a bundled character.", "prtnet demo --out demo"),
}
