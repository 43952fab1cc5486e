"""What instruments and state estimators drift by, in SI units: assumed, since no recording shows what stays for all of it."""

# What an estimate drifts by within seconds and no high-frequency residual shows: attitude of an EKF in flight about 0.1 deg, velocity of
# GPS and barometer some cm/s, accelerometers warming up or shaken 0.05 m/s^2. Repeats, where they were flown, measure it.
DRIFT = {"roll_rad": 2e-3, "pitch_rad": 2e-3, "r_rad_s": 5e-3} | {
    f"{k}_{axis}_{unit}": std
    for k, unit, std in (("f", "m_s2", 0.05), ("a", "m_s2", 0.1), ("v", "m_s", 0.03))
    for axis in "xyz"
}
# Of this, what stays for all of a flight: an accelerometer's bias. A velocity that drifts by 0.03 m/s in a minute is no acceleration.
LEVEL = {name: std for name, std in DRIFT.items() if name.startswith("f_")}
WANDER_S = 1.0  # integrated autocorrelation of what a velocity estimate wanders by; ArduPilot's EKF: 0.4 to 0.7 s
# The same of the constant disturbances of responses: what drifts in seconds stays for all of a short flight.
DISTURBANCE_DRIFT = {
    "roll_d_rad": DRIFT["roll_rad"],
    "pitch_d_rad": DRIFT["pitch_rad"],
    "yaw_rate_d_rad_s": DRIFT["r_rad_s"],
} | {f"a_d_{axis}_m_s2": DRIFT[f"f_{axis}_m_s2"] for axis in "xyz"}
