"""Words of the command line to typed values: NAME=VALUE and A=B."""

from __future__ import annotations

from collections.abc import Sequence

from flighttest.errors import InputError


def held(words: Sequence[str]) -> dict[str, float]:
    """--freeze NAME=VALUE, repeated: parameter to value. InputError where a word cannot be read or a name comes twice."""
    found = {}
    for word in words:
        name, equals, text = word.partition("=")
        try:
            found[name.strip()] = float(text)
        except ValueError:
            equals = ""
        if not equals or not name.strip():
            raise InputError(f"--freeze {word!r} is not NAME=VALUE", "as in --freeze alpha=1.7")
    if len(found) < len(words):
        raise InputError("--freeze names a parameter twice", "give it one value")
    return found


def ties(words: Sequence[str]) -> dict[str, str]:
    """--tie A=B, repeated: parameter to the one it is tied to. InputError where a word cannot be read or a name comes twice."""
    found = {}
    for word in words:
        name, equals, source = (part.strip() for part in word.partition("="))
        if not (name and equals and source) or name == source:
            raise InputError(f"--tie {word!r} is not A=B", "as in --tie d_y=d_x")
        found[name] = source
    if len(found) < len(words):
        raise InputError(
            f"--tie {words[-1]}: a parameter is tied twice, or to one that is tied itself",
            "tie each to one that is free",
        )
    return found
