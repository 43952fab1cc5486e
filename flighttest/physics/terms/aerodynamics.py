"""Aerodynamics beyond linear drag: what the air does to rotors and fuselage."""

from __future__ import annotations

import casadi as ca

from flighttest.physics.core import Contribution, Expr, Param, Port, Signals, Term, Values

# Keeps square roots of thrust differentiable where the rotors stand still, (m/s^2)^2.
_SMALL_THRUST_2 = 0.05**2


def _thrust(a_t: Expr) -> Expr:
    """|a_t|, smooth and never zero, m/s^2."""
    return ca.sqrt(a_t**2 + _SMALL_THRUST_2)


def _quadratic(s: Signals, p: Values, _x: Values) -> Contribution:
    v = s.v_air_body
    k: Expr = ca.vertcat(p["k_x"], p["k_y"], p["k_z"])
    return Contribution(-k * ca.fabs(v) * v)


def _quadratic_param(axis: str, name: str) -> Param:
    return Param(
        f"k_{axis}", f"k_{axis}", "1/m", 0.02, -0.2, 0.5, 0.02, f"quadratic drag along the body's {name} axis",
        "½ρ C_d A / m of a 1 to 10 kg multirotor: 0.005 to 0.05", one_sided=True)  # fmt: skip


quadratic_drag = Term(
    id="quadratic_drag",
    title="Quadratic fuselage drag",
    family="aerodynamics",
    port=Port.FORCE,
    params=(_quadratic_param("x", "forward"), _quadratic_param("y", "left"), _quadratic_param("z", "up")),
    build=_quadratic,
    equation="f = -diag(k_x, k_y, k_z) |v_air_body| v_air_body, axis by axis",
    plain="drag grows with the square of the speed through the air, as it does for the fuselage and its attachments",
    source="Hattenberger, Bronz, Condomines, Evaluation of drag coefficient for a quadrotor model, IJMAV 2023",
    doubt="axis by axis instead of along the flow: off by up to 40 % when flying diagonally",
    hides_in=("d_x", "d_y", "d_z"),
    told_apart_by="two speeds",
    reveals="speed_dash",
    needs=("v_x_m_s",),
)


def _induced(s: Signals, p: Values, _x: Values) -> Contribution:
    v = s.v_air_body
    return Contribution(-p["c_h"] * s.a_t_total * ca.vertcat(v[0], v[1], 0))


thrust_scaled_drag = Term(
    id="thrust_scaled_drag",
    title="Drag that scales with thrust",
    family="aerodynamics",
    port=Port.FORCE,
    params=(
        Param(
            "c_h", "c_H", "s/m", 0.03, -0.2, 0.5, 0.02, "in-plane rotor force per thrust and airspeed",
            "Martin and Salaün, ICRA 2010; Faessler et al., RA-L 2018: 0.02 to 0.05", one_sided=True),
    ),
    build=_induced,
    equation="f = -c_H a_t (v_air_x, v_air_y, 0)",
    plain="flapping and induced drag of the rotors: the in-plane drag is proportional to the thrust, not constant",
    source="Martin and Salaün, The true role of accelerometer feedback in quadrotor control, ICRA 2010",
    doubt="really proportional to the sum of rotor speeds, i.e. between constant and proportional to thrust",
    hides_in=("d_x", "d_y"),
    told_apart_by="same speed at two throttles",
    reveals="tilt_throttle",
    needs=("v_x_m_s",),
)  # fmt: skip


def _lift(s: Signals, p: Values, _x: Values) -> Contribution:
    v = s.v_air_body
    return Contribution(1 + p["k_lift"] * (v[0] ** 2 + v[1] ** 2))


translational_lift = Term(
    id="translational_lift",
    title="Translational lift",
    family="aerodynamics",
    port=Port.AERO_GAIN,
    params=(
        Param(
            "k_lift", "k_l", "s^2/m^2", 0.002, -0.05, 0.1, 0.002, "relative thrust gain per squared in-plane airspeed",
            "momentum theory at an induced velocity of 5 m/s: 0.001 to 0.005", one_sided=True),
    ),
    build=_lift,
    equation="a_t <- a_t (1 + k_l (v_air_x^2 + v_air_y^2))",
    plain="rotors that move sideways receive undisturbed air and give more thrust at the same throttle",
    source="Faessler et al., RA-L 2018 (k_h); Leishman, Principles of Helicopter Aerodynamics, chapter 2",
    doubt="quadratic only below the induced velocity (about 5 m/s); saturates above it",
    hides_in=("K", "d_z"),
    told_apart_by="level dash against hover",
    reveals="speed_dash",
    needs=("v_x_m_s",),
)  # fmt: skip


def _inflow(s: Signals, p: Values, _x: Values) -> Contribution:
    return Contribution(1 - p["k_inflow"] * s.v_air_body[2] * ca.sqrt(s.g / _thrust(s.a_t)))


