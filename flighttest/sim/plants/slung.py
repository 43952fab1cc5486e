"""A load on a taut, massless line below the centre of mass: two point masses and a constraint."""

from __future__ import annotations

from math import sqrt

from flighttest.frames import G_M_S2

Vector = tuple[float, float, float]


class SlungLoad:
    """The load's direction and its rate. payload_ratio: load over vehicle; cable_m; swing_damping: damping ratio."""

    def __init__(self, vehicle_kg: float, values: dict[str, float]) -> None:
        self.mass_kg = values["payload_ratio"] * vehicle_kg
        self._vehicle_kg, self._length = vehicle_kg, values["cable_m"]
        # drag of the load on its line that damps the free swing by this ratio
        self._drag = 2.0 * values["swing_damping"] * sqrt(G_M_S2 / self._length) * self.mass_kg
        self.hang()

    def hang(self) -> None:
        """Straight down, at rest."""
        self._n: Vector = (0.0, 0.0, -1.0)
        self._rate: Vector = (0.0, 0.0, 0.0)

    def pull(self, h: float, force: Vector) -> Vector:
        """The vehicle's specific force (world, m/s^2) with the line's pull, given that without it; the load moves on by h."""
        length, m, load = self._length, self._vehicle_kg, self.mass_kg
        nx, ny, nz = self._n
        rx, ry, rz = self._rate
        c = self._drag / load
        # specific drag of the load: on its velocity relative to the vehicle's
        dx, dy, dz = -c * length * rx, -c * length * ry, -c * length * rz
        square = rx * rx + ry * ry + rz * rz
        along = nx * (dx - force[0]) + ny * (dy - force[1]) + nz * (dz - force[2])
        tension = max((length * square + along) / (1.0 / load + 1.0 / m), 0.0)
        k, w = tension / m, tension / load
        fx, fy, fz = force[0] + k * nx, force[1] + k * ny, force[2] + k * nz
        # relative acceleration of the load over the length is the direction's second derivative
        ax, ay, az = (dx - w * nx - fx) / length, (dy - w * ny - fy) / length, (dz - w * nz - fz) / length
        rx, ry, rz = rx + h * ax, ry + h * ay, rz + h * az
        nx, ny, nz = nx + h * rx, ny + h * ry, nz + h * rz
        size = sqrt(nx * nx + ny * ny + nz * nz)
        nx, ny, nz = nx / size, ny / size, nz / size
        radial = rx * nx + ry * ny + rz * nz
        self._n, self._rate = (nx, ny, nz), (rx - radial * nx, ry - radial * ny, rz - radial * nz)
        return fx, fy, fz
