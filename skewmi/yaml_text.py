"""Reading YAML that anybody may have written, in bounded time.

The parser's time grows with the square of how deep flow collections are nested: four thousand
opening brackets take it a quarter of a minute, a hundred thousand hours. Files of this project nest
three deep. None has an alias: nine lists of ten aliases, each to the list before, are a thousand
million entries in 400 characters, and whoever writes them into a message does not end.
"""

from __future__ import annotations

import reprlib
from typing import TYPE_CHECKING, Any

from skewmi.errors import ConfigurationError

if TYPE_CHECKING:
    from ruamel.yaml import YAML

DEEPEST = 20
"""Opening brackets and braces, less closing ones, at any place of a text."""
LARGEST = 100_000
"""Characters of a text."""
LONGEST_NUMBER = 40
"""Characters of a whole number. Python writes none of more than 4,300 digits into a message, and
makes no float of one of more than 309."""

_INT = "tag:yaml.org,2002:int"
_BRIEF = reprlib.Repr()
_BRIEF.maxlevel, _BRIEF.maxlist, _BRIEF.maxtuple = 3, 8, 8
_BRIEF.maxstring = _BRIEF.maxother = _BRIEF.maxlong = 60
_LONGEST_SHOWN = 80


class _RefusedError(Exception):
    """What YAML allows and this project does not; the text is told to whoever wrote it."""


def shown(value: object) -> str:
    """A value as messages show it: like `repr`, in bounded time, 80 characters at most."""
    text = _BRIEF.repr(value)
    return text if len(text) <= _LONGEST_SHOWN else f"{text[: _LONGEST_SHOWN - 3]}..."


def parse_yaml(text: str, name: str) -> object:
    """What a YAML text says: mappings, lists, numbers, texts.

    Args:
        text: Of a file.
        name: Of the file, for messages.

    Raises:
        ConfigurationError: It is not YAML, or nested or long beyond all reason, or has an anchor,
            an alias or a whole number of more than `LONGEST_NUMBER` characters.
    """
    from ruamel.yaml.error import YAMLError

    if len(text) > LARGEST:
        raise ConfigurationError(f"{name} is longer than {LARGEST} characters: it is none of ours")
    depth = 0
    for character in text:
        depth += (character in "[{") - (character in "]}")
        if depth > DEEPEST:
            raise ConfigurationError(
                f"{name} nests more than {DEEPEST} deep, in brackets or braces that are not closed"
            )
    try:
        content: object = _reader().load(text)
    except _RefusedError as error:
        raise ConfigurationError(f"{name}, {error}") from error
    except (YAMLError, ValueError, LookupError, ArithmeticError, RecursionError) as error:
        # The parser fails by a LookupError on `!!bool maybe` or an empty `!!int`, and by an
        # OverflowError on an escaped character beyond the last one.
        summary = " ".join(str(error).split())
        raise ConfigurationError(f"{name} is not YAML: {summary}") from error
    return content


def _reader() -> YAML:
    # Imported late, since most commands read no YAML; the class with it.
    from ruamel.yaml import YAML
    from ruamel.yaml.composer import Composer
    from ruamel.yaml.events import AliasEvent

    class PlainComposer(Composer):  # type: ignore[misc]
        """Refuses before anything is built of it."""

        def compose_node(self, parent: Any, index: Any) -> Any:
            event = self.parser.peek_event()
            where = f"line {event.start_mark.line + 1}"
            if isinstance(event, AliasEvent) or event.anchor is not None:
                raise _RefusedError(
                    f"{where}: anchors (&name) and aliases (*name) are not read; write out what is "
                    "meant, or put a text that begins so in quotes"
                )
            node = super().compose_node(parent, index)
            if node.tag == _INT and len(node.value) > LONGEST_NUMBER:
                raise _RefusedError(f"{where}: a number of more than {LONGEST_NUMBER} characters")
            return node

    yaml = YAML(typ="safe", pure=True)
    yaml.Composer = PlainComposer
    return yaml