axial_inflow = Term(
    id="axial_inflow",
    title="Axial inflow",
    family="aerodynamics",
    port=Port.AERO_GAIN,
    params=(
        Param(
            "k_inflow", "k_i", "s/m", 0.03, -0.2, 0.3, 0.02, "relative thrust loss per climb speed at hover thrust",
            "blade element theory, 10 to 15 inch propellers: 0.01 to 0.06", one_sided=True),
    ),
    build=_inflow,
    equation="a_t <- a_t (1 - k_i v_air_z sqrt(g / a_t)), since the loss is proportional to rotor speed times climb speed",
    plain="climbing through the air lowers the blades' angle of attack: thrust is lost in climb and gained in descent, the more the "
    "faster the rotors turn",
    source="Powers et al., Influence of aerodynamics and proximity effects in quadrotor flight, ISER 2013; blade element theory",
    doubt="the induced velocity's own reaction (momentum theory) is left out; fails in fast descent",
    hides_in=("d_z",),
    told_apart_by="climb and descent at several throttles",
    reveals="thrust",
    needs=("v_z_m_s",),
)  # fmt: skip


def _vortex(s: Signals, p: Values, _x: Values) -> Contribution:
    off_centre = (s.v_air_body[2] + p["vortex_centre"]) / p["vortex_width"]
    return Contribution(1 - p["vortex_depth"] * ca.exp(-(off_centre**2)))


vortex_ring = Term(
    id="vortex_ring",
    title="Vortex ring state",
    family="aerodynamics",
    port=Port.AERO_GAIN,
    params=(
        Param(
            "vortex_depth", "s_v", "1", 0.15, -0.5, 0.7, 0.1, "share of thrust lost in the middle of the region",
            "wind tunnel tests of small rotors in descent: 0.1 to 0.3", one_sided=True),
        Param(
            "vortex_centre", "v_v", "m/s", 4.0, 1.5, 12.0, 1.0, "descent speed where the loss is greatest, 0.8 to 1.2 induced velocities",
            "Leishman, chapter 2; induced velocity of 3 to 6 m/s", "shape", None, (2.5, 4.0, 6.0),
        ),
        Param(
            "vortex_width", "w_v", "m/s", 1.5, 0.6, 4.0, 0.5, "half width of the region",
            "Leishman, chapter 2: half an induced velocity", "shape", None, (1.5,),
        ),
    ),
    build=_vortex,
    equation="a_t <- a_t (1 - s_v exp(-((v_air_z + v_v) / w_v)^2))",
    plain="descending into its own downwash, a rotor recirculates air and loses thrust",
    source="Leishman, Principles of Helicopter Aerodynamics, chapter 2; Hoffmann et al., AIAA 2007",
    doubt="really unsteady: the mean loss is modelled, the fluctuation is not",
    hides_in=("d_z",),
    told_apart_by="fast against slow descent",
    reveals="descent",
    needs=("v_z_m_s",),
)  # fmt: skip


def _ground(s: Signals, p: Values, _x: Values) -> Contribution:
    z2 = (s.height_m + s.rotor_height) ** 2 + 0.05**2
    return Contribution(1 / (1 - 0.5 * ca.tanh(2 * p["R2_m2"] / (16 * z2))))


ground_effect = Term(
    id="ground_effect",
    title="Ground effect",
    family="aerodynamics",
    port=Port.AERO_GAIN,
    params=(
        Param(
            "R2_m2", "R²", "m^2", 0.1, -1.0, 8.0, 0.1, "effective rotor radius squared (a multirotor's is larger than one rotor's)",
            "Cheeseman and Bennett, ARC R&M 3021, 1955; Sanchez-Cuevas et al. 2017 for several rotors", one_sided=True),
    ),
    build=_ground,
    equation="a_t <- a_t / (1 - R^2 / (16 z^2)), z = height + rotor_height_m; smoothly limited to a factor of 2",
    plain="near the ground the downwash is blocked, and the same throttle gives more thrust",
    source="Cheeseman and Bennett, The effect of the ground on a helicopter rotor, ARC R&M 3021, 1955",
    doubt="found for one rotor in hover; with several rotors and a fuselage it is stronger and reaches higher. An error of "
    "rotor_height_m (vehicle file; 0.2 m where it is not given) is an error of R^2",
    hides_in=("K", "alpha"),
    told_apart_by="same step at two heights",
    reveals="two_heights",
    needs=("height_m",),
)  # fmt: skip


def _wind(_s: Signals, p: Values, _x: Values) -> Contribution:
    return Contribution(ca.vertcat(p["w_north"], p["w_west"], p["w_up"]))


def _wind_param(name: str, direction: str, most: float = 20.0) -> Param:
    return Param(
        f"w_{name}", f"w_{name}", "m/s", 2.0, -most, most, 1.0, f"velocity of the air, towards {direction}",
        "met. experience: 0 to 10 m/s near the ground, hardly ever more than 2 m/s up or down for minutes",
        alone=name != "up",
    )  # fmt: skip


steady_wind = Term(
    id="steady_wind",
    title="Steady wind",
    family="aerodynamics",
    port=Port.WIND,
    params=(_wind_param("north", "north"), _wind_param("west", "west"), _wind_param("up", "the sky", 3.0)),
    build=_wind,
    equation="v_air = v - (w_north, w_west, w_up)",
    plain="the air itself moves: drag acts on the velocity through the air, not over the ground",
    source="paper, Conclusion (disturbance estimation left open); definition of airspeed",
    doubt="constant in time and height; gusts remain noise",
    hides_in=("a_d",),
    told_apart_by="headings, and velocity in the residual",
    reveals="headings",
    needs=("v_x_m_s",),
)
