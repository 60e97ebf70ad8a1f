"""Write constraints/deploy.txt: exact versions of everything that the deployment side installs.

    python constraints/lock.py          # or: make constraints

pip decides what `pip install '.[security]'` would install into an empty environment, and installs
nothing. Run it on the platform that the file is for; its first line says which that was.
"""

from __future__ import annotations

import json
import platform
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FILE = ROOT / "constraints" / "deploy.txt"
EXTRA = "security"


def main() -> None:
    """Ask pip, and write the file."""
    options = ["--dry-run", "--ignore-installed", "--quiet", "--report", "-"]
    done = subprocess.run(
        [sys.executable, "-m", "pip", "install", *options, f"{ROOT}[{EXTRA}]"],
        check=True,
        capture_output=True,
        text=True,
    )
    found = [each["metadata"] for each in json.loads(done.stdout)["install"]]
    lines = [f"{each['name'].lower()}=={each['version']}" for each in found]
    python = ".".join(platform.python_version_tuple()[:2])
    head = (
        f"# What pip install '.[{EXTRA}]' brings with Python {python} on {platform.system()} "
        f"{platform.machine()}:\n# pip install -c constraints/deploy.txt '.[{EXTRA}]'; made by "
        "constraints/lock.py\n"
    )
    rest = sorted(line for line in lines if not line.startswith("skewmi=="))
    FILE.write_text(head + "\n".join(rest) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
