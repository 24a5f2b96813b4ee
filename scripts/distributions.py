"""Build wheel and sdist into dist/ and try them where nothing else is (``make dist``).

The wheel holds the four packages and no more, has the same bytes built from the sdist as from the
tree, and ``prtnet demo --quick`` runs from each in an empty environment.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from pathlib import Path, PurePosixPath

from scripts.dependencies import REPOSITORY

__all__ = ["PACKAGES", "contents", "main", "strangers"]

DIST = REPOSITORY / "dist"
PACKAGES = ("prtnet", "data_gen", "training", "runtime")
# What an sdist has beside them: folders, and files at its top.
BESIDE = ("bench", "docs", "scripts", "tests")
TOP = (
    ".gitignore", "CHANGELOG.md", "LICENSE", "Makefile", "PKG-INFO", "README.md", "constraints.txt",
    "pyproject.toml",
)  # fmt: skip
SUFFIXES = (".md", ".png", ".py", ".sh", ".svg", ".typed")
MADE = ("export/model.onnx", "frame.png", "errors.json")  # by the demonstration


def contents(archive: Path) -> dict[str, bytes]:
    """Every file of a wheel, or of an sdist without the name of the folder that it unpacks to."""
    if archive.suffix == ".whl":
        with zipfile.ZipFile(archive) as wheel:
            return {name: wheel.read(name) for name in wheel.namelist()}
    with tarfile.open(archive) as sdist:
        files = {each.name: sdist.extractfile(each) for each in sdist.getmembers()}
        return {name.partition("/")[2]: file.read() for name, file in files.items() if file}


def strangers(files: dict[str, bytes], folders: tuple[str, ...], places: list[Path]) -> list[str]:
    """Files of a distribution that belong in none of its folders, or that name a place here."""
    found = []
    for name, data in files.items():
        path = PurePosixPath(name)
        known = name in TOP or (path.parts[0] in folders and path.suffix in SUFFIXES)
        if not known or any(f"{place}/".encode() in data for place in places):
            found.append(name)
    return found


def check_contents(wheel: Path, sdist: Path) -> None:
    """Stop where a distribution lacks a module, or has what does not belong in it."""
    here = REPOSITORY, Path.home(), Path(sys.prefix)
    places = [place for place in here if place != Path(place.anchor)]
    packed = contents(wheel)
    modules = {name for name in packed if ".dist-info/" not in name}
    known = {
        path.relative_to(REPOSITORY).as_posix()
        for package in PACKAGES
        for path in (REPOSITORY / package).rglob("*")
        if path.suffix in (".py", ".typed")
    }
    about = {name: data for name, data in packed.items() if name not in modules}
    code = {name: packed[name] for name in modules}
    wrong = [*sorted(modules ^ known), *strangers(code, PACKAGES, places)]
    wrong += strangers(contents(sdist), (*PACKAGES, *BESIDE), places)
    if wrong or not any(name.endswith("/licenses/LICENSE") for name in about):
        raise SystemExit(f"dist: lacks a licence, or lacks or should not have {', '.join(wrong)}")


def build(folder: Path, *options: str) -> None:
    """Build an sdist and a wheel from it, or what the options say, with what is installed."""
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(folder), *options]
    done = subprocess.run([*command, str(REPOSITORY)], capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"build: failed\n{done.stdout}{done.stderr}")


def try_out(archive: Path, folder: Path) -> None:
    """Install it into a new environment in a folder and run the demonstration there."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    scripts = folder / "venv" / "bin"

    def run(*command: str | Path) -> None:
        if subprocess.run(command, cwd=folder, env=environment, check=False).returncode:
            raise SystemExit(f"dist: {archive.name} failed at {' '.join(map(str, command))}")

    run(sys.executable, "-m", "venv", scripts.parent)
    pip = scripts / "python", "-m", "pip", "--disable-pip-version-check", "--no-input"
    install = *pip, "install", "-qq", "--no-compile", "-c", REPOSITORY / "constraints.txt"
    if archive.suffix == ".whl":
        run(*install, archive)
    else:  # what builds it is pinned as well
        run(*install, "hatchling")
        run(*install, "--no-build-isolation", archive)
    run(*pip, "check")
    run(scripts / "prtnet", "demo", "--quick", "--out", "demo")
    if lost := [name for name in MADE if not (folder / "demo" / name).is_file()]:
        raise SystemExit(f"dist: the demo of {archive.name} made no {', '.join(lost)}")


def main() -> None:
    """Build, check and try."""
    shutil.rmtree(DIST, ignore_errors=True)
    build(DIST)
    (wheel,), (sdist,) = DIST.glob("*.whl"), DIST.glob("*.tar.gz")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        build(folder, "--sdist", "--wheel")  # both from the tree
        for archive in (wheel, sdist):
            if archive.read_bytes() != (folder / archive.name).read_bytes():
                raise SystemExit(f"{archive.name}: has other bytes when it is built again")
        check_contents(wheel, sdist)
        for archive in (wheel, sdist):
            (folder / "new").mkdir()
            try_out(archive, folder / "new")
            shutil.rmtree(folder / "new")  # one of them takes a gigabyte


if __name__ == "__main__":
    main()
