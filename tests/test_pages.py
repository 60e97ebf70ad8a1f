"""The pages: every one is in the site's menu, and the site builds without a broken link."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
HOOK = DOCS / "site_pages.py"
LISTED = re.compile(r'^    "(?P<source>[^"]+)": "(?P<page>[^"]+)",$', re.MULTILINE)
"""An entry of the hook's PAGES, read as text: importing it needs MkDocs."""


def entries(nav: Any) -> Iterator[str]:
    """Files that a menu leads to."""
    if isinstance(nav, str):
        yield nav
    else:
        for each in nav.values() if isinstance(nav, dict) else nav:
            yield from entries(each)


def menu() -> list[str]:
    # The round-trip loader keeps tags that are Python's own instead of refusing them.
    return list(entries(YAML(typ="rt").load(ROOT / "mkdocs.yml")["nav"]))


def test_every_page_is_in_the_menu_once_and_every_entry_is_a_page() -> None:
    outside = {m["page"]: m["source"] for m in LISTED.finditer(HOOK.read_text(encoding="utf-8"))}
    assert len(outside) >= 5
    for source in outside.values():
        assert (ROOT / source).is_file()
    written = {path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md")}
    assert not written & outside.keys()
    assert Counter(menu()) == Counter([*written, *outside])


def test_every_file_that_a_page_links_to_exists() -> None:
    """As in the repository: the build looks at the site."""
    pages = [ROOT / "README.md", ROOT / "examples" / "README.md", *DOCS.rglob("*.md")]
    for page in pages:
        text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
        for target in re.findall(r"\]\((?!\w+:|#)([^)\s#]+)", text):
            assert (page.parent / target).exists(), f"{page} links to {target}"


def test_every_module_of_the_reference_exists() -> None:
    named = [
        name
        for page in (DOCS / "reference").glob("*.md")
        for name in re.findall(r"^::: (\S+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    ]
    assert len(named) > 20
    assert len(set(named)) == len(named)
    for name in named:
        place = ROOT.joinpath(*name.split("."))
        assert place.with_suffix(".py").exists() or (place / "__init__.py").exists(), name


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built strictly: every warning is an error."""
    for module in ("mkdocs", "material", "mkdocstrings_handlers"):
        pytest.importorskip(module, reason="it is in the docs extra")
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    assert "excluded from the built site" not in done.stderr
    return folder


@pytest.mark.slow
def test_the_site_builds_and_loads_nothing_from_elsewhere(site: Path) -> None:
    pages = list(site.rglob("*.html"))
    assert len(pages) > len(menu())
    loaded = re.compile(r"<(?:script|img|link|iframe)\b[^>]*\b(?:src|href)=\"?(?:https?:)?//[^>]*>")
    for page in pages:
        text = page.read_text(encoding="utf-8")
        strangers = [tag for tag in loaded.findall(text) if 'rel="canonical"' not in tag]
        assert not strangers, f"{page.name}: {strangers[:3]}"
    assert "OnnxPolicy" in (site / "reference" / "policies.html").read_text(encoding="utf-8")
    assert (site / "files" / "results" / "point_maze.png").is_file()


@pytest.mark.slow
def test_pages_have_the_same_parts_on_the_site_as_in_the_repository(site: Path) -> None:
    """MkDocs reads Markdown otherwise than who shows the repository: lists need empty lines."""
    from markdown import markdown
    from markdown_it import MarkdownIt

    def parts(html: str) -> Counter[str]:
        return Counter(re.findall(r"<(ul|ol|li|pre|table|tr|h[1-6]|img|a|blockquote)[ >]", html))

    del site  # it has been built, so that what is imported here is there
    for page in [ROOT / "README.md", ROOT / "examples" / "README.md", *DOCS.glob("*.md")]:
        text = page.read_text(encoding="utf-8")
        common = MarkdownIt("commonmark").enable("table").render(text)
        ours = markdown(text, extensions=["tables", "toc", "pymdownx.superfences"])
        assert parts(ours) == parts(common), page


@pytest.mark.skipif(importlib.util.find_spec("mkdocs") is None, reason="it is in the docs extra")
def test_links_are_moved_to_where_files_are_on_the_site() -> None:
    spec = importlib.util.spec_from_file_location("site_pages", HOOK)
    assert spec is not None
    assert spec.loader is not None
    hook = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hook)
    text = "[a](../results/x.json) ![b](images/p.png) [c](wire.md#clocks) [d](https://e.org/f.md)"
    assert hook.relinked(text, "docs/usage.md") == (
        "[a](files/results/x.json) ![b](images/p.png) [c](wire.md#clocks) [d](https://e.org/f.md)"
    )
    assert hook.relinked("[a](docs/wire.md) [b](LICENSE) [c](#d)", "README.md") == (
        "[a](wire.md) [b](files/LICENSE) [c](#d)"
    )
    assert hook.relinked("[a](../README.md) [b](own_policy.py)", "examples/README.md") == (
        "[a](index.md) [b](files/examples/own_policy.py)"
    )
    assert hook.relinked("[a](../wire.md) [b](../../README.md)", "docs/reference/x.md") == (
        "[a](../wire.md) [b](../index.md)"
    )
