"""vehicle.yaml and MethodicConfigurator's vehicle_components.json to `Vehicle`; every problem at once."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from flighttest.datafiles import parse_json, read_text
from flighttest.documents import Form, Node, YamlDocument, kind_of, read_form, require
from flighttest.errors import VehicleError
from flighttest.frames import yaw_from_compass
from flighttest.recording.manifest import Component
from flighttest.vehicle.model import DEFAULT_VEHICLE, Vehicle, Zone

KEYS = (
    "format",
    "name",
    "connect",
    "firmware",
    "nominal_voltage_v",
    "hover_throttle",
    "zone",
    "mass_kg",
    "rotor_height_m",
    "components",
    "signing_key",
    "weather",
)
REQUIRED = (
    "format",
    "name",
    "firmware",
    "nominal_voltage_v",
    "hover_throttle",
    "zone",
)  # to fly; a recording needs only the name
WEATHERS = ("still", "unknown")
ZONE_KEYS = ("origin", "heading_deg", "x_m", "y_m", "z_m", "margin_m", "fence")
FENCES = ("circle", "polygon")
FIRMWARES = ("ardupilot", "px4")

# Parts of MethodicConfigurator's file that carry no thrust and touch no attitude loop.
_HARMLESS_COMPONENTS = frozenset({"rc_controller", "rc_receiver", "rc_transmitter", "telemetry", "gnss_receiver"})
_HARMLESS_FIELDS = frozenset({"url", "notes"})


def load_vehicle(path: str | Path, *, to_fly: bool = True) -> Vehicle:
    """Read vehicle.yaml. VehicleError lists everything wrong with it as `file:line: path: what; hint`.

    to_fly: False where it is for recordings: what only a flight needs (zone, firmware, hover throttle) may be missing then.
    """
    path = Path(path)
    return parse_vehicle(read_text(path, VehicleError, "vehicle file"), str(path), to_fly=to_fly)


def parse_vehicle(text: str, file: str = "vehicle.yaml", *, to_fly: bool = True) -> Vehicle:
    """`load_vehicle` for text; `file` names it in messages, and relative component files are looked for beside it."""
    needed = REQUIRED if to_fly else ("format", "name")

    def build(document: YamlDocument, fields: Mapping[str, Node]) -> Vehicle:
        require(document, fields, [key for key in needed if key != "format"], document.line)
        return _vehicle(document, fields, file)

    return read_form(text, file, Form("vehicle", KEYS, VehicleError), build)


def _vehicle(document: YamlDocument, fields: Mapping[str, Node], file: str) -> Vehicle:
    def number(key: str, low: float, high: float, unit: str, default: float | None, hint: str = "") -> float | None:
        if key not in fields:
            return default
        found = document.number(fields[key], low, high, unit, hint)
        return default if found is None else found

    def text(key: str, default: str) -> str:
        return (document.text(fields[key], 300) or default) if key in fields else default

    default = DEFAULT_VEHICLE
    weather = document.choice(fields["weather"], WEATHERS) if "weather" in fields else None
    firmware = document.choice(fields["firmware"], FIRMWARES) if "firmware" in fields else None
    connect = text("connect", "") if "connect" in fields and fields["connect"].value is not None else ""
    voltage = number("nominal_voltage_v", 2.0, 120.0, "V", default.nominal_voltage_v)
    hover = number("hover_throttle", 0.02, 0.95, "", default.hover_throttle, "throttle runs from 0 to 1")
    rotor = number("rotor_height_m", 0.0, 5.0, "m", Vehicle.rotor_height_m)
    assert voltage is not None
    assert hover is not None
    assert rotor is not None
    return Vehicle(
        name=text("name", "unnamed"),
        connect=connect or None,
        firmware=firmware or "ardupilot",
        nominal_voltage_v=voltage,
        hover_throttle=hover,
        zone=_zone(document, fields["zone"]) if "zone" in fields else default.zone,
        mass_kg=number("mass_kg", 0.01, 500.0, "kg", None),
        rotor_height_m=rotor,
        components=_components(document, fields["components"], Path(file).parent) if "components" in fields else {},
        path=file,
        signing_key=str(Path(file).parent / key) if (key := text("signing_key", "")) else None,
        weather=weather or "unknown",
        flies=set(REQUIRED) <= set(fields),
    )


def _zone(document: YamlDocument, node: Node) -> Zone:
    fields = document.mapping(node, ZONE_KEYS)
    require(document, fields, ("x_m", "y_m", "z_m"), node.line, node.path)
    default = Zone()
    origin: tuple[float, float] | None = None
    if "origin" in fields and fields["origin"].value != "home":
        where = fields["origin"]
        if isinstance(where.value, list):
            pair = document.vector(where, 2, -180.0, 180.0, "deg")
            if pair is not None and abs(pair[0]) > 90.0:
                document.wrong(where, f"latitude {pair[0]:g} deg is outside -90 to 90", "write [latitude, longitude]")
            elif pair is not None:
                origin = (pair[0], pair[1])
        else:
            document.wrong(where, "expected `home` or [latitude, longitude]", "write `origin: home`")
    heading = document.number(fields["heading_deg"], -360.0, 360.0, "deg") if "heading_deg" in fields else 0.0
    spans = {
        key: (document.span(fields[key], low, high, "m") if key in fields else None)
        for key, low, high in (("x_m", -2000.0, 2000.0), ("y_m", -2000.0, 2000.0), ("z_m", -5.0, 500.0))
    }
    margin = document.number(fields["margin_m"], 0.0, 100.0, "m") if "margin_m" in fields else default.margin_m
    fence = document.choice(fields["fence"], FENCES) if "fence" in fields else None
    zone = Zone(
        heading_rad=yaw_from_compass(heading or 0.0),
        x_m=spans["x_m"] or default.x_m,
        y_m=spans["y_m"] or default.y_m,
        z_m=spans["z_m"] or default.z_m,
        margin_m=default.margin_m if margin is None else margin,
        origin=origin,
        fence=fence or default.fence,
    )
    for key in ("x_m", "y_m", "z_m"):
        low, high = getattr(zone, key)
        if spans[key] is not None and high - low <= 2.0 * zone.margin_m:
            document.wrong(
                fields[key], f"a margin of {zone.margin_m:g} m leaves nothing of {high - low:g} m", "lower margin_m"
            )
    return zone


def _components(document: YamlDocument, node: Node, folder: Path) -> dict[str, Component]:
    if isinstance(node.value, str):
        try:
            return load_components(folder / node.value)
        except VehicleError as error:
            document.wrong(node, error.message, error.hint)
            return {}
    if not isinstance(node.value, dict):
        document.wrong(node, "expected a block of components, or the path of a vehicle_components.json")
        return {}
    components: dict[str, Component] = {}
    for name, child in node.value.items():
        if isinstance(child.value, dict):
            components[name] = {key: field.plain() for key, field in child.value.items()}
        elif isinstance(child.value, list) or child.value is None:
            document.wrong(child, f"expected a block such as {{id: B07}}, found {kind_of(child.value)}")
        else:
            components[name] = {"id": child.value}
    return components


def load_components(path: str | Path) -> dict[str, Component]:
    """Components of MethodicConfigurator's vehicle_components.json: part name to its fields, in snake case.

    Fields keep their place as dotted names (`specifications.diameter_inches`). Links, notes and parts that cannot change the
    dynamics (radio, telemetry, GNSS) are left out. Format: ArduPilot/MethodicConfigurator, vehicle_components_schema.json.
    """
    path = Path(path)
    text = read_text(path, VehicleError, "components file")
    try:
        document = parse_json(text)
    except ValueError as error:
        raise VehicleError(f"{path}: this is not JSON: {error}", "save it again with MethodicConfigurator") from error
    parts = document.get("Components") if isinstance(document, dict) else None
    if not isinstance(parts, dict):
        raise VehicleError(
            f"{path}: there is no block `Components`",
            "name the vehicle_components.json that MethodicConfigurator wrote",
        )
    components: dict[str, Component] = {}
    for title, part in parts.items():
        name = _snake(str(title))
        if name in _HARMLESS_COMPONENTS or not isinstance(part, dict):
            continue
        fields = dict(_flat(part))
        if fields:
            components[name] = fields
    return components


def _flat(block: Mapping[str, Any], prefix: str = "", depth: int = 0) -> list[tuple[str, Any]]:
    found: list[tuple[str, Any]] = []
    for key, value in block.items():
        name = _snake(str(key))
        if name in _HARMLESS_FIELDS:
            continue
        if isinstance(value, dict) and depth < 5:
            found += _flat(value, f"{prefix}{name}.", depth + 1)
        elif isinstance(value, (str, int, float, bool)) and value != "":
            found.append((f"{prefix}{name}", value))
    return found


def _snake(title: str) -> str:
    return re.sub(r"[^a-z0-9]+", "_", title.lower()).strip("_")
