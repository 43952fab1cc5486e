"""ArduCopter over MAVLink: modes, arming, take-off, positions and attitude targets, each with its answer read back.

Facts about the firmware were read in the source of Copter 4.7 and flown on its SITL. Everything that can fail raises LinkError or
states why it was refused; nothing is assumed to have worked.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from flighttest import frames
from flighttest.errors import LinkError
from flighttest.link.session import Session
from flighttest.mavlink import CopterMode, mark_message, mode_name, offset_m, target_message
from flighttest.mavlink.dialect import COMPONENT_AUTOPILOT, Message, board_id, dialect, firmware_version, is_armed

_ACK_S = 2.0
_RESULTS = {
    dialect.MAV_RESULT_TEMPORARILY_REJECTED: "not now",
    dialect.MAV_RESULT_DENIED: "denied",
    dialect.MAV_RESULT_UNSUPPORTED: "not supported",
    dialect.MAV_RESULT_FAILED: "failed",
}
_POSITION_AND_YAW = 0b100111111000  # SET_POSITION_TARGET type_mask: velocity, acceleration and yaw rate ignored
_STREAM_TYPES: dict[str, int] = {
    "HEARTBEAT": dialect.MAVLINK_MSG_ID_HEARTBEAT,
    "ATTITUDE": dialect.MAVLINK_MSG_ID_ATTITUDE,
    "HIGHRES_IMU": dialect.MAVLINK_MSG_ID_HIGHRES_IMU,
    "RAW_IMU": dialect.MAVLINK_MSG_ID_RAW_IMU,
    "LOCAL_POSITION_NED": dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
    "GLOBAL_POSITION_INT": dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
    "ATTITUDE_TARGET": dialect.MAVLINK_MSG_ID_ATTITUDE_TARGET,
    "BATTERY_STATUS": dialect.MAVLINK_MSG_ID_BATTERY_STATUS,
    "SYS_STATUS": dialect.MAVLINK_MSG_ID_SYS_STATUS,
    "VFR_HUD": dialect.MAVLINK_MSG_ID_VFR_HUD,
    "SERVO_OUTPUT_RAW": dialect.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW,
    "EKF_STATUS_REPORT": dialect.MAVLINK_MSG_ID_EKF_STATUS_REPORT,
    "RC_CHANNELS": dialect.MAVLINK_MSG_ID_RC_CHANNELS,
    "EXTENDED_SYS_STATE": dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
    "SCALED_PRESSURE": dialect.MAVLINK_MSG_ID_SCALED_PRESSURE,
    "DISTANCE_SENSOR": dialect.MAVLINK_MSG_ID_DISTANCE_SENSOR,
}


@dataclass(frozen=True)
class Ack:
    """The answer to a command. result: MAV_RESULT, None when none came. why: STATUSTEXT that came with it. tries: how often it was sent."""

    result: int | None
    why: str = ""
    tries: int = 1

    @property
    def accepted(self) -> bool:
        """Whether the vehicle accepted."""
        return self.result in (dialect.MAV_RESULT_ACCEPTED, dialect.MAV_RESULT_IN_PROGRESS)

    @property
    def sentence(self) -> str:
        """For the reader."""
        if self.result is None:
            return "no answer"
        text = _RESULTS.get(self.result, "accepted" if self.accepted else f"result {self.result}")
        return f"{text}: {self.why}" if self.why else text


class ArduPilot:
    """One ArduCopter in a session. The caller's clock is `session.now_s()`; every wait lets the session advance."""

    def __init__(self, session: Session) -> None:
        self.session = session

    # -- questions -----------------------------------------------------------------------------------------------------------

    @property
    def mode(self) -> int:
        """custom_mode of the last HEARTBEAT, -1 before one came."""
        beat = self.session.latest.get("HEARTBEAT")
        return int(beat.message.custom_mode) if beat else -1

    @property
    def armed(self) -> bool:
        """Whether the last HEARTBEAT shows armed."""
        beat = self.session.latest.get("HEARTBEAT")
        return beat is not None and is_armed(beat.message)

    def command(self, command: int, *params: float, timeout_s: float = _ACK_S, tries: int = 3) -> Ack:
        """Send a COMMAND_LONG until it is answered; the vehicle's texts meanwhile come with the answer."""
        texts: list[str] = []

        def note(message: Message, _t_s: float) -> None:
            if message.get_type() == "STATUSTEXT" and message.severity <= dialect.MAV_SEVERITY_WARNING:
                texts.append(message.text.strip())

        ours = (0, self.session.port.system)  # addressee of an answer; 0: not given
        self.session.listen(note)
        try:
            for confirmation in range(tries):
                self.session.send(self._command_long(command, params, confirmation))
                answer = self.session.await_message(
                    lambda m: m.get_type() == "COMMAND_ACK" and m.command == command and m.target_system in ours,
                    timeout_s * max(self.session.clock.pace, 1.0),
                )
                if answer is not None:
                    if answer.result not in (dialect.MAV_RESULT_ACCEPTED, dialect.MAV_RESULT_IN_PROGRESS):
                        self.session.advance(self.session.now_s() + 0.1)  # the reason may come after the answer
                    return Ack(int(answer.result), "; ".join(dict.fromkeys(texts)), confirmation + 1)
            return Ack(None, "; ".join(dict.fromkeys(texts)), tries)
        finally:
            self.session.forget(note)

    def _command_long(self, command: int, params: tuple[float, ...], confirmation: int) -> Message:
        p = (*params, *([0.0] * (7 - len(params))))
        if command == dialect.MAV_CMD_DO_SET_MODE and not self.session.held and not self.session.port.muted:
            # One that does not leave is no request: the mode it names may be the pilot's own choice.
            self.session.mode_requests.sent(int(params[1]), self.session.now_s())
        return dialect.MAVLink_command_long_message(
            self.session.vehicle_system, COMPONENT_AUTOPILOT, command, confirmation, *p
        )

    def request(self, name: str, message_id: int, timeout_s: float = 2.0) -> Message | None:
        """Ask for one message once; None when it does not come."""
        for _ in range(3):
            self.session.send(self._command_long(dialect.MAV_CMD_REQUEST_MESSAGE, (message_id,), 0))
            found = self.session.await_message(
                lambda m: m.get_type() == name, timeout_s * max(self.session.clock.pace, 1.0)
            )
            if found is not None:
                return found
        return None

    def firmware(self) -> str:
        """Version and commit; empty when the vehicle does not report it."""
        version = self.request("AUTOPILOT_VERSION", dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
        return firmware_version(version) if version is not None else ""

    @property
    def hardware(self) -> str:
        """The board's own number in hexadecimal, once `firmware` has asked; '' where it states none."""
        heard = self.session.latest.get("AUTOPILOT_VERSION")
        return board_id(heard.message) if heard is not None else ""

    def home_m(self) -> np.ndarray | None:
        """Home in the local frame (NWU, m), None while the vehicle has none: ArduPilot's local frame starts at the EKF's origin."""
        origin = self.request("GPS_GLOBAL_ORIGIN", dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)
        home = self.request("HOME_POSITION", dialect.MAVLINK_MSG_ID_HOME_POSITION)
        if origin is None or home is None:
            return None
        return self.local_m(
            home.latitude * 1e-7, home.longitude * 1e-7, origin, (home.altitude - origin.altitude) * 1e-3
        )

    @staticmethod
    def local_m(lat_deg: float, lon_deg: float, origin: Message, up_m: float) -> np.ndarray:
        """A place in the local frame (NWU, m) whose origin is a GPS_GLOBAL_ORIGIN message."""
        north, west = offset_m(origin.latitude * 1e-7, origin.longitude * 1e-7, lat_deg, lon_deg)
        return np.array([float(north), float(west), up_m])

    # -- streams -------------------------------------------------------------------------------------------------------------

    def set_rates(self, rates_hz: dict[str, float]) -> dict[str, str]:
        """Ask for message rates, Hz; the refused ones with the vehicle's reason."""
        refused: dict[str, str] = {}
        for name, rate in rates_hz.items():
            interval_us = 1e6 / rate if rate > 0 else -1.0
            ack = self.command(dialect.MAV_CMD_SET_MESSAGE_INTERVAL, float(_STREAM_TYPES[name]), interval_us)
            if not ack.accepted:
                refused[name] = ack.sentence
        return refused

    def ask_rate(self, name: str, rate_hz: float) -> None:
        """Ask for one message rate without waiting for the answer."""
        interval = (float(_STREAM_TYPES[name]), 1e6 / rate_hz)
        self.session.send(self._command_long(dialect.MAV_CMD_SET_MESSAGE_INTERVAL, interval, 0))

    def measure_rates(self, names: list[str], duration_s: float = 3.0) -> dict[str, float]:
        """Rates really received, Hz of the vehicle's time, over duration_s: another ground station can override what was asked."""
        before = {name: self.session.counts.get(name, 0) for name in names}
        start = self.session.now_s()
        self.session.advance(start + duration_s)
        span = self.session.now_s() - start
        return {name: (self.session.counts.get(name, 0) - before[name]) / span for name in names}

    # -- deeds ---------------------------------------------------------------------------------------------------------------

    def ask_mode(self, mode: CopterMode) -> bool:
        """Ask for a mode without waiting: the supervisor repeats it until HEARTBEAT shows it. False where nothing may be sent."""
        return self.session.send(
            self._command_long(
                dialect.MAV_CMD_DO_SET_MODE, (float(dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED), float(mode)), 0
            )
        )

    def set_mode(self, mode: CopterMode, timeout_s: float = 5.0) -> None:
        """Enter a mode and read it back in HEARTBEAT. LinkError with the vehicle's reason where it does not hold."""
        why = ""
        deadline = self.session.now_s() + timeout_s
        while self.session.now_s() < deadline:
            ack = self.command(
                dialect.MAV_CMD_DO_SET_MODE, float(dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED), float(mode)
            )
            why = ack.sentence
            seen = self.session.await_message(lambda m: m.get_type() == "HEARTBEAT" and m.custom_mode == mode, 1.5)
            if seen is not None:
                return
        raise LinkError(
            f"the vehicle did not enter {mode.name} (it is in {mode_name(self.mode)}; {why})",
            "check FLTMODE_GCSBLOCK and the vehicle's messages",
        )

    def arm(self, timeout_s: float = 60.0, stopped: Callable[[], bool] = lambda: False) -> bool:
        """Arm, once a second until accepted: after boot it is refused for 20 to 25 s. LinkError with the reasons.

        stopped: asked before each try; False where it put an end to them.
        """
        deadline = self.session.now_s() + timeout_s
        why = ""
        while not stopped():
            ack = self.command(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
            if ack.accepted and self.session.await_message(_armed_beat, 3.0) is not None:
                return True
            why = ack.sentence if not ack.accepted else why
            if self.session.now_s() >= deadline:
                raise LinkError(f"the vehicle does not arm ({why})", "remove the reason that it gave, then fly again")
            self.session.advance(self.session.now_s() + 1.0)
        return False

    def take_off(self, height_m: float) -> Ack:
        """Ask for take-off to a height above home, in GUIDED."""
        return self.command(dialect.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, height_m)

    def go_to(self, position_m: np.ndarray, yaw_rad: float) -> None:
        """Ask for a position (local NWU, m) and heading (NWU, rad), in GUIDED."""
        x, y, z = (float(v) for v in frames.flip_vector(position_m))
        yaw = float(frames.flip_euler([0.0, 0.0, yaw_rad])[2])
        self.session.send(
            dialect.MAVLink_set_position_target_local_ned_message(
                int(self.session.now_s() * 1e3) & 0xFFFFFFFF,
                self.session.vehicle_system,
                COMPONENT_AUTOPILOT,
                dialect.MAV_FRAME_LOCAL_NED,
                _POSITION_AND_YAW,
                x, y, z, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, yaw, 0.0,
            )
        )  # fmt: skip

    def mark(self, leg_id: str, phase: str, at_s: float | None = None) -> None:
        """Write a segment mark into the vehicle's onboard log, at_s as for a target."""
        self._send(mark_message(leg_id, phase), at_s)

    def disarm(self) -> Ack:
        """Ask to disarm; ArduCopter refuses in the air."""
        return self.command(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)

    def steer(
        self,
        attitude_rad: tuple[float, float, float],
        yaw_rate_rad_s: float | None,
        throttle: float,
        at_s: float | None = None,
    ) -> None:
        """Send one attitude target. Only `FlightControl.steer` calls this: every target passes the gate first.

        at_s: when the vehicle's clock shows that; None: now, in place of any that waits for its time.
        """
        roll, pitch, yaw = attitude_rad
        message = target_message(
            t_vehicle_s=self.session.now_s() if at_s is None else at_s,
            system=self.session.vehicle_system,
            roll_rad=roll,
            pitch_rad=pitch,
            yaw_rad=yaw,
            yaw_rate_rad_s=yaw_rate_rad_s,
            throttle=throttle,
        )
        if at_s is None:
            self.session.port.cancel()
        self._send(message, at_s)

    def _send(self, message: Message, at_s: float | None) -> None:
        if at_s is None:
            self.session.send(message)
        else:
            self.session.send_at(at_s, message)


UNSHAPED_LAG_S = 0.2  # of the heading sent, where the firmware shapes no target: about that of the vehicle


class SentHeading:
    """The heading in the quaternion of a yaw rate step: that of the vehicle's own target, not the integral of the commanded rate.

    The firmware turns its target towards the quaternion, by the rate that came with it and with a limited acceleration
    (AC_AttitudeControl::input_quaternion). A quaternion ahead of the target is caught up with by turning half again as fast as asked, one
    behind it slows the target down. So the heading is of the same acceleration. Where the firmware shapes no target, the vehicle itself
    follows the quaternion, later, and the heading gets a lag.
    """

    def __init__(self, yaw_rad: float, accel_max_rad_s2: float, lag_s: float = 0.0) -> None:
        """accel_max_rad_s2: ATC_ACC_Y_MAX, 0 is unlimited; lag_s: of the heading's rate, 0 for none."""
        self.yaw_rad = yaw_rad
        self._commanded = self._rate = 0.0
        self._accel_max = accel_max_rad_s2 if accel_max_rad_s2 > 0 else math.inf
        self._lag_s = lag_s

    def next(self, yaw_rate_rad_s: float, dt_s: float) -> float:
        """The heading to send with this rate, rad; dt_s: since the one before, whose rate was commanded in between."""
        share = 1.0 - math.exp(-dt_s / self._lag_s) if self._lag_s > 0.0 else 1.0
        wanted = (self._commanded - self._rate) * share
        bound = self._accel_max * dt_s if dt_s > 0.0 else 0.0
        change = min(max(wanted, -bound), bound)
        self._rate += change
        changing = (
            1.0 if self._lag_s > 0.0 or not bound else abs(change) / bound
        )  # share of dt_s in which the rate changes
        self.yaw_rad = float(frames.wrap_angle(self.yaw_rad + (self._rate - 0.5 * changing * change) * dt_s))
        self._commanded = yaw_rate_rad_s
        return self.yaw_rad


def _armed_beat(message: Message) -> bool:
    return bool(message.get_type() == "HEARTBEAT" and is_armed(message))
