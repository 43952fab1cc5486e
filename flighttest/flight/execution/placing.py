"""Where the flight zone lies in the vehicle's local frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from flighttest.errors import LinkError, PreflightError
from flighttest.flight.execution.control import FlightControl
from flighttest.mavlink.dialect import dialect
from flighttest.vehicle.model import Zone

FAR_M = 500.0


def place_zone(control: FlightControl, zone: Zone) -> tuple[str, float]:
    """Take the zone's origin from home, or from the place that the zone states. Gives a sentence where the vehicle states no home, else '',
    and how far home lies outside of the zone's walls, m.

    Nothing happens without a position. LinkError, PreflightError where the place cannot be known or is far from home.
    """
    if not control.state.position_ok:
        return "", 0.0
    home, text = control.vehicle.home_m(), ""
    if home is None:
        assert control.state.position_m is not None
        home = np.asarray(control.state.position_m) + control.reader.origin_m
        text = "the vehicle states no home: its present place is taken"
    if zone.origin is not None:
        origin = control.vehicle.request("GPS_GLOBAL_ORIGIN", dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)
        if origin is None:
            raise LinkError("the vehicle does not state its origin", "use `zone: {origin: home}`")
        place = control.vehicle.local_m(zone.origin[0], zone.origin[1], origin, float(home[2]))
        if float(np.hypot(*(place - home)[:2])) > FAR_M:
            raise PreflightError([(f"the flight zone is more than {FAR_M:g} m from home", "correct the zone's origin")])
    else:
        place = home
    _use(control, place)
    control.gate = replace(control.gate, zone_placed=True)
    control.after()
    return text, zone.outside_m(zone.from_world(home - place))


def place_home(control: FlightControl, zone: Zone) -> None:
    """ArduPilot takes home anew when it arms: until then the estimate of height may have drifted by metres since boot, and that of the
    place by decimetres. A zone that a polygon of the autopilot lies along stays where that lies."""
    home = control.vehicle.home_m() if control.gate.zone_placed else None
    if home is None:
        return
    if (
        zone.origin is not None or zone.fence == "polygon"
    ):  # on the map, or along what was uploaded, it stays where it is
        home = np.array([*control.reader.origin_m[:2], home[2]])
    _use(control, home)


def _use(control: FlightControl, origin_m: NDArray[np.float64]) -> None:
    control.reader.origin_m = origin_m
    control.recorder.manifest["zone_origin_local_m"] = [round(float(v), 3) for v in origin_m]
