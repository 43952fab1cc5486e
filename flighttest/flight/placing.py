"""Where the flight zone lies in the vehicle's local frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from flighttest.errors import LinkError, PreflightError
from flighttest.flight.cockpit import Cockpit
from flighttest.mavlink.dialect import book
from flighttest.vehicle.model import Zone

FAR_M = 500.0


def place_zone(cockpit: Cockpit, zone: Zone) -> str:
    """Take the zone's origin from home, or from where the zone says it is; a sentence where the vehicle states no home, else ''.

    Nothing happens without a position. LinkError, PreflightError where the place cannot be known or is absurd.
    """
    if not cockpit.state.position_ok:
        return ""
    home, said = cockpit.vehicle.home_m(), ""
    if home is None:
        assert cockpit.state.position_m is not None
        home = np.asarray(cockpit.state.position_m) + cockpit.reader.origin_m
        said = "the vehicle states no home: its present place is taken"
    if zone.origin is not None:
        origin = cockpit.vehicle.request("GPS_GLOBAL_ORIGIN", book.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)
        if origin is None:
            raise LinkError("the vehicle does not state its origin", "use `zone: {origin: home}`")
        place = cockpit.vehicle.local_m(zone.origin[0], zone.origin[1], origin, float(home[2]))
        if float(np.hypot(*(place - home)[:2])) > FAR_M:
            raise PreflightError([(f"the flight zone is more than {FAR_M:g} m from home", "correct the zone's origin")])
        home = place
    _use(cockpit, home)
    cockpit.gate = replace(cockpit.gate, zone_placed=True)
    cockpit.after()
    return said


def place_home(cockpit: Cockpit, zone: Zone) -> None:
    """ArduPilot takes home anew when it arms: until then the estimate of height may have drifted by metres since boot."""
    home = cockpit.vehicle.home_m() if cockpit.gate.zone_placed else None
    if home is None:
        return
    if zone.origin is not None:  # on the map it stays where it is
        home = np.array([*cockpit.reader.origin_m[:2], home[2]])
    _use(cockpit, home)


def _use(cockpit: Cockpit, origin_m: NDArray[np.float64]) -> None:
    cockpit.reader.origin_m = origin_m
    cockpit.recorder.manifest["zone_origin_local_m"] = [round(float(v), 3) for v in origin_m]
