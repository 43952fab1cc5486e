"""The rotor vehicle without its inner loops: motor commands in, motion out, for an autopilot that brings loops of its own.

Body, air, battery and propulsion are `plant_rotor`'s, so the same effects can be concealed here, except those that live in loops,
estimators or links, which are the real autopilot's own.
"""

from __future__ import annotations

from collections.abc import Sequence

from flighttest.errors import InputError
from flighttest.sim.plants.battery import Battery
from flighttest.sim.plants.plant import Hidden
from flighttest.sim.plants.plant_rotor import RotorPlant
from flighttest.sim.plants.rotor_vehicle import RotorVehicle
from flighttest.sim.plants.weather import Air

# What a real autopilot has itself, or what a plant cannot put into its estimates.
NOT_THE_PLANTS = frozenset(
    {
        "rate_limit",
        "reference_shaping",
        "attitude_extra_pole",
        "roll_pitch_coupling",
        "angle_boost",
        "attitude_offset",
        "velocity_latency",
        "channel_delay",
        "yaw_rate_shaping",
        "attitude_priority",
    }
)
# Where ArduCopter's motor numbers sit (frame class 1 or 2, type X), for rotors counted leftwards from the front left.
_ARDUCOPTER_ORDER = {4: (2, 1, 3, 0), 6: (2, 1, 5, 3, 0, 4)}


class MotorPlant(RotorPlant):
    """A rotor-level multirotor driven motor by motor, in ArduCopter's order; a command 0..1 is static thrust at constant voltage.

    The mean of the commands is the throttle of `Propulsion`; what single motors differ from it follows with the rotor's own lag.
    """

    def __init__(
        self,
        vehicle: RotorVehicle | None = None,
        hide: Hidden | None = None,
        battery: Battery | None = None,
        air: Air | None = None,
    ) -> None:
        foreign = sorted(NOT_THE_PLANTS & set(hide or {}))
        if foreign:
            raise InputError(
                f"{', '.join(foreign)}: not a property of the vehicle under a real autopilot",
                "hide it in the built-in vehicle instead",
            )
        super().__init__(vehicle, hide, battery, air)
        self._order = _ARDUCOPTER_ORDER[self.vehicle.rotors]

    @property
    def motors(self) -> int:
        """How many motor commands `step` takes."""
        return self.vehicle.rotors

    def step(self, motor_commands: Sequence[float], dt_s: float) -> None:
        """Move on by dt_s, s, under constant motor commands 0..1."""
        n = self.vehicle.rotors
        self.time_s += dt_s
        if self._air is not None:
            self._air.advance(dt_s)
        commands = [motor_commands[i] for i in self._order]
        mean = sum(commands) / n
        spinning = mean > 0.0
        gain = self._motors.voltage_gain(self.battery.voltage)
        share = self._motors.common(dt_s, mean, 0.0, 0.0, gain, spinning) / n
        top = gain * self.vehicle.thrust_max_n / n
        self._turn(dt_s, [min(max(share + top * (c - mean), 0.0), top) for c in commands], spinning)
