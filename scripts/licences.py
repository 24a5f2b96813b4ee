"""Write docs/licences.md: what everything that prtnet needs is licensed as (``make pins``).

Every licence is one that asks for no more than its notice, or has a note; so has every package
whose wheel brings a library with another one.
"""

from __future__ import annotations

import re
from importlib import metadata

from packaging.utils import canonicalize_name

from scripts.dependencies import PYTHONS, REPOSITORY, groups, needed

__all__ = ["PAGE", "licence", "page", "unexplained"]

PAGE = REPOSITORY / "docs" / "licences.md"
PERMISSIVE = {
    "0BSD", "Apache-2.0", "BSD-2-Clause", "BSD-3-Clause", "BSL-1.0", "CC0-1.0", "MIT", "MIT-CMU",
    "PSF-2.0", "Zlib", "LLVM-exception",
}  # fmt: skip
# What metadata without a licence expression say, in SPDX.
SPELLINGS = {
    "3-Clause BSD License": "BSD-3-Clause",
    "Apache 2.0": "Apache-2.0",
    "Apache Software License": "Apache-2.0",
    "Apache-2.0": "Apache-2.0",
    "BSD-2-Clause": "BSD-2-Clause",
    "BSD-3-Clause": "BSD-3-Clause",
    "MIT": "MIT",
    "MIT License": "MIT",
    "Mozilla Public License 2.0 (MPL 2.0)": "MPL-2.0",
    "Zlib": "Zlib",
}
# Metadata that say nothing, or only "BSD": read from the package's licence file.
READ = {
    "embreex": "BSD-2-Clause",
    "jinja2": "BSD-3-Clause",
    "mpmath": "BSD-3-Clause",
    "openexr": "BSD-3-Clause",
    "partd": "BSD-3-Clause",
    "pathlib-abc": "PSF-2.0",
    "pyglet": "BSD-3-Clause",
    "pyopengl": "BSD-3-Clause",
    "scipy": "BSD-3-Clause",
    "sympy": "BSD-3-Clause",
    "zict": "BSD-3-Clause",
}
RUNTIMES = "the wheel brings GCC's run-time libraries, whose exception asks nothing of their users"
NOTES = {
    "av": "the wheel brings FFmpeg with x264 and x265, which are GPL-2.0-or-later, and libraries "
    "under the LGPL: who passes the wheel on, passes these on. Only movies (MP4) use it: "
    "pictures, the window and everything else do without",
    "hypothesis": "for tests only; the MPL asks that changes to its own files are published",
    "numpy": RUNTIMES,
    "pathspec": "for checks and builds only; the MPL asks that changes to its files are published",
    "pyopengl": "says 'BSD License' and brings no text; imgui-bundle asks for it",
    "scikit-learn": RUNTIMES,
    "scipy": RUNTIMES,
    "torch": f"{RUNTIMES}; wheels with CUDA ask for NVIDIA's libraries, under NVIDIA's own licence",
}
# Libraries in wheels whose licence asks for more than a notice.
COPYLEFT = re.compile(
    r"(?:^|/)lib(?:x26[45]|xvid\w*|gfortran|gomp|quadmath|gmp|gnutls|nettle|hogweed|unistring"
    r"|mp3lame|fftw3\w*|gsl|readline)[-.]"
)
HEAD = f"""\
# Licences

prtnet itself is MIT: [LICENSE](../LICENSE). Below is what it needs, and what that needs in turn, \
on Python {PYTHONS[0]} to {PYTHONS[-1]} and Linux, with licences as \
[SPDX](https://spdx.org/licenses/) names them. *For*: prtnet itself, or the extra that asks for \
it; `dev` is for building and testing alone. `make pins` writes this page out of what is \
installed, and the tests fail where a licence is unknown, or asks for more than its notice and \
has no note.

"""


def licence(package: metadata.Distribution) -> str:
    """The licence of a package, as SPDX writes it.

    Raises:
        SystemExit: it says none that is known.
    """
    about = package.metadata
    if "License-Expression" in about:
        return about["License-Expression"]
    name = canonicalize_name(package.name)
    classifiers = about.get_all("Classifier") or []
    said = [
        *(about.get_all("License") or []),
        *(line.rpartition(" :: ")[2] for line in classifiers),
    ]
    known = (
        [READ[name]] if name in READ else [SPELLINGS[line] for line in said if line in SPELLINGS]
    )
    if not known:
        raise SystemExit(f"{name}: says no licence that is known; add it to scripts/licences.py")
    return " AND ".join(dict.fromkeys(known))


def unexplained(package: metadata.Distribution) -> list[str]:
    """What asks for more than its notice: licences and bundled libraries without a note."""
    if canonicalize_name(package.name) in NOTES:
        return []
    names = set(re.findall(r"[\w.+-]+", licence(package))) - {"AND", "OR", "WITH"}
    bundled = [path.name for path in package.files or () if COPYLEFT.search(path.as_posix())]
    return sorted(names - PERMISSIVE) + bundled


def page() -> str:
    """The text of docs/licences.md."""
    users: dict[str, list[str]] = {}
    for group, requirements in groups().items():
        for name in sorted({name for each in PYTHONS for name in needed(requirements, each)}):
            users.setdefault(name, []).append(group)
    rows, notes = [], []
    for name, who in sorted(users.items()):
        wanted_by = "prtnet" if "prtnet" in who else ", ".join(who)
        rows.append(f"| {name} | {licence(metadata.distribution(name))} | {wanted_by} |\n")
        notes += [f"- **{name}**: {NOTES[name]}.\n"] if name in NOTES else []
    table = "".join(["| package | licence | for |\n|---|---|---|\n", *rows])
    return f"{HEAD}{table}\n## Notes\n\n{''.join(notes)}"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
