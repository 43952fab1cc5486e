"""A maneuver script (YAML, `format: maneuver/1`) to a frozen `Script`; every problem at once, each with line, path and remedy."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal, TypeVar, cast

from flighttest.datafiles import read_text
from flighttest.documents import Form, Node, YamlDocument, kind_of, nearest, read_form, require
from flighttest.errors import ScriptError
from flighttest.frames import yaw_from_compass
from flighttest.script.model import Limits, Maneuver, Repeat, Reset, ResetBy, Script, ThrottleUnit
from flighttest.script.profiles import PROFILES, Duration, Field, Profile

KEYS = ("format", "name", "doc", "identifies", "mode", "rate_hz", "throttle_unit", "limits", "reset", "steps", "repeat")
LIMIT_KEYS = (
    "tilt_target_max_deg",
    "tilt_abort_deg",
    "throttle",
    "height_m",
    "speed_max_m_s",
    "voltage_min_v",
    "yaw_rate_max_deg_s",
    "floor_m",
)
RESET_KEYS = ("to", "heading_deg", "by", "settle_s")
REPEAT_KEYS = ("each", "over_voltage_v", "order")
MODE = "GUIDED_NOGPS"  # the one mode in which targets go to the attitude loops as they are
PARAMETERS = (
    "omega_phi",
    "omega_theta",
    "zeta_phi",
    "zeta_theta",
    "sigma_r",
    "sigma_t",
    "K",
    "alpha",
    "d_x",
    "d_y",
    "d_z",
    "T_d",
)
# A script that holds 50 000 responses would take a month to fly: it is a slip of the pen.
MAX_RESPONSES = 5000
LEAST_RATE_HZ = 20.0  # of targets: with GUID_TIMEOUT 0.2 s the vehicle levels after three that are lost
LEAST_TARGETS = 4  # in a period of what a step asks for

T = TypeVar("T")

_HOVER_UNIT_MAX = 5.0


def load_script(path: str | Path) -> Script:
    """Read a maneuver script. ScriptError lists everything wrong with it as `file:line: path: what; hint`."""
    path = Path(path)
    return parse_script(read_text(path, ScriptError, "script"), str(path))


def parse_script(text: str, file: str = "script.yaml") -> Script:
    """`load_script` for text; `file` names it in messages."""

    def build(document: YamlDocument, fields: Mapping[str, Node]) -> Script:
        require(document, fields, ("steps",), document.line)
        return _Reader(document, fields).script(text, file)

    return read_form(text, file, Form("maneuver", KEYS, ScriptError), build)


class _Reader:
    """Walks the checked keys; notes problems in the document and goes on with defaults."""

    def __init__(self, document: YamlDocument, fields: Mapping[str, Node]) -> None:
        self.document = document
        self.fields = fields

    def script(self, text: str, file: str) -> Script:
        """The whole script; valid only when the document has no problems afterwards."""
        doc = self.document
        name = self._get(self.fields, "name", lambda n: doc.text(n, 60), Path(file).stem)
        if not re.fullmatch(r"[A-Za-z0-9_.-]{1,40}", name) and "name" in self.fields:
            doc.wrong(
                self.fields["name"],
                "a name is 1 to 40 letters, digits, `_`, `-` or `.`",
                "marks in the onboard log carry it",
            )
        unit = cast(
            ThrottleUnit,
            self._get(self.fields, "throttle_unit", lambda n: doc.choice(n, ("absolute", "hover")), "absolute"),
        )
        limits = self._limits()
        steps = self._steps(unit)
        repeat = self._repeat()
        rate_hz = self._get(self.fields, "rate_hz", lambda n: doc.number(n, LEAST_RATE_HZ, 400.0, "Hz"), 50.0)
        self._cross_check(steps, limits, unit, repeat)
        self._sampled(steps, rate_hz)
        return Script(
            name=name,
            doc=self._get(self.fields, "doc", doc.text, ""),
            identifies=self._identifies(),
            mode=self._get(self.fields, "mode", self._mode, MODE),
            rate_hz=rate_hz,
            throttle_unit=unit,
            limits=limits,
            reset=self._reset(),
            steps=tuple(maneuver for maneuver, _ in steps),
            repeat=repeat,
            text=text,
            sha256=hashlib.sha256(text.encode("utf-8")).hexdigest(),
            path=file,
        )

    @staticmethod
    def _get(fields: Mapping[str, Node], key: str, read: Callable[[Node], T | None], default: T) -> T:
        if key not in fields:
            return default
        found = read(fields[key])
        return default if found is None else found

    def _mode(self, node: Node) -> str | None:
        if node.value == MODE:
            return MODE
        found = f"`{str(node.value)[:40]}`" if isinstance(node.value, str | int | float) else kind_of(node.value)
        self.document.wrong(node, f"steps are flown in {MODE} only, found {found}", f"write `mode: {MODE}`")
        return None

    def _identifies(self) -> tuple[str, ...]:
        node = self.fields.get("identifies")
        if node is None or node.value == []:
            return ()
        children = node.value if isinstance(node.value, list) else [node]
        return tuple(name for name in (self.document.choice(child, PARAMETERS) for child in children) if name)

    def _limits(self) -> Limits:
        doc = self.document
        node = self.fields.get("limits")
        fields = doc.mapping(node, LIMIT_KEYS) if node is not None else {}
        target = self._get(fields, "tilt_target_max_deg", lambda n: doc.number(n, 1.0, 60.0, "deg"), 35.0)
        abort = self._get(fields, "tilt_abort_deg", lambda n: doc.number(n, 2.0, 85.0, "deg"), max(50.0, target + 5.0))
        if abort <= target:
            doc.wrong(
                fields.get("tilt_abort_deg", fields.get("tilt_target_max_deg", cast(Node, node))),
                f"tilt_abort_deg {abort:g} is not above tilt_target_max_deg {target:g}",
                "a step overshoots: 0.5 rad peaks at 36 deg, its counter-step at 41 deg",
            )
        yaw_rate = self._get(
            fields, "yaw_rate_max_deg_s", lambda n: doc.number(n, 1.0, 720.0, "deg/s"), math.degrees(3.5)
        )
        floor = doc.number(fields["floor_m"], 0.1, 100.0, "m above the ground") if "floor_m" in fields else None
        return Limits(
            tilt_target_max_rad=math.radians(target),
            tilt_abort_rad=math.radians(abort),
            throttle=self._get(fields, "throttle", lambda n: doc.span(n, 0.0, 1.0), (0.0, 0.6)),
            height_m=self._get(fields, "height_m", lambda n: doc.span(n, 0.0, 500.0, "m"), (2.0, 10.0)),
            speed_max_m_s=self._get(fields, "speed_max_m_s", lambda n: doc.number(n, 0.5, 40.0, "m/s"), 8.0),
            voltage_min_v=self._get(fields, "voltage_min_v", lambda n: doc.number(n, 2.0, 120.0, "V"), 0.0),
            yaw_rate_max_rad_s=math.radians(yaw_rate),
            floor_m=floor,
        )

    def _reset(self) -> Reset:
        doc = self.document
        node = self.fields.get("reset")
        fields = doc.mapping(node, RESET_KEYS) if node is not None else {}
        home: tuple[float, ...] = (0.0, 0.0, 5.0)
        to = self._get(fields, "to", lambda n: doc.vector(n, 3, -2000.0, 2000.0, "m"), home)
        around: tuple[float, ...] = (0.0, 90.0, 180.0, 270.0)
        headings = self._get(fields, "heading_deg", lambda n: doc.numbers(n, -360.0, 360.0, "deg"), around)
        by = self._get(fields, "by", lambda n: doc.choice(n, ("guided", "attitude", "pilot")), "guided")
        return Reset(
            to_m=(to[0], to[1], to[2]),
            heading_rad=tuple(yaw_from_compass(heading) for heading in headings),
            by=cast(ResetBy, by),
            settle_s=self._get(fields, "settle_s", lambda n: doc.number(n, 0.0, 60.0, "s"), 2.0),
        )

    def _repeat(self) -> Repeat:
        doc = self.document
        node = self.fields.get("repeat")
        fields = doc.mapping(node, REPEAT_KEYS) if node is not None else {}
        span = doc.vector(fields["over_voltage_v"], 2, 2.0, 120.0, "V") if "over_voltage_v" in fields else None
        if span is not None and span[0] == span[1]:
            doc.wrong(fields["over_voltage_v"], "the two voltages are the same", "write [full, empty]")
        order = self._get(fields, "order", lambda n: doc.choice(n, ("interleaved", "sequential")), "interleaved")
        return Repeat(
            each=self._get(fields, "each", lambda n: doc.integer(n, 1, 200), 1),
            over_voltage_v=(max(span), min(span)) if span is not None else None,
            order=cast(Literal["interleaved", "sequential"], order),
        )

    def _steps(self, unit: ThrottleUnit) -> list[tuple[Maneuver, Node]]:
        if "steps" not in self.fields:
            return []
        found = []
        for item in self.document.items(self.fields["steps"], "steps"):
            if isinstance(item.value, str) and item.value in PROFILES:
                # A profile whose settings all have defaults may stand alone.
                item = Node({item.value: Node({}, item.line, f"{item.path}.{item.value}")}, item.line, item.path)
            if not isinstance(item.value, dict) or len(item.value) != 1:
                count = f"{len(item.value)} keys" if isinstance(item.value, dict) else kind_of(item.value)
                self.document.wrong(
                    item, f"expected one profile with its settings, found {count}", f"one of: {', '.join(PROFILES)}"
                )
                continue
            name, settings = next(iter(item.value.items()))
            if name not in PROFILES:
                guess = nearest(name, PROFILES)
                hint = f"did you mean `{guess}`?" if guess else f"one of: {', '.join(PROFILES)}"
                self.document.wrong(settings, f"unknown profile `{name[:60]}`", hint)
                continue
            if settings.value is None:
                settings = Node({}, settings.line, settings.path)
            read = self._settings(PROFILES[name], settings, unit)
            if read is not None:
                found.append((Maneuver(name, read, settings.line), settings))
        return found

    def _settings(self, profile: Profile, node: Node, unit: ThrottleUnit) -> dict[str, Any] | None:
        doc = self.document
        before = len(doc.problems)
        known = {field.key: field for field in profile.fields}
        # What is radians inside may be typed in degrees.
        degrees = {_in_degrees(key): key for key in known if _in_degrees(key) != key}
        fields = doc.mapping(node, [*known, *degrees], f"setting of {profile.name}")
        settings: dict[str, Any] = {}
        for key, field in known.items():
            typed = [k for k in (key, _in_degrees(key)) if k in fields]
            if len(typed) > 1 and typed[0] != typed[1]:
                doc.wrong(fields[typed[1]], f"`{typed[0]}` and `{typed[1]}` are both given", "keep one of them")
            elif typed:
                settings[key] = self._value(field, fields[typed[0]], unit, in_degrees=typed[0] != key)
            elif field.default is None and not field.optional:
                doc.problem(node.line, f"{node.path}.{key}", "this key is missing", f"add `{key}:` ({field.doc})")
            else:
                settings[key] = field.default
        if len(doc.problems) > before:
            return None
        complaint = profile.check(settings)
        if complaint:
            doc.wrong(node, complaint)
            return None
        return settings

    def _value(self, field: Field, node: Node, unit: ThrottleUnit, in_degrees: bool) -> Any:
        doc = self.document
        low, high, words, hint = field.low, field.high, field.unit, ""
        if field.throttle:
            low, high = (0.0, 1.0) if unit == "absolute" else (0.0, _HOVER_UNIT_MAX)
            words = "" if unit == "absolute" else "times hover"
            hint = "throttle runs from 0 to 1" if unit == "absolute" else "throttle_unit is hover: 1 holds height"
        if in_degrees:
            low, high, words = math.degrees(low), math.degrees(high), words.replace("rad", "deg")
        elif words.startswith("rad"):
            hint = f"for degrees write `{_in_degrees(field.key)}`"
        scale = math.pi / 180.0 if in_degrees else 1.0
        if field.kind == "number":
            number = doc.number(node, low, high, words, hint)
            return None if number is None else number * scale
        if field.kind == "numbers":
            numbers = doc.numbers(node, low, high, words, hint)
            return None if numbers is None else tuple(dict.fromkeys(n * scale for n in numbers))
        if field.kind == "count":
            return doc.integer(node, int(low), int(high))
        if field.kind == "choice":
            return doc.choice(node, field.choices)
        if field.kind == "choices":
            children = node.value if isinstance(node.value, list) else [node]
            if not children:
                doc.wrong(node, "the list is empty", f"one of: {', '.join(field.choices)}")
            return tuple(
                dict.fromkeys(word for word in (doc.choice(child, field.choices) for child in children) if word)
            )
        if field.kind == "points":
            points = [doc.vector(child, 3, low, high, words) for child in doc.items(node, "points")]
            if len(points) == 1:
                doc.wrong(node, "one point is not a path", "write at least two")
            return tuple(points)
        return self._duration(node, low, high)

    def _duration(self, node: Node, low: float, high: float) -> Duration | None:
        doc = self.document
        if isinstance(node.value, dict):
            fields = doc.mapping(node, ("up_to",))
            require(doc, fields, ("up_to",), node.line, node.path)
            seconds = doc.number(fields["up_to"], low, high, "s") if "up_to" in fields else None
            return None if seconds is None else Duration(seconds, up_to=True)
        seconds = doc.number(node, low, high, "s", "write seconds, or {up_to: seconds}")
        return None if seconds is None else Duration(seconds)

    def _cross_check(
        self, steps: list[tuple[Maneuver, Node]], limits: Limits, unit: ThrottleUnit, repeat: Repeat
    ) -> None:
        """What only shows when settings are held against the script's own limits."""
        doc = self.document
        responses = 0
        for maneuver, node in steps:
            settings = maneuver.settings
            for key in ("amplitude_rad", "tilt_rad"):
                value = settings.get(key)
                for angle in value if isinstance(value, tuple) else [value] if value else []:
                    if angle > limits.tilt_target_max_rad + 1e-9:
                        doc.wrong(
                            _child(node, key),
                            f"{angle:g} rad ({math.degrees(angle):.1f} deg) is above "
                            f"tilt_target_max_deg {math.degrees(limits.tilt_target_max_rad):g}",
                            "lower the step or raise the limit",
                        )
            rates = settings.get("rate_rad_s") or ()
            for rate in rates if isinstance(rates, tuple) else [rates]:
                if rate > limits.yaw_rate_max_rad_s + 1e-9:
                    doc.wrong(
                        _child(node, "rate_rad_s"),
                        f"{rate:g} rad/s is above yaw_rate_max_deg_s {math.degrees(limits.yaw_rate_max_rad_s):g}",
                        "lower the step or raise the limit",
                    )
            for key in ("throttle_0", "throttle_1") if unit == "absolute" else ():
                for value in settings.get(key, ()):
                    if not limits.throttle[0] <= value <= limits.throttle[1]:
                        doc.wrong(
                            _child(node, key),
                            f"throttle {value:g} is outside the limits {limits.throttle[0]:g} to {limits.throttle[1]:g}",
                            "change the step or the limit",
                        )
            cells = 1
            for value in settings.values():
                cells *= len(value) if isinstance(value, tuple) and not isinstance(value[0], tuple) else 1
            cells *= 2 if settings.get("sign") == "both" else 1
            responses += cells * repeat.each
        if responses > MAX_RESPONSES:
            doc.problem(
                1, "steps", f"{responses} responses are more than {MAX_RESPONSES}", "fewer settings, or fewer repeats"
            )

    def _sampled(self, steps: list[tuple[Maneuver, Node]], rate_hz: float) -> None:
        """What is too quick for the targets that are sent: a sine held for a quarter of its period has 0.90 of its amplitude."""
        for maneuver, node in steps:
            highest, unit_s = maneuver.settings.get("to_hz"), maneuver.settings.get("unit_s")
            if highest is not None and LEAST_TARGETS * highest > rate_hz:
                what = f"{highest:g} Hz have {rate_hz / highest:.1f} targets a period at rate_hz {rate_hz:g}, fewer than {LEAST_TARGETS}"
                self.document.wrong(_child(node, "to_hz"), what, "lower to_hz, or raise rate_hz")
            if unit_s is not None and 2.0 * unit_s * rate_hz < LEAST_TARGETS:
                what = f"{unit_s:g} s are shorter than {LEAST_TARGETS // 2} targets at rate_hz {rate_hz:g}"
                self.document.wrong(_child(node, "unit_s"), what, "raise unit_s or rate_hz")


def _in_degrees(key: str) -> str:
    if key.endswith("_rad_s"):
        return f"{key[:-6]}_deg_s"
    return f"{key[:-4]}_deg" if key.endswith("_rad") else key


def _child(node: Node, key: str) -> Node:
    if isinstance(node.value, dict):
        return node.value.get(key) or node.value.get(_in_degrees(key)) or node
    return node
