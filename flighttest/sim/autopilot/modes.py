"""ArduCopter's modes and what may be entered when. Source: ArduCopter/mode.h and mode.cpp, Copter 4.6 and 4.7."""

from __future__ import annotations

STABILIZE, ALT_HOLD, AUTO, GUIDED, LOITER, RTL, LAND = 0, 2, 3, 4, 5, 6, 9
POSHOLD, BRAKE, GUIDED_NOGPS = 16, 17, 20

NAMES = {
    STABILIZE: "STABILIZE", ALT_HOLD: "ALT_HOLD", AUTO: "AUTO", GUIDED: "GUIDED", LOITER: "LOITER", RTL: "RTL",
    LAND: "LAND", POSHOLD: "POSHOLD", BRAKE: "BRAKE", GUIDED_NOGPS: "GUIDED_NOGPS",
}  # fmt: skip

NEEDS_POSITION = frozenset({GUIDED, LOITER, RTL, POSHOLD, BRAKE, AUTO})
NO_ARMING = frozenset({RTL, LAND, BRAKE, AUTO})
ATTITUDE_TARGETS = frozenset({GUIDED, GUIDED_NOGPS})


def mode_refusal(mode: int, *, armed: bool, has_position: bool) -> str | None:
    """Why a mode cannot be entered now, in the firmware's words, or None when it can (disarmed, a missing position does not matter)."""
    if mode not in NAMES:
        return f"No such mode {mode}"
    if mode == AUTO:
        return "Mode change to AUTO failed: missing mission"
    if armed and mode in NEEDS_POSITION and not has_position:
        return f"Mode change to {NAMES[mode]} failed: requires position"
    return None
