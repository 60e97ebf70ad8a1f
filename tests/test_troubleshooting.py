"""The symptoms that the troubleshooting page quotes are what the program says."""

from __future__ import annotations

import re
from pathlib import Path

import skewmi

ROOT = Path(skewmi.__file__).parents[1]


def said() -> str:
    """All string literals of the package, joined over the lines that they are broken at."""
    source = "\n".join(path.read_text() for path in sorted((ROOT / "skewmi").rglob("*.py")))
    joined = re.sub(r'"\s*\n\s*f?"', "", source)
    return re.sub(r"\{[^{}]*(\{[^{}]*\}[^{}]*)*\}", "{}", joined)


def test_quoted_messages_exist() -> None:
    page = (ROOT / "docs" / "troubleshooting.md").read_text()
    rows = [line.split("|")[1] for line in page.splitlines() if line.startswith("|")]
    quoted = [quote for row in rows for quote in re.findall(r"`([^`]+)`", row)]
    messages = [q for q in quoted if " " in q and not q.startswith(("apt", "skewmi", "--"))]
    assert len(messages) >= 12
    source = said()
    for message in messages:
        for part in re.split(r"\.\.\.|\(\.\.\.\)", message):
            wanted = part.strip(" ();,")
            assert not wanted or wanted in source, f"nothing says {wanted!r} of {message!r}"
