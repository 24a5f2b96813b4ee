"""The rules of the house, read from the source itself."""

from __future__ import annotations

import ast
import importlib
import re
import tomllib
from pathlib import Path

import pytest

import prtnet
from prtnet import dataset, model
from prtnet.cli import COMMANDS

REPOSITORY = Path(__file__).resolve().parent.parent
PACKAGES = ("prtnet", "data_gen", "training", "runtime")
MODULES = sorted(path for package in PACKAGES for path in (REPOSITORY / package).rglob("*.py"))
TESTS = sorted((REPOSITORY / "tests").rglob("*.py"))
DOCUMENTS = [
    *(REPOSITORY / name for name in ("README.md", "CHANGELOG.md")),
    *sorted((REPOSITORY / "docs").glob("*.md")),
]
LONGEST = 500

# What each package may import of this repository.
ALLOWED = {
    "prtnet": {"prtnet"},
    "data_gen": {"prtnet", "data_gen"},
    "training": {"prtnet", "training"},
    "runtime": {"prtnet", "runtime"},
}
# Commands drive all packages; a report, which trains and draws, is long enough for its own module.
COMMANDS_OF = (
    "", "_bake", "_bake_all_frequency", "_bake_segments", "_demo", "_evaluate", "_field_truth",
    "_info", "_render", "_render_all_frequency", "_render_field", "_report", "_train", "_view",
    "_view_all_frequency", "_view_field",
)  # fmt: skip
COMMAND_LINE = tuple(f"prtnet/cli{name}.py" for name in COMMANDS_OF)
FORBIDDEN_MODULES = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "marshal", "shelve"}
FORBIDDEN_CALLS = {"eval", "exec", "torch.load", "pandas.read_pickle", "yaml.load"}


def name_of(path: Path) -> str:
    return path.relative_to(REPOSITORY).as_posix()


def imported(tree: ast.AST) -> set[str]:
    """Dotted names of every module imported anywhere in the file, also inside functions."""
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute here"
            names.add(str(node.module))
    return names


def import_breaches(package: str, tree: ast.AST) -> set[str]:
    """Imports of this repository that the package may not have."""
    roots = {name.partition(".")[0] for name in imported(tree)}
    return roots & ({*PACKAGES, "tests", "bench"} - ALLOWED[package])


def dangerous(tree: ast.AST) -> list[str]:
    """Ways to run code that comes out of a file."""
    found = [name for name in imported(tree) if name.partition(".")[0] in FORBIDDEN_MODULES]
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        called = ast.unparse(node.func)
        if called in FORBIDDEN_CALLS:
            found.append(called)
        for keyword in node.keywords:
            if keyword.arg == "allow_pickle" and ast.unparse(keyword.value) != "False":
                found.append(f"{called}(allow_pickle={ast.unparse(keyword.value)})")
    return found


def parse(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), filename=str(path))


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_imports_keep_to_their_room(path: Path) -> None:
    if name_of(path) in COMMAND_LINE:
        return  # the exception: commands drive all packages
    package = path.relative_to(REPOSITORY).parts[0]
    assert import_breaches(package, parse(path)) == set()


def test_import_rule_can_fail() -> None:
    assert import_breaches("prtnet", ast.parse("import data_gen.readers")) == {"data_gen"}
    inside = ast.parse("def f():\n    from runtime.gl import x")
    assert import_breaches("training", inside) == {"runtime"}
    assert import_breaches("runtime", ast.parse("from tests import a")) == {"tests"}


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_command_line_imports_the_packages_lazily(path: Path) -> None:
    """Nothing but the entry point may pull in the command line."""
    if path.name not in ("cli.py", "__main__.py"):
        assert "prtnet.cli" not in imported(parse(path))


