"""Ask pip-audit for known vulnerabilities of everything pinned (``make audit``).

Exit status: 0 where all was checked and none is known, 1 where some are, 3 where what is left to
check could not be, as without a network. Not part of the tests, which ask no network anything.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

from scripts.pins import CONSTRAINTS

__all__ = ["UNCHECKED", "main", "verdict"]

UNCHECKED = 3


def verdict(report: str) -> tuple[int, str]:
    """Exit status and what to say of pip-audit's JSON, or of whatever else it left."""
    try:
        packages = json.loads(report)["dependencies"]
    except (ValueError, KeyError, TypeError):
        packages = []
    known = [
        f"{each['name']} {each['version']}: {flaw['id']}, mended in "
        f"{', '.join(flaw['fix_versions']) or 'no version yet'}"
        for each in packages
        for flaw in each.get("vulns", ())
    ]
    skipped = [each["name"] for each in packages if "skip_reason" in each]
    if known:
        return 1, "\n".join(known)
    if len(skipped) == len(packages):
        return UNCHECKED, "no list of vulnerabilities can be reached from here; nothing was checked"
    if skipped:
        return UNCHECKED, f"none known, but these could not be checked: {', '.join(skipped)}"
    return 0, f"no known vulnerability in {len(packages)} packages"


def main() -> int:
    """Run pip-audit in an environment of its own, so that it is no dependency."""
    with tempfile.TemporaryDirectory() as name:
        python = Path(name) / "bin" / "python"
        venv.create(name, with_pip=True)
        pip = "-m", "pip", "--disable-pip-version-check", "install", "-qq", "pip-audit"
        audit = "-m", "pip_audit", "--no-deps", "--disable-pip", "-f", "json", "-r", CONSTRAINTS
        subprocess.run([python, *pip], check=False, stderr=subprocess.DEVNULL)
        done = subprocess.run([python, *audit], capture_output=True, text=True, check=False)
    status, said = verdict(done.stdout)
    own = done.stderr.strip().splitlines()
    why = f" ({own[-1]})" if status == UNCHECKED and own else ""
    sys.stdout.write(f"audit: {said}{why}\n")
    return status


if __name__ == "__main__":
    sys.exit(main())
