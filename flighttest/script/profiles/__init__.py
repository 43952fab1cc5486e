"""Profiles: the kinds of maneuver a script may ask for, one small file per family. Pure functions of time."""

from __future__ import annotations

from flighttest.script.profiles.attitude import ATTITUDE_STEP, DOUBLET, THREE_TWO_ONE_ONE
from flighttest.script.profiles.declare import Duration, Field, Profile, StepCell
from flighttest.script.profiles.steady import FREE_FLIGHT, HOVER, REST
from flighttest.script.profiles.sweeps import BANKED_TURN, CHIRP, RAMP, YAW_RATE_STEP
from flighttest.script.profiles.throttle import THROTTLE_PAIR, TILT_THROTTLE
from flighttest.script.profiles.timeline import Chirp, Piece, Ramp, Timeline

PROFILES: dict[str, Profile] = {
    profile.name: profile
    for profile in (
        ATTITUDE_STEP,
        YAW_RATE_STEP,
        BANKED_TURN,
        THROTTLE_PAIR,
        TILT_THROTTLE,
        DOUBLET,
        THREE_TWO_ONE_ONE,
        CHIRP,
        RAMP,
        FREE_FLIGHT,
        HOVER,
        REST,
    )
}

__all__ = ["PROFILES", "Chirp", "Duration", "Field", "Piece", "Profile", "Ramp", "StepCell", "Timeline"]