@pytest.mark.parametrize("name", COMMAND_LINE)
def test_cli_imports_only_the_ground_floor_at_the_top(name: str) -> None:
    top = parse(REPOSITORY / name)
    top.body = [node for node in top.body if isinstance(node, ast.Import | ast.ImportFrom)]
    assert {name.partition(".")[0] for name in imported(top)} & set(PACKAGES) <= {"prtnet"}


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_module_has_one_idea_that_fits_in_a_module(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= LONGEST
    assert ast.get_docstring(parse(path)), "a module says what it is for"


@pytest.mark.parametrize("path", [*MODULES, *TESTS], ids=name_of)
def test_nothing_from_a_file_is_executed(path: Path) -> None:
    assert dangerous(parse(path)) == []


def test_danger_is_seen() -> None:
    for code in (
        "import pickle",
        "from joblib import load",
        "eval('1')",
        "torch.load('x')",
        "np.load('x', allow_pickle=True)",
        "np.load('x', allow_pickle=flag)",
    ):
        assert dangerous(ast.parse(code)), code
    assert dangerous(ast.parse("np.load('x', allow_pickle=False)\nmodel.eval()")) == []


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_every_np_load_refuses_pickles(path: Path) -> None:
    for node in ast.walk(parse(path)):
        if isinstance(node, ast.Call) and ast.unparse(node.func) in ("np.load", "numpy.load"):
            assert "allow_pickle" in {keyword.arg for keyword in node.keywords}


@pytest.mark.parametrize(
    "path", [path for path in MODULES if path.stem not in ("__init__", "__main__")], ids=name_of
)
def test_all_is_declared_sorted_and_true(path: Path) -> None:
    module = importlib.import_module(name_of(path).removesuffix(".py").replace("/", "."))
    names = module.__all__
    assert names == sorted(names, key=lambda n: (not n.isupper(), not n[0].isupper(), n)), names
    assert [name for name in names if not hasattr(module, name)] == []
    # A package offers what is its own, not what it imported from another.
    homes = {str(getattr(getattr(module, name), "__module__", "")).partition(".")[0]
             for name in names}  # fmt: skip
    assert homes & set(PACKAGES) <= {module.__name__.partition(".")[0]}


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_no_unfinished_work(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert re.findall(r"\b(?:TODO|FIXME|XXX|HACK|NotImplementedError)\b", text) == []


def test_versions_agree() -> None:
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["version"] == prtnet.__version__
    assert f"## {prtnet.__version__}" in (REPOSITORY / "CHANGELOG.md").read_text(encoding="utf-8")


def test_readme_names_every_command() -> None:
    text = (REPOSITORY / "README.md").read_text(encoding="utf-8")
    assert [name for name in COMMANDS if f"prtnet {name}" not in text] == []


def test_documents_name_no_command_that_does_not_exist() -> None:
    for document in DOCUMENTS:
        text = document.read_text(encoding="utf-8")
        named = set(re.findall(r"(?:^ {4}|`)prtnet ([a-z]+)", text, re.MULTILINE))
        assert named <= set(COMMANDS), document.name


@pytest.mark.parametrize("document", DOCUMENTS, ids=name_of)
def test_links_lead_somewhere(document: Path) -> None:
    text = document.read_text(encoding="utf-8")
    links = re.findall(r"\]\(([^)#\s]+)[^)]*\)|<img[^>]*src=\"([^\"]+)\"", text)
    for link in (first or second for first, second in links):
        if not link.startswith(("http://", "https://")):
            assert (document.parent / link).exists(), link


def test_formats_name_everything_in_a_dataset_and_a_model() -> None:
    text = (REPOSITORY / "docs" / "formats.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`([a-z_0-9]+)`", text))
    arrays = (*dataset.POSE_ARRAYS, *dataset.FIXED_ARRAYS, *dataset.SKIN_ARRAYS,
              *model.ARRAYS, *model.RANGE_ARRAYS)  # fmt: skip
    assert {*arrays, *dataset.ATTRIBUTES, "format_version"} - named == set()


@pytest.mark.parametrize(
    "path", sorted((REPOSITORY / "tests" / "hard_cases").glob("test_*.py")), ids=name_of
)
def test_page_of_hard_cases_names_every_one(path: Path) -> None:
    """Otherwise it is older than the tests: run ``make hard``."""
    page = (REPOSITORY / "docs" / "hard-cases.md").read_text(encoding="utf-8")
    names = [node.name.removeprefix("test_").replace("_", " ") for node in ast.walk(parse(path))
             if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")]  # fmt: skip
    assert [name for name in names if f"\n| {name} |" not in page] == []


def test_repository_holds_no_large_or_foreign_files() -> None:
    """Sample scenes and their licences stay out of the repository."""
    foreign = {".glb", ".gltf", ".hdr", ".exr", ".ply", ".npz", ".safetensors", ".onnx", ".pkl"}
    for package in (*PACKAGES, "tests", "docs", "bench"):
        for path in (REPOSITORY / package).rglob("*"):
            if path.is_file() and "__pycache__" not in path.parts and "out" not in path.parts:
                assert path.suffix not in foreign, path
                assert path.stat().st_size < 2**20, path
