"""Words of the command line to typed values: NAME=VALUE, A=B, FLIGHT=still and lists of seconds."""

from __future__ import annotations

from collections.abc import Sequence

from flighttest.errors import InputError

LONGEST_S = 60.0  # an open-loop prediction of a minute is of no use


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


def weather_by_part(words: Sequence[str]) -> dict[str, str]:
    """--weather still (of all flights) or FLIGHT=still, repeated: part of a flight's name to its weather, '' being in every name."""
    return {part: value for part, _, value in (word.rpartition("=") for word in words)}


def seconds(word: str | None) -> tuple[float, ...]:
    """--horizons S,S,...: increasing, each once; none where nothing was given. InputError where a part is no time above 0."""
    if word is None:
        return ()
    try:
        found = sorted({float(part) for part in word.split(",")})
    except ValueError:
        found = [-1.0]
    if not all(0.0 < value <= LONGEST_S for value in found):
        raise InputError(
            f"--horizons {word!r} is not a list of times up to {LONGEST_S:g} s", "as in --horizons 0.01,0.1,0.5,1"
        )
    return tuple(found)
