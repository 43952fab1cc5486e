"""Numbers as people read them. Formats, never computes."""

from __future__ import annotations

import math

UNITS = {
    "m/s^2": "m/s²",
    "1/s": "1/s",
    "rad/s^2": "rad/s²",
    "m^2": "m²",
    "s^2/m^2": "s²/m²",
    "1": "",
}


def unit(text: str) -> str:
    """A unit for people: 'm/s^2' as 'm/s²', '1' as nothing."""
    return UNITS.get(text, text.replace("^2", "²").replace("^3", "³"))


def number(value: float | None, digits: int = 4) -> str:
    """A number with so many significant digits, without exponents where they can be avoided."""
    if value is None or not math.isfinite(value):
        return "-"
    if value == 0:
        return "0"
    size = math.floor(math.log10(abs(value)))
    if size < -4 or size > 6:
        return f"{value:.{max(digits - 1, 1)}e}"
    return f"{value:.{max(digits - 1 - size, 0)}f}"


def to_error(value: float | None, std: float | None) -> str:
    """A number with the digits its standard error warrants: two of the error's."""
    if value is None or not math.isfinite(value):
        return "-"
    if std is None or not math.isfinite(std) or std <= 0:
        return number(value)
    return f"{value:.{decimal_places(std)}f}"


def decimal_places(std: float) -> int:
    """Decimal places that show two digits of the standard error."""
    return int(min(max(1 - math.floor(math.log10(std)), 0), 8))


def interval(low: float | None, high: float | None, std: float | None = None) -> str:
    """'54.2 to 55.0'."""
    if low is None or high is None or not (math.isfinite(low) and math.isfinite(high)):
        return "-"
    if std is not None and math.isfinite(std) and std > 0:
        return " to ".join(_decimals(end, decimal_places(std)) for end in (low, high))
    return f"{number(low, 3)} to {number(high, 3)}"


def percent(share: float | None, places: int = 1) -> str:
    """A share as per cent, with so many decimals."""
    if share is None or not math.isfinite(share):
        return "-"
    return f"{_decimals(100 * share, places)} %"


def _decimals(value: float, places: int) -> str:
    """Without a sign before nothing."""
    text = f"{value:.{places}f}"
    return text.removeprefix("-") if float(text) == 0 else text


def duration(seconds: float) -> str:
    """'45 s', '3 min 20 s', '1 h 05 min'."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


def join(words: list[str] | tuple[str, ...], last: str = "and") -> str:
    """'a, b and c'."""
    if len(words) < 2:
        return "".join(words)
    return f"{', '.join(words[:-1])} {last} {words[-1]}"


def join_some(words: list[str] | tuple[str, ...], most: int = 5) -> str:
    """'a, b and c', of many only the first: 'a, b, c, d, e and 3 more'."""
    return join([*words[:most], f"{len(words) - most} more"]) if len(words) > most + 1 else join(words)


def paths(names: list[str] | tuple[str, ...], most: int = 3) -> str:
    """Files or folders in few words: 'a and b', or of many in one folder 'FOLDER: a, b, c and 5 more'."""
    if len(names) <= most:
        return join(names)
    folders = {name.rpartition("/")[0] for name in names}
    folder = folders.pop() if len(folders) == 1 else ""
    ends = [name.removeprefix(f"{folder}/") if folder else name for name in names]
    shown = ends if len(ends) <= 12 and folder else ends[:most]
    more = [f"{len(ends) - len(shown)} more"] if len(ends) > len(shown) else []
    return (f"{folder}: " if folder else "") + join([*shown, *more])
