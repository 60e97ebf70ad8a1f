"""Makes the site of pages that were written for the repository: a hook of MkDocs (mkdocs.yml).

A page of docs/ may link to any file of the repository, as readers of the source expect. The site
has pages for some of them (`PAGES`); the others that are linked to, such as results and source
files, are copied beside the pages. A link to a file that does not exist stays, and fails the build.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
PAGES = {
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    "SECURITY.md": "reporting.md",
    "examples/README.md": "examples.md",
}
"""Files outside docs/ that are pages: where they are, what the site calls them."""

COPIES = "files"
"""Folder of the site with the other files that pages link to."""

LINK = re.compile(r"(?<=\]\()(?!\w+:|#)(?P<path>[^)\s#]+)(?P<anchor>#[^)\s]*)?(?=\))")
"""The target of a Markdown link that is relative."""


def place(path: str) -> str:
    """What the site calls a file of the repository; both relative, with slashes."""
    return PAGES.get(path) or (path[5:] if path.startswith("docs/") else f"{COPIES}/{path}")


def relinked(text: str, source: str) -> str:
    """A page's text with its links as they are on the site.

    Args:
        text: Markdown.
        source: Where the page is in the repository, as docs/wire.md.
    """
    folder = posixpath.dirname(place(source))

    def moved(match: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(posixpath.dirname(source), match["path"]))
        return posixpath.relpath(place(target), folder or ".") + (match["anchor"] or "")

    return LINK.sub(moved, text)


def linked_files(text: str, source: str) -> set[str]:
    """Files that a page links to, relative to the repository."""
    folder = posixpath.dirname(source)
    return {posixpath.normpath(posixpath.join(folder, m["path"])) for m in LINK.finditer(text)}


def on_files(files: Files, config: Any) -> Files:
    """Add the pages and copies that are not in docs/."""
    texts = {f"docs/{file.src_uri}": file.content_string for file in files.documentation_pages()}
    for source, page in PAGES.items():
        texts[source] = (ROOT / source).read_text(encoding="utf-8")
        files.append(File.generated(config, page, content=texts[source]))
    for path in sorted(set().union(*(linked_files(texts[source], source) for source in texts))):
        if (ROOT / path).is_file() and path not in PAGES and not path.startswith("docs/"):
            copied = File.generated(config, place(path), abs_src_path=str(ROOT / path))
            files.append(copied)
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Let a page's links lead to where things are on the site."""
    uri = page.file.src_uri
    source = next((path for path, name in PAGES.items() if name == uri), f"docs/{uri}")
    return relinked(markdown, source)
