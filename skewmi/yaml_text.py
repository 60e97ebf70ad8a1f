"""Reading YAML that anybody may have written, in bounded time.

The parser's time grows with the square of how deep flow collections are nested: four thousand
opening brackets take it a quarter of a minute, a hundred thousand hours. Files of this project nest
three deep.
"""

from __future__ import annotations

from skewmi.errors import ConfigurationError

DEEPEST = 20
"""Opening brackets and braces, less closing ones, at any place of a text."""
LARGEST = 100_000
"""Characters of a text."""


def parse_yaml(text: str, name: str) -> object:
    """What a YAML text says: mappings, lists, numbers, texts.

    Args:
        text: Of a file.
        name: Of the file, for messages.

    Raises:
        ConfigurationError: It is not YAML, or nested or long beyond all reason.
    """
    from ruamel.yaml import YAML
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
        content: object = YAML(typ="safe", pure=True).load(text)
    except (YAMLError, ValueError, RecursionError) as error:
        summary = " ".join(str(error).split())
        raise ConfigurationError(f"{name} is not YAML: {summary}") from error
    return content
